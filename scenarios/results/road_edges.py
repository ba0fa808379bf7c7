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
from vehicle.polyline import rows_every

_SPACING = 0.1  # of travel between the poses used; a wheel beside it is 0.1 mm further out at most, on 12 m [m]

_ROUNDING = 1e-6  # far more than that of a distance [m]


class RoadEdges:
    """Edges of a road, from the widths at the points of its centre line."""

    def __init__(self, road: FloatArray, half_width: float | FloatArray) -> None:
        """Create it from a centre line (n, 2) [m] with points no farther apart than the road is wide.

        Its half width is one number, or (n, 2) to the left and right of the points of the line [m].
        """
        self._line, self._half_width, self._narrowest = KDTree(road), half_width, float(np.min(half_width))
        along = np.gradient(road, axis=0)
        gaps = np.hypot(*along.T)[:, None]
        self._along, self._half_gap = along / np.maximum(gaps, 1e-12), 0.5 * float(gaps.max())

    def distance(self, places: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Distance (m,) of places (m, 2) [m] inside the nearer edge, negative beyond it, and which are on the left."""
        nearest = np.asarray(self._line.query(places)[1], dtype=np.intp)
        away, along = places - self._line.data[nearest], self._along[nearest]
        lateral = along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0]
        past = np.maximum(np.abs(np.einsum("ij,ij->i", along, away)) - self._half_gap, 0.0)  # beyond an end of the road
        widths = np.broadcast_to(self._half_width, (len(self._along), 2))[nearest]
        inside: FloatArray = np.where(lateral > 0.0, *widths.T) - np.hypot(lateral, past)
        return inside, lateral > 0.0

    def room(self, places: FloatArray) -> float:
        """Distance [m] by which all places (m, 2) [m] may move and stay inside; negative: unknown.

        A place is inside while the nearest point of the line is less than the narrowest half width away, and that
        distance changes by no more than the place moves.
        """
        return self._narrowest - float(np.max(self._line.query(places)[0])) - _ROUNDING


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
