"""Data sheet of a rover for its own estimators and drivers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vehicle.frames import FloatArray
from vehicle.rover.command import WheelPlace


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverGeometry:
    """Data sheet of a rover for its odometry and driver.

    Raises:
        ValueError: if a length is not positive.
    """

    wheels: tuple[WheelPlace, ...]
    wheel_radius: float  # [m]
    effective_track: float  # for turning by wheel speed differences: the tread times a factor for scrubbing [m]
    max_steer: tuple[float, ...]  # of each wheel; 0: it is not steered [rad]
    max_wheel_speed: float  # [rad/s]

    def __post_init__(self) -> None:
        for name in ("wheel_radius", "effective_track", "max_wheel_speed"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)} must be positive")
        if len(self.max_steer) != len(self.wheels):
            raise ValueError(f"max_steer = {self.max_steer} must have a value for each of {len(self.wheels)} wheels")

    @property
    def steered(self) -> bool:
        """True if any wheel is steered; otherwise the rover turns by wheel speed differences of its sides."""
        return max(self.max_steer) > 0.0

    def places(self) -> FloatArray:
        """Wheels (n, 2) in R [m], in their order."""
        return wheel_places(self.wheels)


def wheel_places(wheels: Sequence[WheelPlace]) -> FloatArray:
    """Places (n, 2) of wheels in R [m]."""
    return np.array([(wheel.x, wheel.y) for wheel in wheels])
