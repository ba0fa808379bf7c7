"""The course along points of a path: smooth path, road, heights and friction, checked against what a vehicle can do."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from controllers.path import Path
from scenarios.courses import Course
from scenarios.roads.fitted_path import Fit, SmoothPath, fitted_path, near, smooth_values
from scenarios.roads.path_file import PathPoints
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import LineFriction, RoadRelief

Guided = Literal["steered_axle", "outer_front_corner", "front_middle"]
_BEYOND: Final = 40.0  # road behind the start and past the end: cameras look along it [m]
_SPACING: Final = 0.25  # between points of the road: at its edge, 2 m away, distances are 4 mm too long at most [m]
_ROADSIDE: Final = 10.0  # beyond the road's edge the ground keeps its bank [m]
_CROSSING: Final = 0.3  # difference of height of a road that crosses itself: a bridge or a gap in the heights [m]


def road_course(points: PathPoints, fit: Fit, tractor: Unit, guided: Guided, width: float) -> Course:
    """The course of a tractor along points; the road is ``width`` [m] wide where they do not say.

    Raises:
        ValueError: one line with the place, if the points make no path, or the tractor can not be steered along it.
    """
    smooth, points = fitted_path(points, fit)
    bends = np.array([segment.start_curvature for segment in smooth.path.segments])
    reference = _guided_point(tractor, guided, float(np.sum(bends * np.abs(bends))))
    path = Path(Pose2(*reference, 0.0), smooth.path.segments)
    x, y = points.places[0].tolist()
    X_PW = Pose2(x, y, 0.0) @ smooth.path.start @ path.start.inverse()  # in the plane of the points
    _check_steer(path, tractor, reference, lambda s: near(points, smooth, s), fit)
    stations = np.arange(-_BEYOND, path.length + _BEYOND + _SPACING, _SPACING)
    poses = path.poses(stations)
    known = _sides(points.widths, smooth, stations)
    widths = np.full((len(stations), 2), 0.5 * width) if known is None else known
    seen = widths if points.paved is None else points.paved
    narrow = np.flatnonzero(widths.sum(axis=1) < tractor.width)
    if len(narrow):
        first, least = max(0.0, stations[narrow[0]]), widths.sum(axis=1).min()
        raise ValueError(
            f"{fit.source}: the road is {least:.2f} m wide in places, and too narrow from {first:.1f} m on, "
            f"{near(points, smooth, first)}: the tractor is {tractor.width:.2f} m wide"
        )
    return Course(
        path=path,
        reference=reference,
        start=Pose2(0.0, 0.0, 0.0),
        surface_centre=None,
        centreline=poses[:, :2],
        road_half_width=0.5 * width if points.widths is None else widths,
        relief=_relief(points, smooth, poses[:, :2], stations, float(seen.max()) + _ROADSIDE, fit),
        friction=_friction(points, smooth, poses[:, :2], stations),
        lane_lines=_lane_lines(points, smooth, stations),
        lanes=_sides(points.lanes, smooth, stations),
        paved=_sides(points.paved, smooth, stations),
        things=tuple(map(X_PW.inverse().apply, points.things)),
        deviation=float(np.abs(smooth.deviations).max()),
        remarks=points.remarks,
        placement=replace(points.placement, X_FW=points.placement.X_FW @ X_PW),
    )


def _guided_point(tractor: Unit, guided: Guided, bend: float) -> tuple[float, float]:
    """The guided point in T [m]; ``bend`` is positive for a path that turns left in the main."""
    if guided == "steered_axle":
        return tractor.steered_axles[0].x, 0.0
    if guided == "front_middle":
        return tractor.front_x, 0.0
    return tractor.front_x, math.copysign(0.5 * tractor.width, -bend)


def _check_steer(
    path: Path, tractor: Unit, reference: tuple[float, float], where: Callable[[float], str], fit: Fit
) -> None:
    """Refuse bends that need a larger steer angle than the tractor has."""
    if tractor.steering is None:
        return
    x_ref, y_ref = reference
    wheelbase, limit = tractor.steered_axles[0].x, tractor.steering.limit
    step = min(_SPACING, 0.1 * x_ref)
    stations = np.arange(0.0, path.length, step)
    heading, worst, at = path.start.psi, 0.0, 0.0
    for s, psi in zip(stations.tolist(), path.poses(stations)[:, 2].tolist(), strict=True):
        travel = psi - heading  # of the guided point, in T
        turn = math.sin(travel) / x_ref  # yaw per distance: the rear axle does not slide
        forward = math.cos(travel) + turn * y_ref
        steer = math.atan2(abs(turn) * wheelbase, forward)
        if steer > worst:
            worst, at = steer, s
        heading += step * turn
    if worst > limit:
        bend = max(abs(path.curvature(s)) for s in np.arange(max(0.0, at - x_ref), at + step, step).tolist())
        radius = math.hypot(wheelbase / math.tan(limit) + abs(y_ref), x_ref)
        raise ValueError(
            f"{fit.source}: at {at:.1f} m, {where(at)}, the path has a radius of {1.0 / max(bend, 1e-6):.1f} m: the "
            f"tractor would have to steer by {math.degrees(worst):.0f} deg, its limit is {math.degrees(limit):.0f} deg "
            f"(on a circle {radius:.1f} m)"
        )


def _relief(
    points: PathPoints, smooth: SmoothPath, line: FloatArray, stations: FloatArray, reach: float, fit: Fit
) -> RoadRelief | None:
    """Heights and banks along the path, 0 at its start; None for a level road."""
    if points.heights is None and points.banks is None:
        return None
    on_path = (stations >= 0.0) & (stations <= smooth.path.length)
    at, none = stations[on_path], np.zeros(len(points.places))
    heights, banks = (
        smooth_values(smooth.stations, none if values is None else values - origin, at, fit.smoothing)
        for values, origin in ((points.heights, _first(points.heights)), (points.banks, 0.0))
    )
    heights = _continued(heights, stations, on_path) - heights[0]
    beyond = int(np.argmax(on_path)), int(np.argmax(on_path[::-1]))  # number of stations before the path and after it
    try:
        relief = RoadRelief(line, heights, np.pad(banks, beyond, mode="edge"), reach=reach, begin=stations[0])
    except ValueError as error:
        slopes = np.abs(np.gradient(heights, stations))
        steepest = float(stations[np.argmax(np.maximum(slopes, np.abs(np.pad(banks, beyond, mode="edge"))))])
        raise ValueError(
            f"{fit.source}: {error}, {near(points, smooth, steepest)} (course.heights = false drives it level)"
        ) from None
    _check_crossings(line, heights, lambda row: near(points, smooth, float(stations[row])), fit)
    return relief


def _first(values: FloatArray | None) -> float:
    return 0.0 if values is None else float(values[0])


def _continued(values: FloatArray, stations: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Values at all stations, with the slopes of both ends beyond them."""
    rows = np.flatnonzero(known)
    whole = np.interp(stations, stations[rows], values)
    for rows_beyond, end, inner in ((slice(0, rows[0]), 0, 1), (slice(rows[-1] + 1, None), -1, -2)):
        slope = (values[end] - values[inner]) / (stations[rows[end]] - stations[rows[inner]])
        whole[rows_beyond] = values[end] + slope * (stations[rows_beyond] - stations[rows[end]])
    return whole


