"""Figures of a recording's report, each as the text of an SVG element."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes

from scenarios.recordings.estimation import Estimation
from scenarios.recordings.summary import error_of_estimate
from scenarios.report.drawing import ESTIMATED, GREY, TRUE, WIDTH, drawn
from scenarios.results.log import LOST, Log
from vehicle.frames import FloatArray

_TALLEST: Final = 7.5  # [in]
_BAND, _LOST, _DEGRADED, _DROPPED = "#f9e3cf", "#f6d5d2", "#fbf3d0", "#d9dde2"
_PITCH = "#2a9d8f"
_SLENDER = 0.15  # height over width of a way below which it is not drawn to scale


def plan_view(estimation: Estimation) -> str:
    """The way from above: paths of hitch and follow point, and the hitch's path by the recording's own poses."""
    hitch, follow = paths(estimation, estimation.X_S0S)
    true = estimation.true_X_S0S
    lines = [hitch, follow] + ([] if true is None else [true[:, :2, 3]])
    low, high = (
        np.min([p.min(axis=0) for p in lines], axis=0) - 2.0,
        np.max([p.max(axis=0) for p in lines], axis=0) + 2.0,
    )
    shape = float((high[1] - low[1]) / (high[0] - low[0]))
    slender = shape < _SLENDER
    with drawn("plan", 2.9 if slender else min(WIDTH * shape + 0.9, _TALLEST)) as (figure, ax):
        if true is not None:
            ax.plot(*true[:, :2, 3].T, color=GREY, linewidth=4.5, alpha=0.55, label="hitch by the recording's poses")
        ax.plot(*hitch.T, color=TRUE, label="path of the hitch by the odometry")
        ax.plot(*follow.T, color=ESTIMATED, linewidth=1.2, label="path of the follow point")
        ax.plot(*hitch[0], "o", color=TRUE, markersize=5.0)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]")
        ax.set(aspect="auto" if slender else "equal", ylabel="y [m], stretched" if slender else "y [m]")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure.svg


def paths(estimation: Estimation, X_S0S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Paths (n, 2) of hitch and follow point along the axes of the first trailer frame."""
    follow = X_S0S[:, :2, 3] - estimation.recording.follow_distance * X_S0S[:, :2, 0]
    return X_S0S[:, :2, 3], follow


def off_tracking(log: Log) -> str:
    """Off-tracking over time with twice its standard deviation, beside that of the recording's own poses."""
    with drawn("off_tracking", 3.0) as (figure, ax):
        time = elapsed(log)
        value, band = log["off_tracking"], 2.0 * log["off_tracking_std"]
        _shade(ax, log)
        ax.fill_between(time, value - band, value + band, color=_BAND, linewidth=0.0, label="±2 σ as stated")
        if np.isfinite(log["off_tracking_poses"]).any():
            ax.plot(time, log["off_tracking_poses"], color=TRUE, label="by the recording's poses", zorder=4)
        ax.plot(time, value, ".-", color=ESTIMATED, linewidth=0.9, markersize=4.0, label="estimated")
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        _finish(ax, time, "off-tracking [m], + left")
    return figure.svg


def error(log: Log) -> str:
    """Error of the estimate against the recording's own poses, inside the band it states."""
    with drawn("error", 2.7) as (figure, ax):
        time, band = elapsed(log), 2e3 * log["off_tracking_std"]
        _shade(ax, log)
        ax.fill_between(time, -band, band, color=_BAND, linewidth=0.0, label="±2 σ as stated")
        ax.plot(time, 1e3 * error_of_estimate(log), ".-", color=ESTIMATED, linewidth=0.9, markersize=4.0, label="error")
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        _finish(ax, time, "error [mm]")
    return figure.svg


def features(log: Log) -> str:
    """Matches and inliers frame by frame, over the health of the odometry."""
    with drawn("features", 2.5) as (figure, ax):
        time = elapsed(log)
        _shade(ax, log)
        ax.plot(time, log["matches"], color=GREY, label="matches")
        ax.plot(time, log["inliers"], color=TRUE, label="inliers")
        ax.set_ylim(bottom=0.0)
        _finish(ax, time, "features [-]")
    return figure.svg


def right_rotation(log: Log) -> str:
    """The rotation of the right camera as it is learned, with twice its standard deviation."""
    with drawn("rotation", 2.7) as (figure, ax):
        time = elapsed(log)
        for name, colour in (("roll", TRUE), ("yaw", ESTIMATED), ("pitch", _PITCH)):
            angle, band = (np.degrees(log[f"right_{name}{end}"]) for end in ("", "_std"))
            ax.fill_between(time, angle - 2.0 * band, angle + 2.0 * band, color=colour, alpha=0.15, linewidth=0.0)
            ax.plot(time, angle, color=colour, label=name)
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        _finish(ax, time, "angle [°]")
    return figure.svg


def elapsed(log: Log) -> FloatArray:
    """Time since the first frame [s]."""
    since: FloatArray = log["time"] - log["time"][0]
    return since


def _shade(ax: Axes, log: Log) -> None:
    """Shades the time before each frame whose motion was degraded, lost or that was dropped itself."""
    time, health = elapsed(log), log["odometry_health"]
    for chosen, colour, label in (
        (health == 1.0, _DEGRADED, "odometry degraded"),
        (health >= LOST, _LOST, "odometry lost"),
        (log["dropped"] > 0.0, _DROPPED, "frame dropped"),
    ):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8))).reshape(-1, 2)
        for k, (first, last) in enumerate(edges):
            span = (time[max(first - 1, 0)], time[last - 1])
            ax.axvspan(*span, color=colour, linewidth=0.0, label=label if k == 0 else None)


def _finish(ax: Axes, time: FloatArray, ylabel: str) -> None:
    ax.set(xlim=(0.0, float(time[-1])), xlabel="time since the first frame [s]", ylabel=ylabel)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, borderaxespad=0.2, handlelength=1.6)
