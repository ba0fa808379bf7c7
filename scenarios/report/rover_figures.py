"""Figures of a rover's run, each as the text of an SVG element."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from scenarios.report.drawing import ESTIMATED, GREY, INK, TRUE, drawn
from scenarios.results.rover import RoverResult

_LAGGED, _LASER = "#12935f", "#b8c0c8"
_SLENDER = 0.12  # height over width of a course below which it is not drawn to scale


def plan(result: RoverResult) -> str:
    """The path, where the rover really went, and where it believed to be."""
    log = result.log
    everything = np.vstack([result.path, np.column_stack([log["x"], log["y"]])])
    width, height = np.ptp(everything, axis=0) + 0.3
    slender = bool(height / width < _SLENDER)
    with drawn("rover plan", 2.9 if slender else min(9.0 * height / width + 0.9, 6.5)) as (drawing, ax):
        ax.plot(*result.path.T, color=GREY, linewidth=4.0, alpha=0.5, label="path to follow")
        ax.plot(log["x"], log["y"], color=TRUE, label="where it went")
        ax.plot(log["x_wheels"], log["y_wheels"], color=INK, dashes=(4, 3), linewidth=1.0, label="by its wheels")
        ax.plot(log["x_corrected"], log["y_corrected"], color=ESTIMATED, linewidth=1.2, label="with the slip angle")
        ax.set(aspect="auto" if slender else "equal", xlabel="x [m]", ylabel="y [m], stretched" if slender else "y [m]")
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
    return drawing.svg


def slip(result: RoverResult) -> str:
    """True and estimated slip angle over time, as Fig. 8 of Reina et al. (2008)."""
    log = result.log
    with drawn("rover slip", 3.2) as (drawing, ax):
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        laser = np.isfinite(log["slip_angle_laser"])
        ax.plot(log["time"][laser], np.degrees(log["slip_angle_laser"][laser]), color=_LASER, label="laser and compass")
        there = np.isfinite(log["slip_angle_estimate"])
        ax.plot(
            log["time"][there], np.degrees(log["slip_angle_estimate"][there]), ".", color=ESTIMATED, label="estimated"
        )
        later = np.isfinite(log["slip_angle_lagged"])
        if later.any():
            ax.plot(log["time"][later], np.degrees(log["slip_angle_lagged"][later]), color=_LAGGED, label="2 s later")
        ax.plot(log["time"], np.degrees(log["slip_angle_true"]), color=TRUE, label="true")
        _finish(ax, result, "slip angle [°], + left")
    return drawing.svg


def error(result: RoverResult) -> str:
    """Error of the estimate over time, inside the band of twice the standard deviation it states."""
    log = result.log
    there = np.isfinite(result.slip_error)
    with drawn("rover slip error", 2.7) as (drawing, ax):
        time, band = log["time"][there], np.degrees(2.0 * log["slip_angle_std"][there])
        ax.fill_between(time, -band, band, color="#f9e3cf", linewidth=0.0, label="±2 σ as stated by the estimator")
        ax.plot(time, np.degrees(result.slip_error[there]), ".-", color=ESTIMATED, linewidth=0.8, markersize=3.0)
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        _finish(ax, result, "error [°]")
    return drawing.svg


def cross_track(result: RoverResult) -> str:
    """How far the rover is beside its path over the way along it."""
    log = result.log
    with drawn("rover cross-track", 2.6) as (drawing, ax):
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        ax.plot(log["station"], 1e3 * log["cross_track_true"], color=TRUE)
        ax.set(xlabel="way along the path [m]", ylabel="beside the path [mm], + left")
    return drawing.svg


def position(result: RoverResult) -> str:
    """Error of both dead reckonings over the way."""
    log = result.log
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(log["x"]), np.diff(log["y"])))])
    with drawn("rover position", 2.6) as (drawing, ax):
        for name, colour, label in (
            ("wheels", INK, "by wheels and compass"),
            ("corrected", ESTIMATED, "with the slip angle"),
        ):
            ax.plot(way, np.hypot(log[f"x_{name}"] - log["x"], log[f"y_{name}"] - log["y"]), color=colour, label=label)
        ax.set(xlabel="way [m]", ylabel="position error [m]", ylim=(0.0, None))
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return drawing.svg


def wheels(result: RoverResult) -> str:
    """Longitudinal slip of every wheel over time."""
    log = result.log
    colours = (TRUE, "#4fa3d1", ESTIMATED, "#b8860b", GREY, INK)
    with drawn("rover wheels", 2.6) as (drawing, ax):
        for wheel, colour in zip(result.rig.wheels, colours, strict=False):
            ratio, label = log[f"slip_ratio_{wheel.name}"], wheel.name.replace("_", " ")
            ax.plot(log["time"], ratio, color=colour, linewidth=1.0, label=label)
        _finish(ax, result, "slip ratio [-]")
    return drawing.svg


def _finish(ax: Axes, result: RoverResult, ylabel: str) -> None:
    ax.set(xlim=(0.0, float(result.log["time"][-1])), xlabel="time [s]", ylabel=ylabel)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, borderaxespad=0.2, handlelength=1.6)