def _check_crossings(line: FloatArray, heights: FloatArray, where: Callable[[int], str], fit: Fit) -> None:
    """Refuse a road that crosses over itself."""
    close = scipy.spatial.KDTree(line).query_pairs(_SPACING, output_type="ndarray")
    close = close[np.abs(np.diff(close, axis=1)[:, 0]) > _BEYOND / _SPACING]
    rise = np.abs(heights[close[:, 0]] - heights[close[:, 1]])
    if len(rise) and rise.max() > _CROSSING:
        first, again = close[np.argmax(rise)].tolist()
        raise ValueError(
            f"{fit.source}: the road crosses itself {where(first)} and {where(again)} with a difference of height of "
            f"{rise.max():.2f} m: must be at most {_CROSSING} m, there are no bridges; course.heights = false drives "
            "it level"
        )


def _friction(points: PathPoints, smooth: SmoothPath, line: FloatArray, stations: FloatArray) -> LineFriction | None:
    if points.friction is None:
        return None
    return LineFriction(np.interp(stations, smooth.stations, points.friction), line)


def _sides(widths: FloatArray | None, smooth: SmoothPath, stations: FloatArray) -> FloatArray | None:
    """Distances (m, 2) to both sides of the path at stations [m]."""
    if widths is None:
        return None
    return np.stack([np.interp(stations, smooth.stations, side) for side in widths.T], axis=1)


def _lane_lines(points: PathPoints, smooth: SmoothPath, stations: FloatArray) -> FloatArray | None:
    if points.lines is None:
        return None
    columns = points.lines.reshape(len(points.places), -1).T
    lines = np.stack([np.interp(stations, smooth.stations, column) for column in columns], axis=1)
    return lines.reshape(len(stations), *points.lines.shape[1:])
