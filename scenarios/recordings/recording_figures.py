"""Figures of a recording's report."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes

from scenarios.recordings.estimation import Estimation
from scenarios.recordings.summary import error_of_estimate
from scenarios.report import plots
from scenarios.report.page import Figure
from scenarios.results.log import LOST, Log
from vehicle.frames import FloatArray

_DEGRADED, _DROPPED = "#fbf3d0", "#d9dde2"
_TIME: Final = "time since the first frame [s]"


def plan_view(estimation: Estimation) -> Figure:
    """Paths of hitch and follow point from above, and the hitch's path by the recording's own poses."""
    hitch, follow = paths(estimation, estimation.X_S0S)
    true = estimation.true_X_S0S
    with plots.plan_drawn("plan", [hitch, follow] + ([] if true is None else [true[:, :2, 3]])) as (drawing, ax):
        if true is not None:
            ax.plot(
                *true[:, :2, 3].T,
                color=plots.GREY,
                linewidth=4.5,
                alpha=0.55,
                label="path of the hitch, recorded poses",
            )
        ax.plot(*hitch.T, color=plots.TRUE, label="path of the hitch, odometry")
        ax.plot(*follow.T, color=plots.ESTIMATED, linewidth=1.2, label="path of the follow point, odometry")
        ax.plot(*hitch[0], "o", color=plots.TRUE, markersize=5.0)
    return drawing.content


def paths(estimation: Estimation, X_S0S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Paths (n, 2) of hitch and follow point along the axes of the first trailer frame."""
    follow = X_S0S[:, :2, 3] - estimation.recording.follow_distance * X_S0S[:, :2, 0]
    return X_S0S[:, :2, 3], follow


def off_tracking(log: Log) -> Figure:
    """Off-tracking over time with twice its standard deviation, and that of the recording's own poses."""
    with plots.drawn("off_tracking", 3.0) as (drawing, ax):
        time = elapsed(log)
        value, band = log["off_tracking"], 2.0 * log["off_tracking_std"]
        _shade(ax, log)
        ax.fill_between(time, value - band, value + band, color=plots.BAND, linewidth=0.0, label="±2 σ stated")
        if np.isfinite(log["off_tracking_poses"]).any():
            ax.plot(time, log["off_tracking_poses"], color=plots.TRUE, label="recorded poses", zorder=4)
        ax.plot(time, value, ".-", color=plots.ESTIMATED, linewidth=0.9, markersize=4.0, label="estimated")
        plots.over_time(ax, time, "off-tracking [m], + left", xlabel=_TIME)
    return drawing.content


def error(log: Log) -> Figure:
    """Error of the estimate against the recording's own poses, inside the band it states."""
    with plots.drawn("error", 2.7) as (drawing, ax):
        _shade(ax, log)
        plots.error_band(ax, elapsed(log), 1e3 * error_of_estimate(log), 1e3 * log["off_tracking_std"])
        plots.over_time(ax, elapsed(log), "error [mm]", xlabel=_TIME)
    return drawing.content


def features(log: Log) -> Figure:
    """Matches and inliers frame by frame, with the health of the odometry behind them."""
    with plots.drawn("features", 2.5) as (drawing, ax):
        _shade(ax, log)
        for name, colour in (("matches", plots.GREY), ("inliers", plots.TRUE)):
            ax.plot(elapsed(log), log[name], color=colour, label=name)
        ax.set_ylim(bottom=0.0)
        plots.over_time(ax, elapsed(log), "features per frame [-]", xlabel=_TIME, zero=False)
    return drawing.content


def right_rotation(log: Log) -> Figure:
    """Estimated rotation of the right camera, with twice its standard deviation."""
    with plots.drawn("rotation", 2.7) as (drawing, ax):
        time = elapsed(log)
        for name, colour in zip(("roll", "yaw", "pitch"), plots.SERIES, strict=False):
            angle, band = (np.degrees(log[f"right_{name}{end}"]) for end in ("", "_std"))
            ax.fill_between(time, angle - 2.0 * band, angle + 2.0 * band, color=colour, alpha=0.15, linewidth=0.0)
            ax.plot(time, angle, color=colour, label=name)
        plots.over_time(ax, time, "angle [°]", xlabel=_TIME)
    return drawing.content


def elapsed(log: Log) -> FloatArray:
    """Time since the first frame [s]."""
    since: FloatArray = log["time"] - log["time"][0]
    return since


def _shade(ax: Axes, log: Log) -> None:
    """Shades the time before each frame that was dropped or whose motion was degraded or lost."""
    time, health = elapsed(log), log["odometry_health"]
    edges = np.concatenate([time[:1], time])
    plots.shade(ax, edges, health == 1.0, _DEGRADED, "odometry degraded")
    plots.shade(ax, edges, health >= LOST, plots.LOST_BAND, "odometry lost")
    plots.shade(ax, edges, log["dropped"] > 0.0, _DROPPED, "frame dropped")
