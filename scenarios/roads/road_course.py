"""The course along points of a path: smooth path, road, heights and friction, checked against what a vehicle can do."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from controllers.path import Path
from scenarios.courses import Course
from scenarios.roads.path_file import PathPoints
from scenarios.roads.smooth_path import SmoothPath, smooth_path, smooth_values
from vehicle.combination.description import Unit
from vehicle.frames import FloatArray, Pose2
from vehicle.polyline import arc_length
from vehicle.surface import LineFriction, RoadRelief

Guided = Literal["steered_axle", "outer_front_corner", "front_middle"]
_BEYOND: Final = 40.0  # road behind the start and past the end: cameras look along it [m]
_SPACING: Final = 0.25  # between points of the road: at its edge, 2 m away, distances are 4 mm too long at most [m]
_THIN: Final = 1.0 / 20.0  # points closer than this share of the smoothing length are averaged
_BACK: Final = 2.0  # turn between two legs that is a way back, not a bend [rad]
_LONGEST_LEG: Final = 250.0  # between two points [m]: a longer one is a gap in the file
_BOW: Final = 1.0 / 8.0  # largest distance of the path from a leg between two points, as a share of the smoothing
_LONGEST: Final = 50e3  # course [m]: five hours at 10 km/h, and some seconds to build
_ROADSIDE: Final = 10.0  # beyond the road's edge the ground keeps its bank [m]
_CROSSING: Final = 0.3  # difference of height of a road that crosses itself: a bridge or a gap in the heights [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """How a path is fitted to points."""

    source: str  # file, for messages
    smoothing: float  # length [m]
    tolerance: float  # largest distance of a point from the path [m]
    shortest: float  # path that makes sense [m]


def fitted_path(points: PathPoints, fit: Fit) -> tuple[SmoothPath, PathPoints]:
    """The path through the points, and the points that it was fitted to.

    Raises:
        ValueError: one line with the place, if there is no such path within the tolerance.
    """
    places = points.places
    length = float(arc_length(places)[-1])
    if not fit.shortest <= length <= _LONGEST:
        raise ValueError(
            f"{fit.source}: the path is {length:.4g} m long: must be {fit.shortest:g} m to {1e-3 * _LONGEST:g} km "
            "(x and y are metres, a GPX or GeoJSON file has degrees)"
        )
    thin = _thinned(points, _THIN * fit.smoothing)
    _check_legs(thin.places, fit)
    try:
        smooth = smooth_path(thin.places - places[0], fit.smoothing)
    except ValueError as error:
        raise ValueError(f"{fit.source}: {error} (course.smoothing = {fit.smoothing:g} m)") from None
    worst = int(np.argmax(np.abs(smooth.deviations)))
    if not abs(smooth.deviations[worst]) <= fit.tolerance:
        raise ValueError(
            f"{fit.source}: the smooth path is {abs(smooth.deviations[worst]):.3g} m from the point "
            f"{_place(thin.places[worst])}: must be within course.tolerance = {fit.tolerance:g} m; a shorter "
            f"course.smoothing than {fit.smoothing:g} m keeps sharper bends"
        )
    _check_bows(smooth, thin.places, fit)
    return smooth, thin


def road_course(points: PathPoints, fit: Fit, tractor: Unit, guided: Guided, width: float) -> Course:
    """The course of a tractor along points; the road is ``width`` [m] wide where they do not say.

    Raises:
        ValueError: one line with the place, if the points make no path, or the tractor can not be steered along it.
    """
    smooth, points = fitted_path(points, fit)
    bends = np.array([segment.start_curvature for segment in smooth.path.segments])
    reference = _guided_point(tractor, guided, float(np.sum(bends * np.abs(bends))))
    path = Path(Pose2(*reference, 0.0), smooth.path.segments)
    _check_steer(path, tractor, reference, lambda s: _place(_in_file(smooth, s, points.places[0])), fit)
    stations = np.arange(-_BEYOND, path.length + _BEYOND + _SPACING, _SPACING)
    poses = path.poses(stations)
    given = np.full((len(points.places), 2), 0.5 * width) if points.widths is None else points.widths
    widths = np.stack([np.interp(stations, smooth.stations, side) for side in given.T], axis=1)
    narrowest = int(np.argmin(widths.sum(axis=1)))
    if widths[narrowest].sum() < tractor.width:
        raise ValueError(
            f"{fit.source}: the road is {widths[narrowest].sum():.2f} m wide at {stations[narrowest]:.1f} m: the "
            f"tractor is {tractor.width:.2f} m wide"
        )
    return Course(
        path=path,
        reference=reference,
        start=Pose2(0.0, 0.0, 0.0),
        surface_centre=None,
        centreline=poses[:, :2],
        road_half_width=0.5 * width if points.widths is None else widths,
        relief=_relief(points, smooth, poses[:, :2], stations, float(widths.max()) + _ROADSIDE, fit),
        friction=_friction(points, smooth, poses[:, :2], stations),
        deviation=float(np.abs(smooth.deviations).max()),
    )


def stretch(points: PathPoints, begin: float, length: float | None, source: str) -> PathPoints:
    """The points from a distance ``begin`` [m] along them, over a ``length`` [m]; None: to their end.

    Raises:
        ValueError: one line, if the points end before.
    """
    along = arc_length(points.places)
    end = math.inf if length is None else begin + length
    rows = (along >= begin) & (along <= end)
    if np.count_nonzero(rows) < 2:
        raise ValueError(
            f"{source}: the path is {along[-1]:.4g} m long: course.begin = {begin:g} m leaves nothing of it"
        )
    known = {field.name: getattr(points, field.name) for field in fields(points)}
    return replace(points, **{name: values[rows] for name, values in known.items() if values is not None})


def _thinned(points: PathPoints, spacing: float) -> PathPoints:
    """The points, averaged over pieces of ``spacing`` [m] where they are closer; both ends stay where they are."""
    along = arc_length(points.places)
    if np.diff(along).min() >= spacing:
        return points
    kept = (along >= 0.5 * spacing) & (along <= along[-1] - 0.5 * spacing)
    group = np.floor(along / spacing).astype(np.int64)
    group[0], group[-1] = -1, group[-1] + 1
    kept[0] = kept[-1] = True
    _, rows = np.unique(group[kept], return_inverse=True)

    def averaged(values: FloatArray) -> FloatArray:
        columns = [np.bincount(rows, column) / np.bincount(rows) for column in values[kept].reshape(len(rows), -1).T]
        return np.stack(columns, axis=1).reshape(-1, *values.shape[1:])

    known = {field.name: getattr(points, field.name) for field in fields(points)}
    return replace(points, **{name: averaged(values) for name, values in known.items() if values is not None})


def _check_legs(places: FloatArray, fit: Fit) -> None:
    """Refuse gaps and ways back."""
    legs = np.diff(places, axis=0)
    lengths = np.hypot(*legs.T)
    longest = int(np.argmax(lengths))
    if lengths[longest] > _LONGEST_LEG:
        raise ValueError(
            f"{fit.source}: a gap of {lengths[longest]:.4g} m between the points {_place(places[longest])} and "
            f"{_place(places[longest + 1])}: must be at most {_LONGEST_LEG:g} m; add the missing points"
        )
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turns = np.abs(np.remainder(np.diff(heading) + math.pi, math.tau) - math.pi)
    if len(turns) and turns.max() > _BACK:
        place = _place(places[int(np.argmax(turns)) + 1])
        raise ValueError(
            f"{fit.source}: the path turns back by {math.degrees(turns.max()):.0f} deg at the point {place}: give the "
            "points in the order of driving, or a longer course.smoothing"
        )


def _check_bows(smooth: SmoothPath, places: FloatArray, fit: Fit) -> None:
    """Refuse points too far apart to know the path between them."""
    stations = np.array(smooth.path.stations)
    knots = np.array(smooth.path.knots)[:, :2] + places[0]
    leg = np.clip(np.searchsorted(smooth.stations, stations, side="right") - 1, 0, len(places) - 2)
    along = np.diff(places, axis=0)
    along /= np.hypot(*along.T)[:, None]
    away = knots - places[leg]
    bows = np.abs(along[leg, 0] * away[:, 1] - along[leg, 1] * away[:, 0])
    worst = int(np.argmax(bows))
    if not bows[worst] <= max(_BOW * fit.smoothing, fit.tolerance):
        k = int(leg[worst])
        raise ValueError(
            f"{fit.source}: the path bows {bows[worst]:.3g} m aside between the points {_place(places[k])} and "
            f"{_place(places[k + 1])}: they are too far apart to know it; add points between them"
        )


def _guided_point(tractor: Unit, guided: Guided, bend: float) -> tuple[float, float]:
    """The guided point in T [m]; ``bend`` is positive for a path that turns left in the main."""
    if guided == "steered_axle":
        return tractor.steered_axles[0].x, 0.0
    if guided == "front_middle":
        return tractor.front_x, 0.0
    return tractor.front_x, math.copysign(0.5 * tractor.width, -bend)


def _check_steer(
    path: Path, tractor: Unit, reference: tuple[float, float], place: Callable[[float], str], fit: Fit
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
        bend = abs(path.curvature(at))
        radius = math.hypot(wheelbase / math.tan(limit) + abs(y_ref), x_ref)
        raise ValueError(
            f"{fit.source}: at {at:.1f} m, {place(at)}, the path has a radius of {1.0 / max(bend, 1e-6):.1f} m: the "
            f"tractor would have to steer by {math.degrees(worst):.0f} deg, its limit is {math.degrees(limit):.0f} deg "
            f"(on a circle {radius:.1f} m)"
        )


def _in_file(smooth: SmoothPath, station: float, origin: FloatArray) -> FloatArray:
    """Position of a station in the coordinates of the file [m]."""
    return np.array(smooth.path.pose(station)[:2]) + origin


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
    try:
        relief = RoadRelief(line, heights, _constant(banks, on_path), reach=reach)
    except ValueError as error:
        raise ValueError(f"{fit.source}: {error} (course.heights = false drives it level)") from None
    _check_crossings(line, heights, fit)
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


def _constant(values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Values at all stations, constant beyond both ends."""
    rows = np.flatnonzero(known)
    whole: FloatArray = values[np.clip(np.arange(len(known)) - rows[0], 0, len(rows) - 1)]
    return whole


def _check_crossings(line: FloatArray, heights: FloatArray, fit: Fit) -> None:
    """Refuse a road that crosses over itself."""
    near = KDTree(line).query_pairs(_SPACING, output_type="ndarray")
    near = near[np.abs(np.diff(near, axis=1)[:, 0]) > _BEYOND / _SPACING]
    rise = np.abs(heights[near[:, 0]] - heights[near[:, 1]])
    if len(rise) and rise.max() > _CROSSING:
        raise ValueError(
            f"{fit.source}: the road crosses itself with a difference of height of {rise.max():.2f} m: must be at most "
            f"{_CROSSING} m, there are no bridges; course.heights = false drives it level"
        )


def _friction(points: PathPoints, smooth: SmoothPath, line: FloatArray, stations: FloatArray) -> LineFriction | None:
    if points.friction is None:
        return None
    return LineFriction(np.interp(stations, smooth.stations, points.friction), line)


def _place(point: FloatArray) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"
