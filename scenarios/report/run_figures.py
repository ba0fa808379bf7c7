"""The figures of a report, each as the text of an SVG element to be put into the page.

Lettering stays text, so that the page's own typeface applies and numbers can be searched and copied.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from scenarios.report.drawing import ESTIMATED, GREY, INK, TRUE, WIDTH, drawn
from scenarios.results.log import LOST
from scenarios.results.run import RunResult, error_of_estimate
from scenarios.results.swept_path import placed, placed_wheels
from vehicle.frames import FloatArray

_ROAD, _SWEPT, _LOST = "#eef0f2", "#cfe0f1", "#f6d5d2"
_AXLES = ("#1f5fa8", "#2a9d8f", "#8e5ea2", "#c2571a")
_SLENDER = 0.15  # height over width of a course below which it is not drawn to scale


def plan_view(result: RunResult) -> str:
    """The course from above: road, swept path, paths of hitch and follow point, the combination now and then."""
    poses = [result.poses(unit) for unit in result.units]
    swept = [placed(unit.corners, pose) for unit, pose in zip(result.units, poses, strict=True)]
    everything = np.concatenate([corners.reshape(-1, 2) for corners in swept])
    low, high = everything.min(axis=0) - 2.0, everything.max(axis=0) + 2.0
    shape = float((high[1] - low[1]) / (high[0] - low[0]))
    slender = shape < _SLENDER  # to scale, a straight road would be a thread in which nothing can be told apart
    height = 2.9 if slender else min(WIDTH * shape + 0.9, 8.2)
    with drawn("plan", height) as (drawing, ax):
        ax.add_collection(PolyCollection([_band(result.road, result.road_half_width)], facecolor=_ROAD, zorder=0.5))
        rows = _rows_every(poses[0], 0.15)
        for corners in swept:
            ax.add_collection(PolyCollection(list(corners[rows]), facecolor=_SWEPT, edgecolor=_SWEPT, linewidth=0.4))
        ax.plot([], [], color=_SWEPT, linewidth=7, label="swept by the bodies")
        if not slender:
            _combination(ax, result, poses)
        hitch = poses[-1][:, :2]
        follow = placed(np.array([[-result.follow_distance, 0.0]]), poses[-1])[:, 0]
        ax.plot(*hitch.T, color=TRUE, linewidth=1.7, label="path of the hitch", zorder=4)
        ax.plot(*follow.T, color=ESTIMATED, linewidth=1.5, label="path of the follow point", zorder=5)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]")
        ax.set(aspect="auto" if slender else "equal", ylabel="y [m], stretched" if slender else "y [m]")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return drawing.svg


def _combination(ax: Axes, result: RunResult, poses: list[FloatArray]) -> None:
    """Outlines and wheels of the combination at five moments, equally far apart."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[0][:, :2], axis=0).T))])
    rows = np.minimum(np.searchsorted(travelled, np.linspace(0.0, travelled[-1], 5)), len(travelled) - 1)
    for unit, pose in zip(result.units, poses, strict=True):
        bodies = placed(unit.corners, pose[rows])
        ax.add_collection(PolyCollection(list(bodies), facecolor="none", edgecolor=INK, linewidth=0.9, zorder=3))
        tyres = placed_wheels(unit, pose[rows], result.axle_steer(unit)[rows]).reshape(-1, 4, 2)
        ax.add_collection(PolyCollection(list(tyres), facecolor=INK, linewidth=0.0, zorder=3))


def _band(centre_line: FloatArray, half_width: float) -> FloatArray:
    """Outline of a road, shape (2 n, 2)."""
    along = np.gradient(centre_line, axis=0)
    along /= np.maximum(np.hypot(*along.T), 1e-12)[:, None]  # repeated points have no direction
    left = half_width * np.column_stack([-along[:, 1], along[:, 0]])
    return np.concatenate([centre_line + left, (centre_line - left)[::-1]])


