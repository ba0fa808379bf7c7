"""Potholes: their positions and sizes, and the drop of a wheel into them."""

from __future__ import annotations

import numpy as np

from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_WHEEL_RADIUS = 0.5  # of a truck's wheel, 0.48..0.53 m for 315/70 R 22.5 and 385/65 R 22.5 [m]
# Sizes are assumed: moderate to severe in terms of road maintenance. Potholes are counted from some 0.15 m on, which a
# truck's wheel hardly notices, and are filled before they are 1 m wide.
_DIAMETERS = (0.35, 0.95)  # [m]
_DEPTHS = (0.03, 0.09)  # [m]
_WHEEL_TRACK = 1.0  # of the wheels, to either side of the middle [m]
_WANDER = 0.3  # its standard deviation [m]


class Potholes:
    """Round holes in the road.

    Args:
        x, y: W of their middles, (n,) [m].
        diameter: (n,) [m].
        depth: in the middle, (n,) [m].

    Raises:
        ValueError: if the arrays differ in length, or a hole has no size.
    """

    def __init__(self, x: FloatArray, y: FloatArray, diameter: FloatArray, depth: FloatArray) -> None:
        lengths = {len(values) for values in (x, y, diameter, depth)}
        if len(lengths) != 1:
            raise ValueError(f"x, y, diameter and depth of potholes must be equally long, not {sorted(lengths)}")
        for name, values in (("diameter", diameter), ("depth", depth)):
            if len(values) and not values.min() > 0.0:
                raise ValueError(f"{name} = {values.min()} m of a pothole must be positive")
        self.x, self.y, self.diameter, self.depth = x, y, diameter, depth
        # A wheel that spans a hole drops by no more than the sagitta of its own circle.
        self._drop = np.minimum(depth, diameter**2 / (8.0 * _WHEEL_RADIUS))
        self._inverse_square = 4.0 / diameter**2

    def __len__(self) -> int:
        return len(self.x)

    def depth_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Drop of a wheel at x, y [m] into potholes [m].

        The wheel rolls in and out over the edge without a step: a bell (1 - (r/R)^2)^2 as wide as the hole.
        """
        square = (x[..., None] - self.x) ** 2 + (y[..., None] - self.y) ** 2
        inside = np.maximum(1.0 - square * self._inverse_square, 0.0)
        depth: FloatArray = (inside * inside) @ self._drop
        return depth


def scattered_potholes(
    rng: np.random.Generator, centreline: FloatArray, road_half_width: float, per_100_m: float
) -> Potholes:
    """Random potholes along a road: half of them in the wheel tracks, half anywhere on it.

    Args:
        rng: for positions and sizes.
        centreline: of the road, (n, 2) [m].
        road_half_width: [m].
        per_100_m: number of potholes per 100 m of road.
    """
    along = arc_length(centreline)
    count = round(per_100_m * along[-1] / 100.0)
    diameter = _DIAMETERS[0] * (_DIAMETERS[1] / _DIAMETERS[0]) ** rng.random(count)
    depth = rng.uniform(_DEPTHS[0], _DEPTHS[1], size=count) * (
        0.4 + 0.6 * diameter / _DIAMETERS[1]
    )  # wide ones are deeper
    room = road_half_width - 0.5 * diameter
    track = rng.choice([-_WHEEL_TRACK, _WHEEL_TRACK], size=count) + _WANDER * rng.standard_normal(count)
    offset = np.where(rng.random(count) < 0.5, track, rng.uniform(-1.0, 1.0, size=count) * room)
    offset = np.clip(offset, -room, room)
    middle, tangent = _along(centreline, along, rng.uniform(0.0, along[-1], size=count))
    return Potholes(middle[:, 0] - offset * tangent[:, 1], middle[:, 1] + offset * tangent[:, 0], diameter, depth)


def _along(line: FloatArray, along: FloatArray, station: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) of a polyline at stations [m], and its unit tangents there (n, 2)."""
    points = np.stack([np.interp(station, along, line[:, i]) for i in range(2)], axis=1)
    step = np.diff(line, axis=0)[np.clip(np.searchsorted(along, station) - 1, 0, len(line) - 2)]
    return points, step / np.linalg.norm(step, axis=1, keepdims=True)
