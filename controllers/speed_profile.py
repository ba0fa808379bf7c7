"""Speed profiles of paths: limits of lateral and longitudinal acceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.path import Path
from vehicle.frames import FloatArray

_SPACING = 0.5  # of the profile's points [m]


@dataclass(frozen=True, slots=True, eq=False)
class SpeedProfile:
    """Speed over the arc length of a path."""

    stations: FloatArray  # (n,) [m]
    speeds: FloatArray  # (n,) [m/s]

    @classmethod
    def of(cls, path: Path, speed: float, max_lateral_acceleration: float, max_acceleration: float) -> SpeedProfile:
        """The fastest profile within ``speed`` [m/s] and both accelerations [m/s2].

        Raises:
            ValueError: if one of them is not positive.
        """
        limits = {"speed": speed, "max_lateral_acceleration": max_lateral_acceleration}
        for name, limit in {**limits, "max_acceleration": max_acceleration}.items():
            if not limit > 0.0:
                raise ValueError(f"{name} = {limit} must be positive")
        stations = np.linspace(0.0, path.length, max(2, math.ceil(path.length / _SPACING) + 1))
        curvatures = np.array([abs(path.curvature(float(s))) for s in stations])
        # A limit between two points applies to both.
        curvatures[:-1] = np.maximum(curvatures[:-1], curvatures[1:])
        squares = np.minimum(speed**2, max_lateral_acceleration / np.maximum(curvatures, 1e-9))
        gain = 2.0 * max_acceleration * float(stations[1])
        for k in range(len(squares) - 2, -1, -1):
            squares[k] = min(squares[k], squares[k + 1] + gain)
        for k in range(1, len(squares)):
            squares[k] = min(squares[k], squares[k - 1] + gain)
        return cls(stations, np.sqrt(squares))

    @property
    def duration(self) -> float:
        """Duration of the drive along the path [s]."""
        middles = 0.5 * (self.speeds[1:] + self.speeds[:-1])
        return float(np.sum(np.diff(self.stations) / middles))

    def at(self, station: float) -> float:
        """Speed at an arc length [m/s]."""
        return float(np.interp(station, self.stations, self.speeds))