def _rows_every(pose: FloatArray, spacing: float) -> NDArray[np.intp]:
    """Rows about ``spacing`` metres of travel apart."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))])
    rows: NDArray[np.intp] = np.unique(np.searchsorted(travelled, np.arange(0.0, travelled[-1], spacing)))
    return rows


def off_tracking(result: RunResult) -> str:
    """True and estimated off-tracking over time."""
    with drawn("off_tracking", 2.9) as (drawing, ax):
        there = _usable(result)
        ax.plot(result.log["time"], result.signal("off_tracking_true"), color=TRUE, label="true", zorder=4)
        if there.any():
            estimate = result.signal("off_tracking_estimate")
            ax.plot(*_at(result, estimate, there), ".", color=ESTIMATED, markersize=6.0, label="estimated")
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        _finish(ax, result, "off-tracking [m], + left")
    return drawing.svg


def estimate_error(result: RunResult) -> str:
    """Error of the estimate over time, inside the band of twice the standard deviation it states."""
    with drawn("error", 2.7) as (drawing, ax):
        there = _usable(result)
        time, error = _at(result, 1e3 * error_of_estimate(result), there)
        band = 2e3 * result.signal("off_tracking_std")[there]
        _shade_lost(ax, result, result.signal("health"), "no estimate")
        ax.fill_between(time, -band, band, color="#f9e3cf", linewidth=0.0, label="±2 σ as stated by the estimator")
        ax.plot(time, error, ".-", color=ESTIMATED, linewidth=0.9, markersize=4.0, label="estimate minus truth")
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        _finish(ax, result, "error [mm]")
    return drawing.svg


def steer(result: RunResult) -> str:
    """Steer angles of the trailer's axles, as they are and as commanded, with the limit of the actuators."""
    time = result.log["time"]
    with drawn("steer", 2.9) as (drawing, ax):
        for k, name in enumerate(result.steer_signals()):
            colour = _AXLES[k % len(_AXLES)]
            ax.plot(
                time, np.degrees(result.signal(f"{name}_command")), color=colour, linewidth=1.0, linestyle=(0, (3, 2))
            )
            ax.plot(time, np.degrees(result.log[name]), color=colour, label=f"trailer axle {k + 1}")
        ax.plot(time, np.degrees(result.signal("steer_tractor")), color=GREY, linewidth=1.0, label="tractor")
        ax.plot([], [], color=INK, linewidth=1.0, linestyle=(0, (3, 2)), label="commanded")
        if result.trailer_steer_limit is not None:
            for limit in (-1, 1):
                ax.axhline(
                    limit * math.degrees(result.trailer_steer_limit), color="#b3261e", linewidth=0.9, dashes=(6, 3)
                )
            ax.plot([], [], color="#b3261e", linewidth=0.9, dashes=(6, 3), label="limit")
        _finish(ax, result, "steer [°], + left")
    return drawing.svg


def matches(result: RunResult) -> str:
    """Features matched and kept by the odometry, frame by frame."""
    with drawn("matches", 2.3) as (drawing, ax):
        there = np.isfinite(result.signal("matches"))
        _shade_lost(ax, result, result.signal("odometry_health"), "odometry lost")
        ax.plot(*_at(result, result.signal("matches"), there), color=GREY, label="matches")
        ax.plot(*_at(result, result.signal("inliers"), there), color=TRUE, label="inliers")
        ax.set_ylim(bottom=0.0)
        _finish(ax, result, "features [-]")
    return drawing.svg


def _usable(result: RunResult) -> NDArray[np.bool_]:
    """Rows that hold an estimate which is not lost."""
    health = result.signal("health")
    return np.isfinite(health) & (health < LOST)


def _at(result: RunResult, values: FloatArray, rows: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    return result.log["time"][rows], values[rows]


def _shade_lost(ax: Axes, result: RunResult, health: FloatArray, label: str) -> None:
    """Shades the time from each capture with lost health to the next capture."""
    captures = np.flatnonzero(np.isfinite(health))
    time = np.append(result.log["time"][captures], result.log["time"][-1])
    lost = np.concatenate([[False], health[captures] >= LOST, [False]])
    edges = np.flatnonzero(np.diff(lost.astype(np.int8)))
    for k, (first, last) in enumerate(edges.reshape(-1, 2)):
        ax.axvspan(time[first], time[last], color=_LOST, linewidth=0.0, label=label if k == 0 else None)


def _finish(ax: Axes, result: RunResult, ylabel: str) -> None:
    ax.set(xlim=(0.0, float(result.log["time"][-1])), xlabel="time [s]", ylabel=ylabel)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, borderaxespad=0.2, handlelength=1.6)
