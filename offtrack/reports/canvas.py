"""Pictures drawn with OpenCV (text, lines, readings and strip charts; colours are RGB), and their video.

A video is H.264 where PyAV is installed, else a GIF.
"""

import importlib.util
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from scenarios.progress import Progress
from vehicle.frames import FloatArray

Picture = NDArray[np.uint8]  # (height, width, 3), RGB
Colour = tuple[int, int, int]
Reading = tuple[str, str, Colour]  # label, value, colour of the value
Curve = tuple[FloatArray, FloatArray, Colour, int]  # time [s], finite values, colour, thickness [px]

WIDTH = 1280  # of the videos [px]
PAPER, INK, SOFT, LINE = (255, 255, 255), (39, 49, 59), (91, 102, 115), (226, 230, 234)
TRUE, ESTIMATED = (31, 95, 168), (224, 118, 26)  # as in the report
ROAD, BODY = (236, 239, 241), (250, 251, 252)
SHIFT = 4  # fractional bits of a pixel coordinate in OpenCV's drawing functions


def blank(width: int, height: int) -> Picture:
    """An empty picture."""
    return np.full((height, width, 3), PAPER[0], np.uint8)  # one value for all: several times faster than a colour


_typeface = lru_cache(ImageFont.load_default)  # Pillow's own, by the size in pixels


@lru_cache(maxsize=512)
def _lettering(text: str, size: int) -> NDArray[np.float32]:
    """Coverage of every pixel by the text, shape (height, width), 0 … 1.

    Every machine has the typeface; of dashes and minus signs it has only the hyphen.
    """
    font = _typeface(size)
    left, _, right, _ = font.getbbox(text)
    mask = Image.new("L", (math.ceil(right - left) + 2, round(1.35 * size)))
    ImageDraw.Draw(mask).text((1 - left, 0.05 * size), text, fill=255, font=font)
    return np.asarray(mask, dtype=np.float32) / 255.0


def write(
    picture: Picture, text: str, at: tuple[int, int], *, size: int = 15, colour: Colour = INK, anchor: float = 0.0
) -> None:
    """Writes text with its top at ``at`` [px] and there its left end (``anchor`` 0), middle (0.5) or right end (1)."""
    cover = _lettering(text, size)
    height, width = cover.shape[:2]
    u, v = round(at[0] - anchor * width), at[1]
    u, v = max(0, min(u, picture.shape[1] - width)), max(0, min(v, picture.shape[0] - height))
    patch = picture[v : v + height, u : u + width]
    cover, ink = cover[: patch.shape[0], : patch.shape[1]], np.empty_like(patch)
    ink[:] = colour
    patch[:] = cv2.blendLinear(ink, patch, cover, 1.0 - cover)


def curve(picture: Picture, points: FloatArray, colour: Colour, thickness: int = 1, *, closed: bool = False) -> None:
    """Draws an anti-aliased line through pixel coordinates (n, 2)."""
    if len(points) > 1:
        cv2.polylines(picture, [fixed_point(points)], closed, colour, thickness, cv2.LINE_AA, SHIFT)


def fixed_point(points: FloatArray) -> NDArray[np.int32]:
    """Pixel coordinates in OpenCV's fixed-point format: integers of 1/16 px."""
    fixed: NDArray[np.int32] = np.rint(points * 2**SHIFT).astype(np.int32)
    return fixed


def fill(picture: Picture, points: FloatArray, colour: Colour) -> None:
    """Fills the convex polygon with corners (n, 2) [px]."""
    cv2.fillConvexPoly(picture, fixed_point(points), colour, cv2.LINE_AA, SHIFT)


def vehicle_body(picture: Picture, outline: FloatArray, wheels: Iterable[FloatArray]) -> None:
    """Draws a body and its wheels from above by their corners (n, 2) [px]."""
    fill(picture, outline, BODY)
    for wheel in wheels:
        fill(picture, wheel, INK)
    curve(picture, outline, INK, 1, closed=True)


def seen_from_above(points: FloatArray, centre: FloatArray, scale: float, middle: FloatArray | float) -> FloatArray:
    """Pixels of points (…, 2) [m], north up at ``scale`` [px/m], with ``centre`` [m] in the ``middle`` [px]."""
    pixels: FloatArray = middle + scale * np.array([1.0, -1.0]) * (points - centre)
    return pixels


