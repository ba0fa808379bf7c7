"""Figures of a rover's run."""

from __future__ import annotations

import numpy as np

from scenarios.report import plots
from scenarios.report.page import Figure
from scenarios.results.rover import RoverResult
from vehicle.polyline import arc_length

_LAGGED, _LASER = "#12935f", "#b8c0c8"
_WHEELS, _CORRECTED = "dead reckoning by wheels and compass", "corrected by the slip angle"


def plan(result: RoverResult) -> Figure:
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


def slip(result: RoverResult) -> Figure:
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


def error(result: RoverResult) -> Figure:
    """Error of the estimate over time, inside the band of twice its stated standard deviation."""
    log = result.log
    known = np.isfinite(result.slip_error)
    with plots.drawn("rover slip error", 2.7) as (drawing, ax):
        error, std = np.degrees(result.slip_error[known]), np.degrees(log["slip_angle_std"][known])
        plots.error_band(ax, log["time"][known], error, std)
        plots.over_time(ax, log["time"], "error [°]")
    return drawing.content


def cross_track(result: RoverResult) -> Figure:
    """Cross-track error over the distance along the path."""
    with plots.drawn("rover cross-track", 2.6) as (drawing, ax):
        plots.zero_line(ax)
        ax.plot(result.log["station"], 1e3 * result.log["cross_track_true"], color=plots.TRUE)
        ax.set(xlabel="distance along the path [m]", ylabel="cross-track error [mm], + left")
    return drawing.content


def position(result: RoverResult) -> Figure:
    """Position error of both dead reckonings over the distance driven."""
    log = result.log
    distance = arc_length(np.column_stack([log["x"], log["y"]]))
    with plots.drawn("rover position", 2.6) as (drawing, ax):
        for name, colour, label in (("wheels", plots.INK, _WHEELS), ("corrected", plots.ESTIMATED, _CORRECTED)):
            error = np.hypot(log[f"x_{name}"] - log["x"], log[f"y_{name}"] - log["y"])
            ax.plot(distance, error, color=colour, label=label)
        ax.set(xlabel="distance driven [m]", ylabel="position error [m]", ylim=(0.0, None))
    return drawing.content


def wheels(result: RoverResult) -> Figure:
    """Longitudinal slip of every wheel over time."""
    log = result.log
    with plots.drawn("rover wheels", 2.6) as (drawing, ax):
        for wheel, colour in zip(result.rig.wheels, plots.SERIES, strict=False):
            ratio, label = log[f"slip_ratio_{wheel.name}"], wheel.name.replace("_", " ")
            ax.plot(log["time"], ratio, color=colour, linewidth=1.0, label=label)
        plots.over_time(ax, log["time"], "slip ratio [-]", zero=False)
    return drawing.content
