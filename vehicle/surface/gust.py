"""A gust across the road: a stretch of W's x axis on which the wind blows along W's y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Gust:
    """Side wind of one speed between two places, with edges over which it grows evenly."""

    speed: float  # along W's y, + to the left of one who drives along W's x [m/s]
    start: float  # along W's x [m]
    length: float  # [m]
    edge: float = 5.0  # over which it grows and falls [m]

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            ValueError: one line naming the number, its value and limit.
        """
        for name, value, low, high, unit in (
            ("speed", self.speed, -60.0, 60.0, "m/s"),
            ("length", self.length, 0.1, 1e5, "m"),
            ("edge", self.edge, 0.1, 1e3, "m"),
            ("start", self.start, -1e6, 1e6, "m"),
        ):
            if not low <= value <= high:
                raise ValueError(f"gust: {name} = {value} must be between {low:g} and {high:g} {unit}")

    def velocity_at(self, x: ArrayLike) -> FloatArray:
        """Velocity along W's y [m/s] at x [m], of its shape."""
        x = np.asarray(x, dtype=np.float64)
        inside = np.minimum(x - self.start, self.start + self.length - x)
        velocity: FloatArray = self.speed * np.clip(inside / self.edge + 0.5, 0.0, 1.0)
        return velocity
