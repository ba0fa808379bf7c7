"""The report of a trailer's run, and its figures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from offtrack.reports import plots
from offtrack.reports.page import Column, Figure, Items, Player, Row, Section, Table
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.run_playback import trailer_playback
from offtrack.reports.run_video import flow_photos
from offtrack.reports.sections import (
    ERROR_TEXT,
    FEATURES_TEXT,
    groups,
    number_table,
    provenance_sections,
    run_html,
    timing_section,
)
from scenarios.results.log import LOST
from scenarios.results.run_summary import Summary, manifest
from scenarios.results.swept_path import placed, placed_wheels
from scenarios.results.trailer_result import (
    CameraFrame,
    FrictionPicture,
    RunResult,
    error_of_estimate,
    trailer_summaries,
)
from vehicle.clock import TICK
from vehicle.frames import FloatArray, arc_length, rows_every, sides

_ROAD = "#eef0f2"
_DASHED = (0, (3, 2))
_ICE = (0.49, 0.29, 0.66)  # colour of slippery ground
_STRONGEST = 0.45  # opacity of the most slippery
_MOST_FRICTIONS = 4  # shades
_MOMENTS = 5  # at which the combination is plots.drawn in the plan view


def plan_view(result: RunResult) -> Figure:
    """The course from above: road, swept path, paths of hitch and follow point, and the combination at some moments."""
    poses = [result.poses(unit) for unit in result.units]
    swept = [placed(unit.corners, pose) for unit, pose in zip(result.units, poses, strict=True)]
    with plots.plan_drawn("plan", swept, tallest=8.2) as (drawing, ax):
        ax.add_collection(PolyCollection([_band(result.road, result.road_half_width)], facecolor=_ROAD, zorder=0.5))
        if result.friction is not None:
            _slippery(ax, result.friction)
        rows = rows_every(poses[0][:, :2], 0.15)
        plots.swept_bodies(ax, [corners[rows] for corners in swept])
        if drawing.to_scale:
            _combination(ax, result, poses)
        follow = placed(np.array([[-result.follow_distance, 0.0]]), poses[-1])[:, 0]
        ax.plot(*poses[-1][:, :2].T, color=plots.TRUE, linewidth=1.7, label=f"path of the {result.leader}", zorder=4)
        ax.plot(*follow.T, color=plots.ESTIMATED, label="path of the follow point", zorder=5)
    return drawing.content


def _slippery(ax: Axes, friction: FrictionPicture) -> None:
    """Shades ground that is more slippery than the best: a step of colour for each step of friction."""
    best = float(friction.values.max())
    levels = np.unique(np.round(friction.values, 1))
    edges = np.linspace(float(friction.values.min()), best, min(len(levels), _MOST_FRICTIONS) + 1)
    x, y = (
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in zip(friction.low, friction.high, friction.values.shape[::-1], strict=True)
    )
    steps = len(edges) - 1
    for k, (low, high) in enumerate(pairwise(edges.tolist())):
        if k == steps - 1:
            continue  # the best stays white, as ground elsewhere
        inside = friction.values <= high
        if k:
            inside &= friction.values > low
        colour = (*_ICE, _STRONGEST * (steps - 1 - k) / (steps - 1))
        ax.contourf(x, y, inside.astype(np.float64), levels=[0.5, 1.5], colors=[colour], zorder=0.6)
        mean = float(friction.values[inside].mean()) if inside.any() else low
        ax.add_patch(Rectangle((0.0, 0.0), 0.0, 0.0, facecolor=colour, label=f"friction {mean:.2f}"))


def _combination(ax: Axes, result: RunResult, poses: list[FloatArray]) -> None:
    """Outlines and wheels of the combination at moments equally far apart along its path."""
    along = arc_length(poses[0][:, :2])
    rows = np.minimum(np.searchsorted(along, np.linspace(0.0, along[-1], _MOMENTS)), len(along) - 1)
    for unit, pose in zip(result.units, poses, strict=True):
        plots.outlines(ax, placed(unit.corners, pose[rows]))
        tyres = placed_wheels(unit, pose[rows], result.axle_steer(unit)[rows]).reshape(-1, 4, 2)
        ax.add_collection(PolyCollection(list(tyres), facecolor=plots.INK, linewidth=0.0, zorder=3))


def _band(centre_line: FloatArray, half_width: float | FloatArray) -> FloatArray:
    """Outline of a road, shape (2 n, 2)."""
    left, right = sides(centre_line, half_width)
    return np.concatenate([left, right[::-1]])


def off_tracking(result: RunResult) -> Figure:
    """True and estimated off-tracking over time."""
    with plots.drawn("off_tracking") as (drawing, ax):
        usable = _usable(result)
        time = result.log["time"]
        ax.plot(time, result.signal("off_tracking_true"), color=plots.TRUE, label="true", zorder=4)
        if usable.any():
            estimate = result.signal("off_tracking_estimate")[usable]
            ax.plot(time[usable], estimate, ".", color=plots.ESTIMATED, label="estimated")
        plots.over_time(ax, time, "off-tracking [m], + left")
    return drawing.content


def estimate_error(result: RunResult) -> Figure:
    """Error of the estimate over time, inside the band of twice its stated standard deviation."""
    with plots.drawn("error") as (drawing, ax):
        usable = _usable(result)
        _shade_lost(ax, result, result.signal("health"), "no estimate")
        error, std = 1e3 * error_of_estimate(result), 1e3 * result.signal("off_tracking_std")
        plots.error_band(ax, result.log["time"][usable], error[usable], std[usable])
        plots.over_time(ax, result.log["time"], "error [mm]")
    return drawing.content


def steer(result: RunResult) -> Figure:
    """Actual and commanded steer angles of the trailer's axles, with the limit of the actuators."""
    time = result.log["time"]
    with plots.drawn("steer") as (drawing, ax):
        names = zip(result.steer_signals(), result.steer_signals(demands=True), strict=True)
        for k, (name, demand) in enumerate(names):
            colour = plots.SERIES[k % len(plots.SERIES)]
            command, actual = np.degrees(result.signal(demand)), np.degrees(result.log[name])
            ax.plot(time, command, color=colour, linewidth=1.0, linestyle=_DASHED)
            ax.plot(time, actual, color=colour, label=f"{result.steered_name} {k + 1}")
        ax.plot(
            time,
            np.degrees(result.signal("steer_tractor")),
            color=plots.GREY,
            linewidth=1.0,
            label=result.units[0].name,
        )
        ax.plot([], [], color=plots.INK, linewidth=1.0, linestyle=_DASHED, label="commanded")
        if result.trailer_steer_limit is not None:
            plots.limit_lines(ax, math.degrees(result.trailer_steer_limit), "limit")
        plots.over_time(ax, time, "steer angle [°], + left", zero=False)
    return drawing.content


