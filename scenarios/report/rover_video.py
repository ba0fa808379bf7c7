"""The video of a rover's run: camera image, plan view, and slip angle over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from scenarios.progress import Progress, no_progress
from scenarios.report import canvas
from scenarios.report.trace_view import picture as trace_picture
from scenarios.report.video import Reel, write_reel
from scenarios.results.rover import RoverResult
from vehicle.frames import FloatArray

_RATE: Final = 10  # [1/s] of the video: twice real time, as a rover is slow
_PERIOD: Final = 200  # [ticks] between pictures
_CAMERA, _CHART = (640, 480), 260  # [px]
_KEYS: Final = (
    ("path to follow", canvas.LINE, 20),
    ("path driven", canvas.TRUE, 150),
    ("dead reckoning, corrected by the slip angle", canvas.ESTIMATED, 260),
)
_HEAD: Final = 64  # [px] of the numbers above the chart
_BODY: Final = np.array([[0.35, 0.25], [0.35, -0.25], [-0.35, -0.25], [-0.35, 0.25]])  # a simplified outline [m]


def write_rover_video(result: RoverResult, path_without_suffix: Path, *, progress: Progress = no_progress) -> Path:
    """Writes the video and returns its path."""
    ticks = range(0, round(float(result.log["tick"][-1])) + 1, _PERIOD)
    film = _Film.of(result)
    reel = Reel(picture=lambda k: film.picture(ticks[k]), count=len(ticks), rate=_RATE)
    return write_reel(reel, path_without_suffix, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Film:
    """Everything that does not change from one picture to the next."""

    result: RoverResult
    plan: canvas.Picture  # the path, on which the rover moves
    low: FloatArray  # lower left corner of the plan [m]
    scale: float  # [px/m]
    chart: canvas.StripChart
    ticks: FloatArray  # of the camera's frames

    @classmethod
    def of(cls, result: RoverResult) -> _Film:
        log = result.log
        width = canvas.WIDTH - _CAMERA[0] if result.frames else canvas.WIDTH
        points = np.vstack([result.path, np.column_stack([log["x"], log["y"]])])
        low, high = points.min(axis=0) - 0.6, points.max(axis=0) + 0.6
        scale = float(np.min((np.array([width, _CAMERA[1] - 36]) - 8) / (high - low)))
        middle = 0.5 * (low + high)
        corner = middle - 0.5 * np.array([width, _CAMERA[1] - 36]) / scale
        largest = float(np.nanmax(np.abs(np.degrees(_curves(result))), initial=2.0))
        film = cls(
            result=result,
            plan=canvas.blank(width, _CAMERA[1]),
            low=corner,
            scale=scale,
            chart=canvas.StripChart.with_axes((canvas.WIDTH, _CHART - _HEAD), float(log["time"][-1]), largest),
            ticks=np.array([frame.tick for frame in result.frames]),
        )
        film._lay_out()
        return film

    def _lay_out(self) -> None:
        canvas.curve(self.plan, self._pixels(self.result.path), canvas.LINE, 7)
        canvas.write_key(self.plan, _KEYS)
        canvas.scale_bar(self.plan, self.scale, canvas.nice_step(self.plan.shape[1] / self.scale, 6))

    def picture(self, tick: int) -> canvas.Picture:
        """The picture at a tick; the camera shows the newest frame by then."""
        log = self.result.log
        row = canvas.newest_row(log["tick"], tick)
        upper = self._plan(row)
        if self.result.frames:
            frame = self.result.frames[canvas.newest_row(self.ticks, tick)]
            upper = np.concatenate([trace_picture(self.result, frame), upper], axis=1)
        lower = canvas.blank(canvas.WIDTH, _CHART)
        canvas.write_readings(lower, self._readings(row), 8)
        true, estimate = (np.degrees(log[f"slip_angle_{name}"]) for name in ("true", "estimate"))
        curves = ((*canvas.known_part(log["time"], estimate), canvas.ESTIMATED, 3), (log["time"], true, canvas.TRUE, 2))
        lower[_HEAD:] = self.chart.draw(float(log["time"][row]), curves)
        return np.concatenate([upper, lower])

    def _plan(self, row: int) -> canvas.Picture:
        log, shown = self.result.log, self.plan.copy()
        for ending, colour in (("_corrected", canvas.ESTIMATED), ("", canvas.TRUE)):
            path = np.column_stack([log[f"{axis}{ending}"][: row + 1 : 4] for axis in ("x", "y")])
            canvas.curve(shown, self._pixels(path), colour, 2)
        x, y, psi = (float(log[name][row]) for name in ("x", "y", "psi"))
        turn = np.array([[math.cos(psi), math.sin(psi)], [-math.sin(psi), math.cos(psi)]])
        body = self._pixels(_BODY @ turn + [x, y])
        canvas.fill(shown, body, canvas.PAPER)
        canvas.curve(shown, body, canvas.INK, 2, closed=True)
        nose = self._pixels(np.array([[0.0, 0.0], [0.35, 0.0]]) @ turn + [x, y])
        canvas.curve(shown, nose, canvas.INK, 2)
        return shown

    def _pixels(self, points: FloatArray) -> FloatArray:
        height = self.plan.shape[0]
        at = (points - self.low) * self.scale
        return np.column_stack([at[:, 0], height - 1 - at[:, 1]])

    def _readings(self, row: int) -> tuple[canvas.Reading, ...]:
        log, result = self.result.log, self.result
        wheel = result.rig.wheels[result.rig.watched].name
        _, past = canvas.known_part(log["time"], log["slip_angle_estimate"][: row + 1])
        return (
            (result.scenario, f"{float(log['time'][row]):.1f} s", canvas.INK),
            ("true slip angle", f"{math.degrees(log['slip_angle_true'][row]):+.1f}°", canvas.TRUE),
            ("estimated", f"{math.degrees(past[-1]):+.1f}°" if past.size else "none", canvas.ESTIMATED),
            ("cross-track error", f"{1e3 * log['cross_track_true'][row]:+.0f} mm", canvas.INK),
            (f"slip ratio, {wheel.replace('_', ' ')}", f"{100 * log[f'slip_ratio_{wheel}'][row]:.0f} %", canvas.INK),
        )


def _curves(result: RoverResult) -> FloatArray:
    return np.concatenate([result.log["slip_angle_true"], result.log["slip_angle_estimate"]])
