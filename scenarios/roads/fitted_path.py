"""The path through points of a file, checked: gaps, ways back, sharp bends, points too far apart."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from scenarios.roads.path_file import PathPoints
from scenarios.roads.smooth_path import SmoothPath, smooth_path
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_THIN: Final = 1.0 / 20.0  # points closer than this share of the smoothing length are averaged
_BACK: Final = 2.0  # turn between two legs that is a way back, not a bend [rad]
_LONGEST_LEG: Final = 250.0  # between two points [m]: a longer one is a gap in the file
_BOW: Final = 1.0 / 8.0  # largest distance of the path from a leg between two points, as a share of the smoothing
_LONGEST: Final = 50e3  # course [m]: five hours at 10 km/h, and some seconds to build


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
            f"{located(thin.places[worst])}: must be within course.tolerance = {fit.tolerance:g} m; a shorter "
            f"course.smoothing than {fit.smoothing:g} m keeps sharper bends"
        )
    _check_bows(smooth, thin.places, fit)
    return smooth, thin


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
    return _with_each(points, lambda values: values[rows])


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

    return _with_each(points, averaged)


def _with_each(points: PathPoints, change: Callable[[FloatArray], FloatArray]) -> PathPoints:
    """The points with each of their arrays that is known changed."""
    known = {field.name: getattr(points, field.name) for field in fields(points)}
    return replace(points, **{name: change(values) for name, values in known.items() if values is not None})


def _check_legs(places: FloatArray, fit: Fit) -> None:
    """Refuse gaps and ways back."""
    legs = np.diff(places, axis=0)
    lengths = np.hypot(*legs.T)
    longest = int(np.argmax(lengths))
    if lengths[longest] > _LONGEST_LEG:
        raise ValueError(
            f"{fit.source}: a gap of {lengths[longest]:.4g} m between the points {located(places[longest])} and "
            f"{located(places[longest + 1])}: must be at most {_LONGEST_LEG:g} m; add the missing points"
        )
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turns = np.abs(np.remainder(np.diff(heading) + math.pi, math.tau) - math.pi)
    if len(turns) and turns.max() > _BACK:
        place = located(places[int(np.argmax(turns)) + 1])
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
            f"{fit.source}: the path bows {bows[worst]:.3g} m aside between the points {located(places[k])} and "
            f"{located(places[k + 1])}: they are too far apart to know it; add points between them"
        )


def located(point: FloatArray) -> str:
    """A position in the file, for messages."""
    return f"({point[0]:.2f}, {point[1]:.2f})"
