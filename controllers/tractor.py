"""The driver's data sheet of the tractor."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class TractorGeometry:
    """The driver's data sheet of the tractor: size, guided point and steering actuator."""

    wheelbase: float  # [m]
    x_ref: float  # guided point in T [m]
    y_ref: float  # [m], + left
    max_steer: float  # road-wheel angle [rad]
    max_steer_rate: float  # [rad/s]
    actuator_lag: float  # first-order time constant [s]

    def __post_init__(self) -> None:
        for name in ("wheelbase", "x_ref", "max_steer", "max_steer_rate"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)} must be positive")
        if self.max_steer >= math.pi / 2:
            raise ValueError(f"max_steer = {self.max_steer} rad must be below pi/2")
        if self.actuator_lag < 0.0:
            raise ValueError(f"actuator_lag = {self.actuator_lag} s must not be negative")
