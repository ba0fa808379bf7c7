"""The report of a rover's run, and its figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from scenarios.player.encoding import encoded
from scenarios.player.rover import rover_playback
from scenarios.report import plots
from scenarios.report.numbers import number_table
from scenarios.report.page import Figure, Photo, Photos, Player, Section
from scenarios.report.run_sections import provenance_sections, run_html, timing_section
from scenarios.report.trace_view import traced
from scenarios.results.manifest import manifest
from scenarios.results.numbers import Summary
from scenarios.results.rover import RoverResult
from vehicle.clock import TICK
from vehicle.polyline import arc_length

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
