"""The video of a trailer's run: camera image with its features, plan view, and off-tracking over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.progress import Progress, no_progress
from scenarios.report import canvas
from scenarios.report.flow import camera_picture
from scenarios.report.plan_view import PlanView
from scenarios.report.video import Reel, write_reel
from scenarios.results.log import LOST
from scenarios.results.metrics import peak
from scenarios.results.run_result import RunResult
from vehicle.frames import FloatArray

_FRAME_RATE = 10  # [1/s] that of the cameras
_PERIOD = 100  # [ticks] between pictures: real time
PLAN_WIDTH, ROW_HEIGHT, READINGS = 620, 430, 150  # of the panels below the camera, and of the numbers in one [px]
_BLIND_HEIGHT = 640  # of the panels without a camera [px]


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
    plan: PlanView
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
            plan=PlanView.of_run((PLAN_WIDTH, height), result),
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
    canvas.write(panel, "off-tracking [m], + when the hitch's path lies left", (20, 126), size=14, colour=canvas.SOFT)
    panel[READINGS:] = chart.draw(now, curves)
    return panel


def side_by_side(left: canvas.Picture, right: canvas.Picture) -> canvas.Picture:
    """Two panels of the same height with a line between them."""
    return np.concatenate([left, np.full((len(left), 1, 3), canvas.LINE, np.uint8), right], axis=1)


def _newest(signal: tuple[FloatArray, FloatArray], now: float) -> str:
    known = signal[1][signal[0] <= now]
    return f"{known[-1]:+z.3f} m" if known.size else "none"
