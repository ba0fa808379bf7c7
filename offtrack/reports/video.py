"""Encoding of pictures as a video: H.264 where PyAV is installed, else a GIF."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
from PIL import Image

from offtrack.reports.canvas import Picture
from scenarios.progress import Progress, no_progress

_GIF_WIDTH, _GIF_FRAMES, _GIF_COLOURS = 640, 150, 64  # keeps a GIF of a minute at some megabytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Reel:
    """Pictures of one size, drawn on demand by their number."""

    picture: Callable[[int], Picture]
    count: int
    rate: int  # [1/s]


def write_reel(reel: Reel, path_without_suffix: Path, *, progress: Progress = no_progress) -> Path:
    """Writes a video of the pictures and returns its path."""
    encode = _write_h264 if importlib.util.find_spec("av") else _write_gif
    return encode(reel, path_without_suffix, progress)


def _pictures(reel: Reel, stride: int, progress: Progress) -> Iterator[Picture]:
    numbers = range(0, reel.count, stride)
    for done, k in enumerate(numbers, start=1):
        yield reel.picture(k)
        progress(done, len(numbers))


def _write_h264(reel: Reel, path_without_suffix: Path, progress: Progress) -> Path:
    import av  # an optional dependency

    path = path_without_suffix.with_name(path_without_suffix.name + ".mp4")
    with av.open(path, "w", options={"movflags": "faststart"}) as container:
        stream = None
        for picture in _pictures(reel, 1, progress):
            if stream is None:
                stream = container.add_stream("h264", rate=reel.rate, options={"crf": "26", "preset": "veryfast"})
                stream.thread_type = "FRAME"  # draw the next picture while this one is encoded
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"  # supported by every player
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
    return path


def _write_gif(reel: Reel, path_without_suffix: Path, progress: Progress) -> Path:
    path = path_without_suffix.with_name(path_without_suffix.name + ".gif")
    stride = max(2, math.ceil(reel.count / _GIF_FRAMES))
    frames = [_small(picture) for picture in _pictures(reel, stride, progress)]
    palette = _palette(frames[len(frames) // 2])  # one palette for all: parts that do not move then cost nothing
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    duration = round(1e3 * stride / reel.rate)
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
