"""Edges of the road of environments: the least distance of all bodies from them.

The road is a band of one width around the course. Where the tractor's middle is guided, the band lies symmetrically
around its path. Where a corner on the outside of the turn is guided, the outer edge is half a metre beyond its path.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offtrack.environments.core import Lanes
from offtrack.environments.drivers import Tracks
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

WIDTH: Final = (2.5, 100.0)  # least and largest of a road [m]
_SPACING: Final = 3.0  # of the watched points along the sides of a body: in between 0.1 m may be lost on a 12 m arc [m]
_OUTSIDE: Final = 0.5  # from the guided corner's path to the edge [m]


class RoadEdges:
    """Least clearance of n vehicles from the edges of their roads."""

    def __init__(self, vehicle: Vehicle, tracks: Tracks, width: float, n: int) -> None:
        """For a road of this width [m] along each of the courses.

        Raises:
            ValueError: if the width is outside its limits.
        """
        if not WIDTH[0] <= width <= WIDTH[1]:
            raise ValueError(f"road_width = {width:g} m must be at least {WIDTH[0]:g} m and at most {WIDTH[1]:g} m")
        self._tracks = tracks
        side = np.sign(tracks.references[:, 1])  # of the guided corner, + left
        outer = np.where(side == 0.0, 0.5 * width, _OUTSIDE)
        inner = np.where(side == 0.0, 0.5 * width, width - _OUTSIDE)
        self._limits = np.column_stack([np.where(side > 0.0, outer, inner), np.where(side < 0.0, outer, inner)])
        sides = [_side(unit.front_x, unit.rear_x) for unit in vehicle.units]
        self._unit = np.concatenate([np.full(2 * len(side), k) for k, side in enumerate(sides)])
        across = [
            np.repeat([0.5, -0.5], len(side)) * unit.width for unit, side in zip(vehicle.units, sides, strict=True)
        ]
        self._places = np.concatenate([np.tile(side, 2) for side in sides]) + 1j * np.concatenate(across)
        last = np.where(self._unit == len(sides) - 1, np.fmin(self._places.real, 0.0), 0.0)
        self._share = last / last.min()  # of a longer trailer's additional length, for each point
        self._longer, self._stations = np.zeros(n), np.zeros((n, len(self._unit)))
        self.sides, self.least = np.zeros((n, 2)), np.zeros(n)  # clearance left and right now; least of the episode [m]

    def begin(self, lanes: Lanes, course: NDArray[np.intp], longer: FloatArray) -> None:
        """Begin at the start of courses, with last trailers that are ``longer`` (k,) [m] than their file."""
        self._longer[lanes] = longer
        ahead = self._places.real - longer[:, None] * self._share
        self._stations[lanes] = ahead - self._tracks.references[course, :1]
        offsets = self._places.imag - self._tracks.references[course, 1:]
        self.sides[lanes] = self._limits[course] + np.column_stack([-offsets.max(axis=1), offsets.min(axis=1)])
        self.least[lanes] = self.sides[lanes].min(axis=1)

    def step(self, course: NDArray[np.intp], poses: FloatArray) -> FloatArray:
        """Clearance (n,) [m] from both edges at poses x y psi (n, N, 3), below 0 beyond one; NaN where they are."""
        origin, heading = poses[..., 0] + 1j * poses[..., 1], np.exp(1j * poses[..., 2])
        places = self._places - self._longer[:, None] * self._share
        points = origin[:, self._unit] + heading[:, self._unit] * places
        self._stations, offsets = self._tracks.offsets(course, self._stations, points)
        self.sides = self._limits[course] + np.column_stack([-offsets.max(axis=1), offsets.min(axis=1)])
        clearance: FloatArray = self.sides.min(axis=1)
        np.fmin(self.least, clearance, out=self.least)
        return clearance


def _side(front: float, rear: float) -> FloatArray:
    """Places along a body's side from its front to its rear [m]."""
    return np.linspace(front, rear, math.ceil((front - rear) / _SPACING) + 1)
