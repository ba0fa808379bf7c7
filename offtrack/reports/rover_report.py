"""The report and the video of a rover's run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from offtrack.reports import canvas, plots
from offtrack.reports.canvas import Reel, write_reel
from offtrack.reports.page import Figure, Photo, Photos, Player, Section
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.run_playback import rover_playback
from offtrack.reports.run_video import picture as trace_picture
from offtrack.reports.run_video import traced
from offtrack.reports.sections import number_table, provenance_sections, run_html, timing_section
from scenarios.progress import Progress, no_progress
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_summary import Summary, manifest
from vehicle.clock import TICK
from vehicle.frames import FloatArray, arc_length

_ON_CARDS: Final = ("slip.cross_track_rms_m", "slip.error_rms_deg", "slip.true_mean_deg", "timing.realtime_factor")
_SHOWN: Final = (0.15, 0.5, 0.85)  # frames on the page, as shares of the run
_LAGGED, _LASER = "#12935f", "#b8c0c8"
_WHEELS, _CORRECTED = "dead reckoning by wheels and compass", "corrected by the slip angle"


def rover_report_html(result: RoverResult, summary: Summary) -> str:
    """The page as HTML."""
    return run_html(result, summary, _ON_CARDS, _sections(result, summary))


def _sections(result: RoverResult, summary: Summary) -> Iterator[Section]:
    if len(result.log) > 1:
        yield Section("Playback", content=[Player(encoded(rover_playback(result)))])
        yield from _drawn(result)
    yield Section("All numbers", content=[number_table(summary)])
    yield timing_section(result.timing, ("physics", "sand and camera", "slip estimator"))
    yield from provenance_sections(result.scenario_toml, manifest(result))


def _drawn(result: RoverResult) -> Iterator[Section]:
    yield Section("Plan view", "The path to follow, the path driven, and two estimates of it by dead reckoning.",
                  [_plan(result)])  # fmt: skip
    if result.frames:
        wheel = result.rig.wheels[result.rig.watched].name
        text = (
            f"Ground behind the {wheel.replace('_', ' ')} wheel. Blue: true direction of travel. Orange: direction "
            "estimated from the trace."
        )
        yield Section("Camera images", text, [_photos(result)])
    yield Section("Slip angle", "Angle from the body's axis to the direction of travel, + left.",
                  [_slip(result)])  # fmt: skip
    if np.isfinite(result.slip_error).any():
        text = "About 95 % of the errors lie inside the band if the estimator states its standard deviation correctly."
        yield Section("Error of the estimate", text, [_error(result)])
    yield Section("Cross-track error", "Lateral distance of the rover from its path.", [_cross_track(result)])
    if np.isfinite(result.log["x_corrected"]).any():
        text = (
            "Dead reckoning by wheels and compass assumes that the rover moves along its axis. The corrected one turns "
            "each step by the estimated slip angle."
        )
        yield Section("Position error", text, [_position(result)])
    yield Section("Wheels", "Slip ratio: share of a wheel's rolling distance by which the rover does not advance.",
                  [_wheels(result)])  # fmt: skip


def _photos(result: RoverResult) -> Photos:
    shown = [result.frames[round(share * (len(result.frames) - 1))] for share in _SHOWN]
    size = result.rig.camera.width, result.rig.camera.height
    return Photos(
        [Photo(traced(result, one), size, f"ground behind the wheel at {one.tick * TICK:.1f} s") for one in shown]
    )


def _plan(result: RoverResult) -> Figure:
    """The path to follow, the path driven, and two dead-reckoned paths."""
    log = result.log
    driven = np.column_stack([log["x"], log["y"]])
    reckoned = [np.column_stack([log[f"x_{name}"], log[f"y_{name}"]]) for name in ("wheels", "corrected")]
    with plots.plan_drawn("rover plan", (result.path, driven, *reckoned), margin=0.3, tallest=6.5) as (drawing, ax):
        ax.plot(*result.path.T, color=plots.GREY, linewidth=4.0, alpha=0.5, label="path to follow")
        ax.plot(*driven.T, color=plots.TRUE, label="path driven")
        ax.plot(*reckoned[0].T, color=plots.INK, dashes=(4, 3), linewidth=1.0, label=_WHEELS)
        ax.plot(*reckoned[1].T, color=plots.ESTIMATED, linewidth=1.2, label=_CORRECTED)
    return drawing.content


def _slip(result: RoverResult) -> Figure:
    """True and estimated slip angle over time, as Fig. 8 of Reina et al. (2008)."""
    log = result.log
    time = log["time"]
    with plots.drawn("rover slip", 3.2) as (drawing, ax):
        for name, style, colour, label in (
            ("laser", "-", _LASER, "laser and compass"),
            ("estimate", ".", plots.ESTIMATED, "estimated"),
            ("lagged", "-", _LAGGED, "estimated 2 s later"),
        ):
            value = np.degrees(log[f"slip_angle_{name}"])
            known = np.isfinite(value)
            if known.any():
                ax.plot(time[known], value[known], style, color=colour, label=label)
        ax.plot(time, np.degrees(log["slip_angle_true"]), color=plots.TRUE, label="true")
        plots.over_time(ax, time, "slip angle [°], + left")
    return drawing.content


def _error(result: RoverResult) -> Figure:
    """Error of the estimate over time, inside the band of twice its stated standard deviation."""
    log = result.log
    known = np.isfinite(result.slip_error)
    with plots.drawn("rover slip error", 2.7) as (drawing, ax):
        error, std = np.degrees(result.slip_error[known]), np.degrees(log["slip_angle_std"][known])
        plots.error_band(ax, log["time"][known], error, std)
        plots.over_time(ax, log["time"], "error [°]")
    return drawing.content


def _cross_track(result: RoverResult) -> Figure:
    """Cross-track error over the distance along the path."""
    with plots.drawn("rover cross-track", 2.6) as (drawing, ax):
        plots.zero_line(ax)
        ax.plot(result.log["station"], 1e3 * result.log["cross_track_true"], color=plots.TRUE)
        ax.set(xlabel="distance along the path [m]", ylabel="cross-track error [mm], + left")
    return drawing.content


def _position(result: RoverResult) -> Figure:
    """Position error of both dead reckonings over the distance driven."""
    log = result.log
    distance = arc_length(np.column_stack([log["x"], log["y"]]))
    with plots.drawn("rover position", 2.6) as (drawing, ax):
        for name, colour, label in (("wheels", plots.INK, _WHEELS), ("corrected", plots.ESTIMATED, _CORRECTED)):
            error = np.hypot(log[f"x_{name}"] - log["x"], log[f"y_{name}"] - log["y"])
            ax.plot(distance, error, color=colour, label=label)
        ax.set(xlabel="distance driven [m]", ylabel="position error [m]", ylim=(0.0, None))
    return drawing.content


def _wheels(result: RoverResult) -> Figure:
    """Longitudinal slip of every wheel over time."""
    log = result.log
    with plots.drawn("rover wheels", 2.6) as (drawing, ax):
        for wheel, colour in zip(result.rig.wheels, plots.SERIES, strict=False):
            ratio, label = log[f"slip_ratio_{wheel.name}"], wheel.name.replace("_", " ")
            ax.plot(log["time"], ratio, color=colour, linewidth=1.0, label=label)
        plots.over_time(ax, log["time"], "slip ratio [-]", zero=False)
    return drawing.content


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
