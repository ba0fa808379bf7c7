"""The driver's data sheet of the tractor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


class TractorAxle(NamedTuple):
    """An axle of the tractor on its tyres, as laden."""

    x: float  # in T [m]
    stiffness: float  # cornering stiffness of all its tyres [N/rad]
    relaxation_length: float  # of its tyres [m]
    trail: float = 0.0  # pneumatic trail [m]
    steer_ratio: float = 0.0  # angle over that of the foremost steered axle [-]; 0: not steered


@dataclass(frozen=True, slots=True, kw_only=True)
class TractorDynamics:
    """Masses and tyres of the tractor, for its lateral motion at speed."""

    mass: float  # [kg]
    yaw_inertia: float  # about the centre of gravity [kg m2]
    cg_x: float  # in T [m]
    hitch_mass: float = 0.0  # share of the trailers' mass that rests on the hitch and moves sideways with it [kg]
    hitch_x: float = 0.0  # in T [m]
    axles: tuple[TractorAxle, ...]  # front to rear

    def __post_init__(self) -> None:
        for name in ("mass", "yaw_inertia"):
            _check_positive(name, getattr(self, name))
        if self.hitch_mass < 0.0:
            raise ValueError(f"hitch_mass = {self.hitch_mass} kg must not be negative")
        for axle in self.axles:
            _check_positive("stiffness", axle.stiffness)
            _check_positive("relaxation_length", axle.relaxation_length)
        if len(self.axles) < 2 or not any(axle.steer_ratio != 0.0 for axle in self.axles):
            raise ValueError("axles: a tractor has two or more, and one that is steered")


@dataclass(frozen=True, slots=True, kw_only=True)
class TractorGeometry:
    """The driver's data sheet of the tractor: size, guided point and steering actuator, masses and tyres."""

    wheelbase: float  # [m]
    x_ref: float  # guided point in T [m]
    y_ref: float  # [m], + left
    max_steer: float  # road-wheel angle [rad]
    max_steer_rate: float  # [rad/s]
    actuator_lag: float  # first-order time constant [s]
    dynamics: TractorDynamics | None = None  # None: as of a usual laden tractor of this wheelbase

    def __post_init__(self) -> None:
        for name in ("wheelbase", "x_ref", "max_steer", "max_steer_rate"):
            _check_positive(name, getattr(self, name))
        if self.max_steer >= math.pi / 2:
            raise ValueError(f"max_steer = {self.max_steer} rad must be below pi/2")
        if self.actuator_lag < 0.0:
            raise ValueError(f"actuator_lag = {self.actuator_lag} s must not be negative")


def _check_positive(name: str, value: float) -> None:
    if not value > 0.0:
        raise ValueError(f"{name} = {value} must be positive")
