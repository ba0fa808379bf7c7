"""The video of a rover's run: what its camera saw, the run from above, and the slip angle over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from scenarios.report.canvas import (
    ESTIMATED,
    INK,
    LINE,
    PAPER,
    SHIFT,
    SOFT,
    TRUE,
    Picture,
    StripChart,
    blank,
    curve,
    fixed_point,
    nice_step,
    write,
)
from scenarios.report.trace_view import picture as trace_picture
from scenarios.report.video import Reel, write_reel
from scenarios.results.rover import Progress, RoverResult
from vehicle.frames import FloatArray

_RATE: Final = 10  # [1/s] of the video, twice as fast as it happened: a rover is slow
_PERIOD: Final = 200  # [ticks] between pictures
_WIDTH, _CAMERA, _CHART = 1280, (640, 480), 260  # [px]
_HEAD: Final = 64  # [px] of the numbers above the chart
_BODY: Final = np.array([[0.35, 0.25], [0.35, -0.25], [-0.35, -0.25], [-0.35, 0.25]])  # for the eye only [m]


def write_rover_video(result: RoverResult, path_without_suffix: Path, *, progress: Progress | None = None) -> Path:
    """Writes the video and returns its path: H.264 where PyAV is installed, else a GIF."""
    ticks = range(0, round(float(result.log["tick"][-1])) + 1, _PERIOD)
    film = _Film.of(result)
    reel = Reel(picture=lambda k: film.picture(ticks[k]), count=len(ticks), rate=_RATE)
    return write_reel(reel, path_without_suffix, progress=progress)


def rover_still(result: RoverResult, tick: int) -> Picture:
    """One picture of the video, RGB."""
    return _Film.of(result).picture(tick)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Film:
    """What does not change from one picture to the next."""

    result: RoverResult
    plan: Picture  # the path, on which the rover moves
    low: FloatArray  # lower left corner of the plan [m]
    scale: float  # [px/m]
    chart: StripChart
    ticks: FloatArray  # of the camera's frames

    @classmethod
    def of(cls, result: RoverResult) -> _Film:
        log = result.log
        width = _WIDTH - _CAMERA[0] if result.frames else _WIDTH
        points = np.vstack([result.path, np.column_stack([log["x"], log["y"]])])
        low, high = points.min(axis=0) - 0.6, points.max(axis=0) + 0.6
        scale = float(np.min((np.array([width, _CAMERA[1] - 36]) - 8) / (high - low)))
        middle = 0.5 * (low + high)
        corner = middle - 0.5 * np.array([width, _CAMERA[1] - 36]) / scale
        largest = float(np.nanmax(np.abs(np.degrees(_curves(result))), initial=2.0))
        film = cls(
            result=result,
            plan=blank(width, _CAMERA[1]),
            low=corner,
            scale=scale,
            chart=StripChart.with_axes((_WIDTH, _CHART - _HEAD), float(log["time"][-1]), largest),
            ticks=np.array([frame.tick for frame in result.frames]),
        )
        film._lay_out()
        return film

    def _lay_out(self) -> None:
        curve(self.plan, self._pixels(self.result.path), LINE, 7)
        for k, (text, colour) in enumerate(
            (("path", LINE), ("where it went", TRUE), ("with the slip angle", ESTIMATED))
        ):
            at = (20 + (0, 70, 200)[k], 18)
            cv2.circle(self.plan, at, 5, colour, -1, cv2.LINE_AA)
            write(self.plan, text, (at[0] + 10, at[1] - 10), size=14, colour=SOFT)
        metre = nice_step(self.plan.shape[1] / self.scale, 6)
        right, bottom = self.plan.shape[1] - 18, self.plan.shape[0] - 14
        cv2.line(self.plan, (right - round(metre * self.scale), bottom), (right, bottom), SOFT, 2)
        write(self.plan, f"{metre:g} m", (right, bottom - 22), size=14, colour=SOFT, anchor=1.0)

    def picture(self, tick: int) -> Picture:
        """The picture at a tick; the camera shows the newest frame by then."""
        log = self.result.log
        row = max(0, int(np.searchsorted(log["tick"], tick, side="right")) - 1)
        upper = self._plan(row)
        if self.result.frames:
            frame = self.result.frames[max(0, int(np.searchsorted(self.ticks, tick, side="right")) - 1)]
            upper = np.concatenate([trace_picture(self.result, frame), upper], axis=1)
        lower = blank(_WIDTH, _CHART)
        self._readings(lower, row)
        estimate = np.degrees(log["slip_angle_estimate"])
        there = np.isfinite(estimate)
        lower[_HEAD:] = self.chart.draw(
            float(log["time"][row]),
            (
                (log["time"][there], estimate[there], ESTIMATED, 3),
                (log["time"], np.degrees(log["slip_angle_true"]), TRUE, 2),
            ),
        )
        return np.concatenate([upper, lower])

    def _plan(self, row: int) -> Picture:
        log, shown = self.result.log, self.plan.copy()
        for ending, colour in (("_corrected", ESTIMATED), ("", TRUE)):
            way = np.column_stack([log[f"{axis}{ending}"][: row + 1 : 4] for axis in ("x", "y")])
            curve(shown, self._pixels(way), colour, 2)
        x, y, psi = (float(log[name][row]) for name in ("x", "y", "psi"))
        turn = np.array([[math.cos(psi), math.sin(psi)], [-math.sin(psi), math.cos(psi)]])
        body = self._pixels(_BODY @ turn + [x, y])
        cv2.fillConvexPoly(shown, fixed_point(body), PAPER, cv2.LINE_AA, SHIFT)
        curve(shown, body, INK, 2, closed=True)
        nose = self._pixels(np.array([[0.0, 0.0], [0.35, 0.0]]) @ turn + [x, y])
        curve(shown, nose, INK, 2)
        return shown

    def _pixels(self, points: FloatArray) -> FloatArray:
        height = self.plan.shape[0]
        at = (points - self.low) * self.scale
        return np.column_stack([at[:, 0], height - 1 - at[:, 1]])

    def _readings(self, panel: Picture, row: int) -> None:
        log, result = self.result.log, self.result
        ratio = float(log[f"slip_ratio_{result.rig.wheels[result.rig.watched].name}"][row])
        past = np.flatnonzero(np.isfinite(log["slip_angle_estimate"][: row + 1]))
        estimate = f"{math.degrees(log['slip_angle_estimate'][past[-1]]):+.1f}°" if past.size else "none"
        readings = (
            (result.scenario, f"{float(log['time'][row]):.1f} s", INK),
            ("true slip angle", f"{math.degrees(log['slip_angle_true'][row]):+.1f}°", TRUE),
            ("estimated", estimate, ESTIMATED),
            ("beside the path", f"{1e3 * log['cross_track_true'][row]:+.0f} mm", INK),
            ("slip ratio, left rear", f"{100 * ratio:.0f} %", INK),
        )
        for k, (name, value, colour) in enumerate(readings):
            u = 20 + k * (_WIDTH - 30) // len(readings)
            write(panel, name, (u, 8), size=14, colour=SOFT)
            write(panel, value, (u, 26), size=24, colour=colour)


def _curves(result: RoverResult) -> FloatArray:
    return np.concatenate([result.log["slip_angle_true"], result.log["slip_angle_estimate"]])
