"""The film of a playback: the camera's image above the plan, readings and the first chart."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from offtrack.reports import canvas
from offtrack.reports.canvas import INK, PAPER, SOFT, WIDTH, Colour
from offtrack.reports.player.playback import PALETTE, Curve, Picture, Playback
from scenarios.image_file import PictureSize
from scenarios.results.swept_path import placed
from vehicle.frames import FloatArray, arc_length

IN_FILM: Final = PictureSize(quality=85)  # as good as a video shows
_TALLEST: Final = 480  # of a camera image [px]
_TURBO = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
_SWEPT, _FIXED = (207, 224, 241), (200, 206, 212)
_STILL, _FAST = 200.0, 35.0  # hues of features on a page: blue and orange [deg]
_KEY = 36  # height of the key at the top [px]
_LEAST, _FOLLOWED, _MOST = 60.0, 150.0, 300.0  # vehicle in a plan of all, in one that moves, at most [px]
_PLAN_WIDTH, _LOWER, _BLIND, _PLANLESS = 620, 440, 640, 380  # widths and heights of the lower part [px]
_READINGS, _COLUMNS, _SHOWN = 176, 3, 6  # height of the readings [px], and their number in a row and in all
_POINTS: Final = 1000  # of a curve that is a line


class Frames(NamedTuple):
    """Pictures of a camera, loaded one by one."""

    times: FloatArray  # of their captures [s]
    load: Callable[[int], Picture | None]  # None: it can't be read


def rgb(code: str) -> Colour:
    """A colour such as ``#1f5fa8`` as numbers."""
    red, green, blue = bytes.fromhex(code[1:])
    return red, green, blue


def decoded(picture: Picture) -> canvas.Picture:
    """The image, RGB.

    Raises:
        ValueError: if it is no JPEG image.
    """
    image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"picture at {picture.time:.2f} s is no JPEG image")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def camera_picture(picture: Picture) -> canvas.Picture:
    """The image across the width of a film with its strokes and caption."""
    image = decoded(picture)
    scale = min(WIDTH / image.shape[1], _TALLEST / image.shape[0])
    size = (2 * round(0.5 * scale * image.shape[1]), 2 * round(0.5 * scale * image.shape[0]))  # H.264 wants even sizes
    shown = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    strokes = scale * (picture.strokes.astype(np.float64) + 0.5) - 0.5
    if picture.lines:
        for part, colour in zip(
            np.split(strokes, np.cumsum(picture.lines)), (canvas.TRUE, canvas.ESTIMATED), strict=False
        ):
            canvas.curve(shown, np.vstack([part[:1, :2], part[:, 2:]]), colour, 2)
    else:
        draw_flow(shown, strokes)
    side = (WIDTH - size[0]) // 2
    whole = shown
    if side > 0:
        sides = (0, 0, side, WIDTH - size[0] - side)
        whole = np.asarray(cv2.copyMakeBorder(shown, *sides, cv2.BORDER_CONSTANT, value=INK), dtype=np.uint8)
    strip = whole[:32]
    strip[:] = strip // 5 * 2
    title = "camera" + (" and the motion of its features" if len(strokes) and not picture.lines else "")
    canvas.write(whole, title, (16, 6), size=16, colour=PAPER)
    canvas.write(whole, picture.caption, (WIDTH - 16, 6), size=16, colour=PAPER, anchor=1.0)
    return whole


def draw_flow(picture: canvas.Picture, tracks: FloatArray) -> None:
    """Draw a stroke from the previous to the current position of each feature (m, 4) [px]."""
    shade = 40.0 + 190.0 * _relative_length(tracks)
    ends = np.rint(16.0 * tracks).astype(np.int32)
    for (u0, v0, u1, v1), k in zip(ends.tolist(), shade.astype(int).tolist(), strict=True):
        colour = _TURBO[k].tolist()
        cv2.line(picture, (u0, v0), (u1, v1), colour, 1, cv2.LINE_AA, 4)
        cv2.circle(picture, (u1, v1), 32, colour, -1, cv2.LINE_AA, 4)


def _relative_length(tracks: FloatArray) -> FloatArray:
    """Length of each stroke relative to the long ones, 0 … 1, shape (m,)."""
    if not len(tracks):
        return np.zeros(0)
    length = np.hypot(*(tracks[:, 2:] - tracks[:, :2]).T)
    relative: FloatArray = np.clip(length / max(float(np.percentile(length, 95)), 1e-9), 0.0, 1.0)
    return relative