def matches(result: RunResult) -> Figure:
    """Matched features and inliers of the odometry, frame by frame."""
    with plots.drawn("matches", 2.5) as (drawing, ax):
        known = np.isfinite(result.signal("matches"))
        time = result.log["time"]
        _shade_lost(ax, result, result.signal("odometry_health"), "odometry lost")
        for name, colour in (("matches", plots.GREY), ("inliers", plots.TRUE)):
            ax.plot(time[known], result.signal(name)[known], color=colour, label=name)
        ax.set_ylim(bottom=0.0)
        plots.over_time(ax, time, "features per frame [-]", zero=False)
    return drawing.content


def _usable(result: RunResult) -> NDArray[np.bool_]:
    """Rows that hold an estimate which is not lost."""
    health = result.signal("health")
    return np.isfinite(health) & (health < LOST)


def _shade_lost(ax: Axes, result: RunResult, health: FloatArray, label: str) -> None:
    """Shades the time from each capture with lost health to the next capture."""
    captures = np.flatnonzero(np.isfinite(health))
    edges = np.append(result.log["time"][captures], result.log["time"][-1])
    plots.shade(ax, edges, health[captures] >= LOST, plots.LOST_BAND, label)


_ON_CARDS: Final = (
    "off_tracking.true_rms_m",
    "off_tracking.estimate_error_rms_m",
    "swept_path.max_width_m",
    "timing.realtime_factor",
)


