"""Camera pictures with what the estimators saw in them, and the video of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from offtrack.reports import canvas
from offtrack.reports.canvas import (
    ESTIMATED,
    INK,
    PAPER,
    TRUE,
    WIDTH,
    Colour,
    Picture,
    Reel,
    curve,
    decoded,
    write,
    write_reel,
)
from offtrack.reports.page import Photo, Photos, Stroke
from scenarios.progress import Progress, no_progress
from scenarios.results.log import LOST
from scenarios.results.metrics import peak
from scenarios.results.rover_result import RoverResult, TraceFrame, trace_line, trace_lines
from scenarios.results.swept_path import placed, placed_wheels
from scenarios.results.trailer_result import CameraFrame, RunResult
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray, arc_length, sides

_TALLEST: Final = 480  # of a camera image in a video [px]
_STILL, _FAST = 200.0, 35.0  # hues of features on a page: blue and orange [deg]
_COLOURS = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]  # in a video


def flow_photos(frame: CameraFrame) -> Photos:
    """The image for a page, with a stroke from the previous to the current position of each feature."""
    height, width = decoded(frame.jpeg, frame.tick).shape[:2]
    tracks = frame.tracks.astype(np.float64)
    hues = _STILL + (_FAST - _STILL) * _relative_length(tracks)
    strokes = [
        Stroke((u0, v0), (u1, v1), f"hsl({hue:.0f} 95% 58%)")
        for (u0, v0, u1, v1), hue in zip((tracks + 0.5).tolist(), hues, strict=True)  # SVG counts from a pixel's corner
    ]
    return Photos([Photo(frame.jpeg, (width, height), "camera image with its features", strokes)])


def camera_picture(frame: CameraFrame) -> Picture:
    """The image across the width of a video, with its features and their number."""
    image = decoded(frame.jpeg, frame.tick)
    scale = min(WIDTH / image.shape[1], _TALLEST / image.shape[0])
    size = (2 * round(0.5 * scale * image.shape[1]), 2 * round(0.5 * scale * image.shape[0]))  # H.264 wants even sizes
    shown = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    draw_flow(shown, scale * (frame.tracks.astype(np.float64) + 0.5) - 0.5)
    picture = np.full((size[1], WIDTH, 3), INK, np.uint8)
    left = (WIDTH - size[0]) // 2
    picture[:, left : left + size[0]] = shown
    strip = picture[:32]
    strip[:] = strip // 5 * 2
    title = "left camera" + (" and the motion of its features" if len(frame.tracks) else "")
    write(picture, title, (16, 6), size=16, colour=PAPER)
    if frame.matches:
        counts = f"{frame.inliers} inliers of {frame.matches} matches"
        write(picture, counts, (WIDTH - 16, 6), size=16, colour=PAPER, anchor=1.0)
    return picture


def draw_flow(picture: Picture, tracks: FloatArray) -> None:
    """Draws a stroke from the previous to the current position of each feature (m, 4) [px]."""
    shade = 40.0 + 190.0 * _relative_length(tracks)
    ends = np.rint(16.0 * tracks).astype(np.int32)
    for (u0, v0, u1, v1), k in zip(ends.tolist(), shade.astype(int).tolist(), strict=True):
        colour = _COLOURS[k].tolist()
        cv2.line(picture, (u0, v0), (u1, v1), colour, 1, cv2.LINE_AA, 4)
        cv2.circle(picture, (u1, v1), 32, colour, -1, cv2.LINE_AA, 4)


def _relative_length(tracks: FloatArray) -> FloatArray:
    """Length of each stroke relative to the long ones, 0 … 1, shape (m,)."""
    if not len(tracks):
        return np.zeros(0)
    length = np.hypot(*(tracks[:, 2:] - tracks[:, :2]).T)
    relative: FloatArray = np.clip(length / max(float(np.percentile(length, 95)), 1e-9), 0.0, 1.0)
    return relative


def picture(result: RoverResult, frame: TraceFrame) -> Picture:
    """The image, RGB, with lines in the true and the estimated direction of travel at the wheel."""
    shown = decoded(frame.jpeg, frame.tick)
    true, estimate = trace_lines(result, frame.tick)
    curve(shown, true, TRUE, 2)
    if estimate is not None:
        curve(shown, estimate, ESTIMATED, 2)
    return shown


def traced(result: RoverResult, frame: TraceFrame) -> bytes:
    """The picture as JPEG."""
    return cv2.imencode(".jpg", cv2.cvtColor(picture(result, frame), cv2.COLOR_RGB2BGR))[1].tobytes()


def draw_trace(shown: Picture, rig: TraceRig, direction: float, offset: float, colour: Colour) -> None:
    """Draws the wheel's trace on the ground if it travels in ``direction`` relative to the body [rad], + left."""
    curve(shown, trace_line(rig, direction, offset), colour, 2)


