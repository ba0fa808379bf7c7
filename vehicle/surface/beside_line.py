"""Places beside a line: how far along it, and how far to its left."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_NEAREST_TO_CENTRE: Final = (
    0.2  # least of 1 - curvature * offset: beyond it, distances along the line are not stretched
)


class Beside(NamedTuple):
    """Places relative to the nearest point of a line, arrays of one shape."""

    along: FloatArray  # distance along the line [m]
    across: FloatArray  # to the left of it [m]
    heading: FloatArray  # of the line there [rad]
    stretch: FloatArray  # distance travelled at that offset, over the distance along the line [-]


class BesideLine:
    """A line of points (n, 2) closer than a metre [m], and the places around it."""

    def __init__(self, line: FloatArray) -> None:
        self.along = arc_length(line)  # (n,) [m]
        self._line, self._tree = line, KDTree(line)
        tangents = np.gradient(line, self.along, axis=0)
        self._heading = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
        self._curvature = np.gradient(self._heading, self.along)

    def at(self, x: ArrayLike, y: ArrayLike) -> Beside:
        """Places x, y [m] relative to the nearest point of the line; beyond an end, to that end."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        _, k = self._tree.query(np.stack([x, y], axis=-1))
        d_x, d_y = x - self._line[k, 0], y - self._line[k, 1]
        c, sin, curvature = np.cos(self._heading[k]), np.sin(self._heading[k]), self._curvature[k]
        ahead, across = c * d_x + sin * d_y, c * d_y - sin * d_x
        stretch = np.maximum(1.0 - curvature * across, _NEAREST_TO_CENTRE)
        ahead = ahead / stretch
        along = np.clip(self.along[k] + ahead, 0.0, self.along[-1])
        return Beside(along, across - 0.5 * curvature * ahead**2, self._heading[k] + curvature * ahead, stretch)

    def place(self, along: FloatArray, across: FloatArray) -> FloatArray:
        """Places (n, 2) [m] at distances along the line and to its left (n,) [m]."""
        heading = np.interp(along, self.along, self._heading)
        middle = np.stack([np.interp(along, self.along, self._line[:, i]) for i in range(2)], axis=-1)
        places: FloatArray = middle + across[:, None] * np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return places