class _Plan:
    """A run from above, north up: the whole course if its vehicle is large enough in it, else its surroundings."""

    def __init__(self, playback: Playback, size: tuple[int, int]) -> None:
        self._playback, self._run, self._size = playback, playback.runs[0], size
        self._poses = [body.poses(self._run.log) for body in self._run.bodies]
        self._trails = [(trail, self._run.trail_points(trail)) for trail in self._run.trails]
        known = [*(playback.road or ()), *(line.points for line in self._run.lines)]  # the same all the time
        ends = [placed(body.outline, poses) for body, poses in zip(self._run.bodies, self._poses, strict=True)]
        points = np.concatenate(known or [end.reshape(-1, 2) for end in ends])
        low, high = points.min(axis=0), points.max(axis=0)
        length = sum(float(np.ptp(body.outline[:, 0])) for body in self._run.bodies)
        whole = float(np.min((np.array(size) - [20, _KEY + 20]) / np.maximum(high - low, 0.1 * length)))
        fits = whole * length >= _LEAST
        self._scale = min(whole, _MOST / length) if fits else _FOLLOWED / length  # [px/m]
        self._centre = 0.5 * (low + high) if fits else None  # [m]; None: it moves with the vehicle
        self._reach = sum(size) / self._scale  # distance beyond which nothing is in view [m]
        self._painted: tuple[canvas.Picture | None, int] = None, 0  # ground of a view that stays, and poses swept on it

    def draw(self, row: int) -> canvas.Picture:
        """The view at a row of the log."""
        centre = self._poses[0][row, :2] if self._centre is None else self._centre
        along = arc_length(self._poses[0][: row + 1, :2])
        first = 0.0 if self._centre is not None else max(0.0, along[-1] - self._reach)
        past = np.append(np.searchsorted(along, np.arange(first, along[-1], 3.0 / self._scale)), row)
        picture = self._ground(centre, past)
        for line in self._run.lines:
            canvas.curve(picture, self._pixels(line.points, centre), _FIXED, 6)
        for trail, points in self._trails:
            driven = points[past]
            driven = driven[np.isfinite(driven).all(axis=1)]
            canvas.curve(picture, self._pixels(driven, centre), rgb(PALETTE[trail.colour]), 2)
        self._vehicle(picture, centre, row)
        keys = [(trail.label, rgb(PALETTE[trail.colour])) for trail, _ in self._trails]
        canvas.write_key(picture, [*keys, *((line.label, _FIXED) for line in self._run.lines)])
        canvas.scale_bar(picture, self._scale, canvas.nice_step(120.0 / self._scale, 1))
        return picture

    def _pixels(self, points: FloatArray, centre: FloatArray) -> FloatArray:
        middle = 0.5 * np.array([self._size[0] - 1, self._size[1] - 1 + _KEY])
        return canvas.seen_from_above(points, centre, self._scale, middle)

    def _ground(self, centre: FloatArray, past: NDArray[np.intp]) -> canvas.Picture:
        """Road, and what the bodies have swept at the rows ``past``, the present one last."""
        if self._playback.road is None:
            return canvas.blank(*self._size)
        picture, swept = self._painted
        if picture is None or self._centre is None or swept >= len(past):
            picture, swept = canvas.blank(*self._size), 0
            self._road(picture, centre, *self._playback.road)
        self._sweep(picture, centre, past[swept:-1])
        self._painted = picture, len(past) - 1
        whole = picture.copy()
        self._sweep(whole, centre, past[-1:])
        return whole

    def _road(self, picture: canvas.Picture, centre: FloatArray, left: FloatArray, right: FloatArray) -> None:
        near = np.flatnonzero(np.hypot(*(left[1:] - centre).T) < self._reach)
        left, right = self._pixels(left, centre), self._pixels(right, centre)
        for piece in np.stack([left[near], left[near + 1], right[near + 1], right[near]], axis=1):
            canvas.fill(picture, piece, canvas.ROAD)

    def _sweep(self, picture: canvas.Picture, centre: FloatArray, past: NDArray[np.intp]) -> None:
        for body, poses in zip(self._run.bodies, self._poses, strict=True):
            for corners in canvas.fixed_point(self._pixels(placed(body.outline, poses[past]), centre)):
                cv2.fillConvexPoly(picture, corners, _SWEPT, cv2.LINE_8, canvas.SHIFT)

    def _vehicle(self, picture: canvas.Picture, centre: FloatArray, row: int) -> None:
        for body, poses in zip(self._run.bodies, self._poses, strict=True):
            outline = self._pixels(placed(body.outline, poses[[row]])[0], centre)
            wheels = self._pixels(body.wheel_corners(self._run.log, np.array([row])), centre)
            canvas.vehicle_body(picture, outline, wheels)
        for trail, points in self._trails:
            if trail.body >= 0:
                canvas.dot(picture, self._pixels(points[row], centre), 5, PAPER)
                canvas.dot(picture, self._pixels(points[row], centre), 4, rgb(PALETTE[trail.colour]))