_ROAD, _SWEPT, _BODY = (236, 239, 241), (207, 224, 241), (250, 251, 252)
_KEY = 36  # [px] height of the key at the top
_KEYS = (("leading point and its path", canvas.TRUE, 20), ("follow point and its path", canvas.ESTIMATED, 230))
_FOLLOW_SCALE = 9.0  # [px/m] a 16.5 m combination is then 150 px long
_LEAST_SCALE = 5.5  # [px/m] below this the vehicle is too small to see in a view of the whole course
_FRAME_RATE = 10  # [1/s] that of the cameras
_PERIOD = 100  # [ticks] between pictures: real time
PLAN_WIDTH, ROW_HEIGHT, READINGS = 620, 430, 150  # of the panels below the camera, and of the numbers in one [px]
_BLIND_HEIGHT = 640  # of the panels without a camera [px]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PlanView:
    """The run from above, north up: the whole course if it fits, else the surroundings of the vehicle."""

    size: tuple[int, int]  # width, height [px]
    result: RunResult
    poses: tuple[FloatArray, ...]  # of each unit, (n_rows, 3)
    steer: tuple[FloatArray, ...]  # of each unit's axles, (n_rows, n_axles) [rad]
    follow: FloatArray  # (n_rows, 2) path of the follow point [m]
    scale: float  # [px/m]
    centre: FloatArray | None  # (2,) of the view [m]; None: it moves with the vehicle

    @classmethod
    def of_run(cls, size: tuple[int, int], result: RunResult) -> _PlanView:
        """The view of this width and height that suits the course; the follow point is the last unit's."""
        poses = tuple(result.poses(unit) for unit in result.units)
        ends = np.concatenate(
            [placed(unit.corners, pose).reshape(-1, 2) for unit, pose in zip(result.units, poses, strict=True)]
        )
        low, high = ends.min(axis=0), ends.max(axis=0)
        whole = float(np.min((np.array(size) - [0, _KEY]) / (high - low + 6.0)))
        fits = whole >= _LEAST_SCALE
        return cls(
            size=size,
            result=result,
            poses=poses,
            steer=tuple(result.axle_steer(unit) for unit in result.units),
            follow=placed(np.array([[-result.follow_distance, 0.0]]), poses[-1])[:, 0],
            scale=min(whole, 2.0 * _FOLLOW_SCALE) if fits else _FOLLOW_SCALE,
            centre=0.5 * (low + high) if fits else None,
        )

    @property
    def _reach(self) -> float:
        """Distance from the centre beyond which nothing is in view [m]."""
        return sum(self.size) / self.scale

    def draw(self, row: int) -> canvas.Picture:
        """The view at a row of the log."""
        picture = canvas.blank(*self.size)
        centre = self.centre if self.centre is not None else placed(np.array([[-2.0, 0.0]]), self.poses[0][[row]])[0, 0]
        self._road(picture, centre)
        past = self._rows(row)
        self._swept(picture, centre, past)
        canvas.curve(picture, self._pixels(self.poses[-1][past, :2], centre), canvas.TRUE, 2)
        canvas.curve(picture, self._pixels(self.follow[past], centre), canvas.ESTIMATED, 2)
        self._vehicle(picture, centre, row)
        canvas.write_key(picture, _KEYS)
        canvas.scale_bar(picture, self.scale, 10.0)
        return picture

    def _pixels(self, points: FloatArray, centre: FloatArray) -> FloatArray:
        middle = 0.5 * np.array([self.size[0] - 1, self.size[1] - 1 + _KEY])
        pixels: FloatArray = middle + self.scale * np.array([1.0, -1.0]) * (points - centre)
        return pixels

    def _rows(self, row: int) -> NDArray[np.intp]:
        """Earlier rows in view, about 0.3 m of travel apart, and this row."""
        along = arc_length(self.poses[0][: row + 1, :2])
        first = 0.0 if self.centre is not None else max(0.0, along[-1] - self._reach)
        rows = np.searchsorted(along, np.arange(first, along[-1], 0.3))
        return np.append(rows, row)

    def _road(self, picture: canvas.Picture, centre: FloatArray) -> None:
        near = np.hypot(*(self.result.road - centre).T) < self._reach
        half_width = self.result.road_half_width
        if isinstance(half_width, np.ndarray):
            rows = np.flatnonzero(near[1:])
            left, right = (self._pixels(side, centre) for side in sides(self.result.road, half_width))
            for piece in np.stack([left[rows], left[rows + 1], right[rows + 1], right[rows]], axis=1):
                canvas.fill(picture, piece, _ROAD)
            return
        for leg in np.split(self.result.road, np.flatnonzero(np.diff(near.astype(np.int8))) + 1):
            if len(leg) > 1 and np.hypot(*(leg - centre).T).min() < self._reach:
                canvas.curve(picture, self._pixels(leg, centre), _ROAD, max(1, round(2.0 * half_width * self.scale)))

    def _swept(self, picture: canvas.Picture, centre: FloatArray, rows: NDArray[np.intp]) -> None:
        for unit, poses in zip(self.result.units, self.poses, strict=True):
            for body in canvas.fixed_point(self._pixels(placed(unit.corners, poses[rows]), centre)):
                cv2.fillConvexPoly(picture, body, _SWEPT, cv2.LINE_8, canvas.SHIFT)

    def _vehicle(self, picture: canvas.Picture, centre: FloatArray, row: int) -> None:
        for unit, poses, steer in zip(self.result.units, self.poses, self.steer, strict=True):
            body = self._pixels(placed(unit.corners, poses[[row]])[0], centre)
            canvas.fill(picture, body, _BODY)
            for wheel in placed_wheels(unit, poses[[row]], steer[[row]])[0]:
                canvas.fill(picture, self._pixels(wheel, centre), canvas.INK)
            canvas.curve(picture, body, canvas.INK, 1, closed=True)
        for point, colour in ((self.poses[-1][row, :2], canvas.TRUE), (self.follow[row], canvas.ESTIMATED)):
            canvas.dot(picture, self._pixels(point, centre), 5, canvas.PAPER)
            canvas.dot(picture, self._pixels(point, centre), 4, colour)