def dot(picture: Picture, point: FloatArray, radius: int, colour: Colour) -> None:
    """Draws a filled circle around a pixel coordinate (2,)."""
    u, v = fixed_point(point).tolist()
    cv2.circle(picture, (u, v), radius << SHIFT, colour, -1, cv2.LINE_AA, SHIFT)


def write_key(picture: Picture, entries: Sequence[tuple[str, Colour]]) -> None:
    """Writes a key along the top: texts behind dots of their colours, in as many rows as they need."""
    u, v = 20, 20
    for text, colour in entries:
        width = _lettering(text, 14).shape[1] + 26
        if u > 20 and u + width > picture.shape[1]:
            u, v = 20, v + 20
        cv2.circle(picture, (u, v), 5, colour, -1, cv2.LINE_AA)
        write(picture, text, (u + 10, v - 10), size=14, colour=SOFT)
        u += width


def scale_bar(picture: Picture, scale: float, length: float) -> None:
    """Draws a bar of ``length`` [m] at ``scale`` [px/m] into the lower right corner."""
    right, bottom = picture.shape[1] - 18, picture.shape[0] - 14
    left = right - round(length * scale)
    cv2.line(picture, (left, bottom), (right, bottom), SOFT, 2)
    write(picture, f"{length:g} m", ((left + right) // 2, bottom - 22), size=14, colour=SOFT, anchor=0.5)


def newest_row(times: FloatArray, time: float) -> int:
    """The last row at or before a time; the first row if there is none."""
    return max(0, int(np.searchsorted(times, time, side="right")) - 1)


def nice_step(span: float, steps: int) -> float:
    """The smallest of 1, 2 or 5 times a power of ten that divides the span into at most so many steps."""
    rough = span / steps
    power = 10.0 ** math.floor(math.log10(rough))
    return power * next(m for m in (1, 2, 5, 10) if m * power >= rough * (1.0 - 1e-9))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripChart:
    """A chart of signals over the whole run, drawn up to the current time."""

    background: Picture  # axes and lettering
    left: int  # the plotting area inside it [px]
    right: int
    top: int
    bottom: int
    duration: float  # [s]
    limit: float  # the value at the top; its negative is at the bottom

    @classmethod
    def with_axes(cls, size: tuple[int, int], duration: float, largest: float) -> "StripChart":
        """A chart of this width and height for values of either sign up to ``largest``."""
        step = nice_step(2.0 * max(largest, 0.05), 6)  # smaller values would only show noise
        chart = cls(
            background=blank(size[0], size[1]),
            left=62,
            right=size[0] - 20,
            top=10,
            bottom=size[1] - 44,
            duration=max(duration, 1e-3),
            limit=step * math.ceil(max(largest, 0.05) / step),
        )
        chart._axes(step)
        return chart

    def up_to(self, largest: float) -> "StripChart":
        """The chart for values up to ``largest``: this one, if they fit in."""
        height, width = self.background.shape[:2]
        return self if largest <= self.limit else self.with_axes((width, height), self.duration, largest)

    def _axes(self, step: float) -> None:
        count = round(self.limit / step)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        for k in range(-count, count + 1):
            v = round(float(self._pixels(np.array([0.0]), np.array([k * step]))[0, 1]))
            cv2.line(self.background, (self.left, v), (self.right, v), SOFT if k == 0 else LINE, 1)
            label = f"{k * step:+.{digits}f}" if k else "0"
            write(self.background, label, (self.left - 8, v - 10), size=14, colour=SOFT, anchor=1.0)
        every = nice_step(self.duration, 6)
        for k in range(int(self.duration / every + 1e-9) + 1):
            u = round(float(self._pixels(np.array([k * every]), np.array([0.0]))[0, 0]))
            cv2.line(self.background, (u, self.top), (u, self.bottom), LINE, 1)
            write(self.background, f"{k * every:g}", (u, self.bottom + 4), size=14, colour=SOFT, anchor=0.5)
        middle = (self.left + self.right) // 2
        write(self.background, "time [s]", (middle, self.bottom + 22), size=14, colour=SOFT, anchor=0.5)

    def _pixels(self, time: FloatArray, values: FloatArray) -> FloatArray:
        u = self.left + (self.right - self.left) * time / self.duration
        v = 0.5 * (self.top + self.bottom) - 0.5 * (self.bottom - self.top) * values / self.limit
        return np.column_stack([u, v])

    def draw(self, now: float, curves: Sequence[Curve]) -> Picture:
        """The chart at time ``now`` [s] with the curves up to it."""
        picture = self.background.copy()
        u = round(float(self._pixels(np.array([now]), np.array([0.0]))[0, 0]))
        cv2.line(picture, (u, self.top), (u, self.bottom), (180, 188, 196), 1)
        for time, values, colour, thickness in curves:
            pixels = self._pixels(time[time <= now], values[time <= now])
            curve(picture, pixels, colour, thickness)
        return picture


_GIF_WIDTH, _GIF_FRAMES, _GIF_COLOURS = 640, 150, 64  # keeps a GIF of a minute at some megabytes


def write_video(
    picture: Callable[[float], Picture], times: FloatArray, rate: int, path_without_suffix: Path, progress: Progress
) -> Path:
    """Writes a video with a picture of one size for each time, ``rate`` a second, and returns its path."""

    def pictures(stride: int) -> Iterator[Picture]:
        shown = times[::stride].tolist()
        for done, time in enumerate(shown, start=1):
            yield picture(time)
            progress(done, len(shown))

    if importlib.util.find_spec("av"):
        return write_h264(pictures(1), rate, path_without_suffix)
    stride = max(2, math.ceil(len(times) / _GIF_FRAMES))
    return _write_gif([_small(one) for one in pictures(stride)], round(1e3 * stride / rate), path_without_suffix)


# As good as the preset "veryfast", in two thirds of its time; files are a seventh larger.
_QUALITY = {"crf": "26", "preset": "superfast", "x264-params": "mbtree=1:rc-lookahead=10"}


def write_h264(pictures: Iterable[Picture], rate: int, path_without_suffix: Path) -> Path:
    """Writes an H.264 video of pictures of one size, ``rate`` a second, and returns its path; needs PyAV."""
    import av  # an optional dependency

    path = path_without_suffix.with_name(path_without_suffix.name + ".mp4")
    with av.open(path, "w", options={"movflags": "faststart"}) as container:
        stream = None
        for picture in pictures:
            if stream is None:
                stream = container.add_stream("h264", rate=rate, options=_QUALITY)
                stream.thread_type = "FRAME"  # draw the next picture while this one is encoded
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"  # supported by every player
            planes = cv2.cvtColor(picture, cv2.COLOR_RGB2YUV_I420)  # in a third of the time that FFmpeg takes
            container.mux(stream.encode(av.VideoFrame.from_ndarray(planes, format="yuv420p")))
        if stream is not None:
            container.mux(stream.encode())
    return path


def _write_gif(frames: Sequence[Image.Image], duration: int, path_without_suffix: Path) -> Path:
    path = path_without_suffix.with_name(path_without_suffix.name + ".gif")
    palette = _palette(frames[len(frames) // 2])  # one palette for all: parts that do not move then cost nothing
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    first.save(path, save_all=True, append_images=others, duration=duration, loop=0, optimize=True)
    return path


def _palette(picture: Image.Image) -> Image.Image:
    """An image that holds a palette: common colours for the landscape, rare ones for the lines of the diagrams."""
    common = picture.quantize(_GIF_COLOURS, Image.Quantize.MEDIANCUT).getpalette() or []
    rare = picture.quantize(_GIF_COLOURS, Image.Quantize.MAXCOVERAGE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(common[: 3 * _GIF_COLOURS] + rare[: 3 * _GIF_COLOURS])
    return palette


def _small(picture: Picture) -> Image.Image:
    height = round(_GIF_WIDTH * picture.shape[0] / picture.shape[1])
    return Image.fromarray(cv2.resize(picture, (_GIF_WIDTH, height), interpolation=cv2.INTER_AREA))