class Film:
    """Pictures of a playback's first run; none shows more of it than was known by its time."""

    def __init__(self, playback: Playback, frames: Frames | None = None, *, duration: float = 0.0) -> None:
        """With the pictures of the run, or other ``frames``; the run is expected to take a ``duration`` [s]."""
        run = self._run = playback.runs[0]
        self._playback, self._time = playback, run.log["time"]
        self._frames = frames or Frames(np.array([one.time for one in run.pictures]), run.pictures.__getitem__)
        first = next((one for k in range(len(self._frames.times)) if (one := self._frames.load(k))), None)
        self._dark = None if first is None else np.full_like(camera_picture(first), INK[0])
        height = _BLIND if first is None else _LOWER
        self._plan = _Plan(playback, (_PLAN_WIDTH, height)) if run.bodies else None
        width, height = (WIDTH - _PLAN_WIDTH - 1, height) if run.bodies else (WIDTH, _PLANLESS)
        chart = playback.charts[0]
        curves = [curve for curve in chart.curves if curve.style in ("line", "dots") and curve.signal in run.log]
        self._curves = [self._curve(curve) for curve in sorted(curves, key=lambda curve: curve.style)]
        self._chart = canvas.StripChart.with_axes(
            (width, height - _READINGS), max(duration, float(self._time[-1])), 0.0
        )

    def _curve(self, curve: Curve) -> canvas.Curve:
        dots = curve.style == "dots"
        every = 1 if dots else max(1, len(self._time) // _POINTS)
        values = curve.scale * self._run.log[curve.signal]
        rows = np.flatnonzero(np.isfinite(values))[::every]
        return self._time[rows], values[rows], rgb(PALETTE[curve.colour]), 4 if dots else 2

    def picture(self, now: float) -> canvas.Picture:
        """The picture at a time [s], RGB; the camera shows the newest frame by then."""
        row = canvas.newest_row(self._time, now + 1e-4)
        parts = [self._panel(row)]
        if self._plan is not None:
            plan = self._plan.draw(row)
            parts = [plan, np.full((len(plan), 1, 3), canvas.LINE, np.uint8), *parts]
        lower = np.concatenate(parts, axis=1)
        if self._dark is None:
            return lower
        shown = self._frames.load(canvas.newest_row(self._frames.times, now + 1e-4))
        return np.concatenate([self._dark if shown is None else camera_picture(shown), lower])

    def _panel(self, row: int) -> canvas.Picture:
        """Title, time and readings above the chart."""
        now, chart = float(self._time[row]), self._playback.charts[0]
        shown = (np.abs(values[time <= now]) for time, values, *_ in self._curves)
        self._chart = self._chart.up_to(max((float(np.max(values, initial=0.0)) for values in shown), default=0.0))
        background = self._chart.background
        panel = canvas.blank(background.shape[1], background.shape[0] + _READINGS)
        canvas.write(panel, self._playback.title[:40], (20, 10), size=19)
        canvas.write(panel, f"{now:.1f} s", (panel.shape[1] - 20, 10), size=19, anchor=1.0)
        for k, (label, value, colour) in enumerate(self._readings(row)):
            u, top = 20 + k % _COLUMNS * (panel.shape[1] - 30) // _COLUMNS, 46 + 48 * (k // _COLUMNS)
            canvas.write(panel, label, (u, top), size=14, colour=SOFT)
            canvas.write(panel, value, (u, top + 17), size=22, colour=colour)
        canvas.write(panel, f"{chart.title} [{chart.unit}]", (20, _READINGS - 26), size=14, colour=SOFT)
        panel[_READINGS:] = self._chart.draw(now, self._curves)
        return panel

    def _readings(self, row: int) -> Sequence[canvas.Reading]:
        log, readings = self._run.log, list[canvas.Reading]()
        for one in [one for one in self._playback.readings if one.signal in log][:_SHOWN]:
            known = log[one.signal][: row + 1]
            known = known[np.isfinite(known)]
            unit = one.unit if one.unit in ("", "°") else "" if one.unit == "-" else f" {one.unit}"
            value = f"{one.scale * known[-1]:z.{one.digits}f}{unit}" if known.size else "none"
            readings.append((one.label.replace("σ", "std. dev."), value, rgb(PALETTE[one.colour])))
        return readings
