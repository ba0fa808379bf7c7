"""The edges of a road, and how far the wheels of a combination stay inside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from scenarios.results.swept_path import UnitOutline, placed
from vehicle.frames import FloatArray
from vehicle.polyline import is_left, rows_every

_SPACING = 0.1  # of travel between the poses used; a wheel beside it is 0.1 mm further out at most, on 12 m [m]


class RoadEdges:
    """Edges of a road, from the widths at the points of its centre line."""

    def __init__(self, road: FloatArray, half_width: float | FloatArray) -> None:
        """Create it from a centre line (n, 2) [m] with points no farther apart than the road is wide.

        Its half width is one number, or (n, 2) to the left and right of the points of the line [m].
        """
        self._line, self._half_width = KDTree(road), half_width

    def distance(self, places: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Distance (m,) of places (m, 2) [m] inside the nearer edge, negative beyond it, and which are on the left."""
        found, rows = self._line.query(places)
        away, nearest = np.asarray(found), np.asarray(rows, dtype=np.intp)
        on_left = is_left(self._line.data, nearest, places)
        if isinstance(self._half_width, np.ndarray):
            inside: FloatArray = np.where(on_left, *self._half_width[nearest].T) - away
        else:
            inside = self._half_width - away
        return inside, on_left


class Clearance(NamedTuple):
    """Least distance of a wheel's middle inside the edges of the road; negative: beyond it."""

    left: float  # [m]
    right: float  # [m]


def wheel_clearance(edges: RoadEdges, outlines: Sequence[UnitOutline], poses: Sequence[FloatArray]) -> Clearance:
    """Clearance of all wheels of a combination that drives through ``poses``, one (n, 3) for each unit.

    A wheel on the left of the road's centre line counts for the left edge, one on the right for the right edge.
    """
    least = {True: math.inf, False: math.inf}
    for outline, driven in zip(outlines, poses, strict=True):
        wheels = np.array(
            [
                (x, side * 0.5 * track)
                for x, track in zip(outline.axles, outline.tracks, strict=True)
                for side in (1.0, -1.0)
            ]
        )
        known = driven[np.isfinite(driven).all(axis=1)]  # a run that diverged ends with rows that are not
        inside, on_left = edges.distance(placed(wheels, known[rows_every(known[:, :2], _SPACING)]).reshape(-1, 2))
        for side in least:
            least[side] = min(least[side], float(inside[on_left == side].min(initial=math.inf)))
    return Clearance(*(value if math.isfinite(value) else math.nan for value in (least[True], least[False])))