def write_video(result: RunResult, path_without_suffix: Path, *, progress: Progress = no_progress) -> Path:
    """Writes the video and returns its path."""
    ticks = range(0, round(float(result.log["tick"][-1])) + 1, _PERIOD)
    composition = _Composition.of_run(result)
    reel = Reel(picture=lambda k: composition.picture(ticks[k]), count=len(ticks), rate=_FRAME_RATE)
    return write_reel(reel, path_without_suffix, progress=progress)


def still(result: RunResult, tick: int) -> canvas.Picture:
    """One picture of the video, RGB."""
    return _Composition.of_run(result).picture(tick)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Composition:
    """Everything in the pictures of one run that does not change from one to the next."""

    result: RunResult
    plan: _PlanView
    chart: canvas.StripChart
    true: tuple[FloatArray, FloatArray]  # time, value where there is one
    estimated: tuple[FloatArray, FloatArray]
    frame_ticks: FloatArray

    @classmethod
    def of_run(cls, result: RunResult) -> _Composition:
        height = ROW_HEIGHT if result.frames else _BLIND_HEIGHT
        time, true, health = result.log["time"], result.signal("off_tracking_true"), result.signal("health")
        estimate = np.where(health < LOST, result.signal("off_tracking_estimate"), np.nan)
        largest = float(np.nanmax([0.0, peak(true), peak(estimate)]))
        return cls(
            result=result,
            plan=_PlanView.of_run((PLAN_WIDTH, height), result),
            chart=canvas.StripChart.with_axes(
                (canvas.WIDTH - PLAN_WIDTH - 1, height - READINGS), float(time[-1]), largest
            ),
            true=canvas.known_part(time, true, every=5),
            estimated=canvas.known_part(time, estimate),
            frame_ticks=np.array([frame.tick for frame in result.frames]),
        )

    def picture(self, tick: int) -> canvas.Picture:
        """The picture at a tick; the camera shows the newest frame by then."""
        row = canvas.newest_row(self.result.log["tick"], tick)
        now = float(self.result.log["time"][row])
        curves = ((*self.estimated, canvas.ESTIMATED, 4), (*self.true, canvas.TRUE, 2))
        panel = off_tracking_panel(self.result.scenario, now, self._readings(row, now), self.chart, curves)
        lower = side_by_side(self.plan.draw(row), panel)
        if not self.result.frames:
            return lower
        return np.concatenate([camera_picture(self.result.frames[canvas.newest_row(self.frame_ticks, tick)]), lower])

    def _readings(self, row: int, now: float) -> tuple[canvas.Reading, ...]:
        steer = [math.degrees(self.result.log[name][row]) for name in self.result.steer_signals()]
        speed = 3.6 * self.result.signal("v_x_" + self.result.units[0].name)[row]
        return (
            ("speed", f"{speed:.1f} km/h", canvas.INK),
            ("rear axle steer", f"{steer[-1]:+z.1f}°" if steer else "none", canvas.INK),
            ("true off-tracking", _newest(self.true, now), canvas.TRUE),
            ("estimated", _newest(self.estimated, now), canvas.ESTIMATED),
        )


def off_tracking_panel(
    title: str, now: float, readings: Sequence[canvas.Reading], chart: canvas.StripChart, curves: Sequence[canvas.Curve]
) -> canvas.Picture:
    """Title, time and readings above a chart of the off-tracking up to ``now`` [s]."""
    panel = canvas.blank(canvas.WIDTH - PLAN_WIDTH - 1, chart.background.shape[0] + READINGS)
    canvas.write(panel, title, (20, 14), size=19)
    canvas.write(panel, f"{now:.1f} s", (panel.shape[1] - 20, 14), size=19, anchor=1.0)
    canvas.write_readings(panel, readings, 58)
    canvas.write(panel, "off-tracking [m], + when the path lies left", (20, 126), size=14, colour=canvas.SOFT)
    panel[READINGS:] = chart.draw(now, curves)
    return panel


def side_by_side(left: canvas.Picture, right: canvas.Picture) -> canvas.Picture:
    """Two panels of the same height with a line between them."""
    return np.concatenate([left, np.full((len(left), 1, 3), canvas.LINE, np.uint8), right], axis=1)


def _newest(signal: tuple[FloatArray, FloatArray], now: float) -> str:
    known = signal[1][signal[0] <= now]
    return f"{known[-1]:+z.3f} m" if known.size else "none"