def report_html(result: RunResult, summary: Summary) -> str:
    """The page as HTML; ``summary`` is the run in numbers as its method ``summary`` gives it."""
    return run_html(result, summary, _ON_CARDS, _sections(result, summary))


def _sections(result: RunResult, summary: Summary) -> Iterator[Section]:
    if warnings := result.all_warnings():
        yield Section("Warnings", content=[Items(warnings)])
    if len(result.log) > 1:
        yield Section("Playback", content=[Player(encoded(trailer_playback(result)))])
        yield from _drawn(result)
    else:
        yield Section("Nothing to draw", "The run ended before the vehicle had moved.")
    yield Section("All numbers", content=[number_table(summary)])
    if result.trailers_ahead:
        yield Section("Trailers", _TRAILERS, [_trailers(result)])
    yield timing_section(result.timing, ("physics", "rendering", "odometry"))
    yield from provenance_sections(result.scenario_toml, manifest(result))


def _drawn(result: RunResult) -> Iterator[Section]:
    yield Section("Plan view", _PLAN.format(result.follow_distance, result.leader), [plan_view(result)])
    yield Section("Off-tracking", _OFF_TRACKING.format(result.leader, result.trailer.name), [off_tracking(result)])
    if np.isfinite(result.signal("health")).any():
        yield Section("Error of the estimate", ERROR_TEXT, [estimate_error(result)])
    else:
        yield Section("No estimate", "This run had no estimator of the off-tracking.")
    if result.steer_signals():
        yield Section("Steer angles", _STEER, [steer(result)])
    if result.frames:
        frame = _shown_frame(result)
        yield Section("Camera image", _caption(frame), [flow_photos(frame)])
    else:
        yield Section("No camera images", "This run kept no camera images.")
    if np.isfinite(result.signal("matches")).any():
        yield Section("Features", FEATURES_TEXT, [matches(result)])


_PLAN: Final = (
    "The follow point lies {0:.1f} m behind the {1}. It should retrace the path of the {1}; it does where orange "
    "covers blue."
)
_OFF_TRACKING: Final = (
    "Lateral distance from the follow point to the path of the {0}, in the frame of the {1}. It is known once the {1} "
    "has driven its own length. Each estimate is drawn at the time its image was taken."
)
_STEER: Final = "Solid: actual angles of the road wheels. Dashed: angles that the controller commanded."
_TRAILERS: Final = (
    "Each trailer follows its own hitch. The figures above show the last trailer. The off-tracking and steering in the "
    "table above belong to the trailer with the largest off-tracking."
)


def _trailers(result: RunResult) -> Table:
    """Off-tracking and steering of every watched trailer side by side."""
    of_each = trailer_summaries(result)
    rows: list[Row] = []
    for group, prefix in (("off_tracking", ""), ("steer", "steer_")):
        for name, number in groups()[group].numbers.items():
            values = [numbers.get(prefix + name) for numbers in of_each.values()]
            if any(value is not None for value in values):
                rows.append([number.label, *(number.text(value) for value in values)])
    return Table((Column("name"), *(Column("number", name) for name in of_each)), rows)


def _shown_frame(result: RunResult) -> CameraFrame:
    """The frame taken where the off-tracking was largest: in the middle of the turn, where the image flows most."""
    true = result.signal("off_tracking_true")
    if not np.isfinite(true).any():
        return result.frames[len(result.frames) // 2]
    worst = 1e3 * float(result.log["time"][np.nanargmax(np.abs(true))])
    return min(result.frames, key=lambda frame: abs(frame.tick - worst))


def _caption(frame: CameraFrame) -> str:
    time = f"{frame.tick * TICK:.1f} s"
    if not len(frame.tracks):
        return f"Left camera at {time}."
    return (
        f"Left camera at {time}, where the off-tracking was largest: {frame.matches} matches, {frame.inliers} of them "
        "inliers. Each stroke runs from a feature's position in the previous frame to its position in this one."
    )
