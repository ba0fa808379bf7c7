"""A rover as data: what its file says, checked, and where each number comes from."""

from __future__ import annotations

import math
from typing import Annotated, Final

import numpy as np
from pydantic import model_validator

from vehicle.frames import FloatArray
from vehicle.parameter_file import checked, read_toml, sources, without_sources
from vehicle.parameter_library import ParameterLibrary
from vehicle.quantities import Flag, Frozen, Inertia, Lag, Length, Mass, Position, quantity

_DEGREE: Final = math.pi / 180.0  # [rad]; a product, as numbers of a rover may be symbols

_ROVERS: Final = ParameterLibrary("rover", "rovers")


class Rover(Frozen):
    """Four driven wheels on rockers: those of the front and of the rear at half a wheelbase from R's origin."""

    name: str
    summary: str = ""
    mass: Mass
    yaw_inertia: Inertia  # about the centre of gravity
    cg_x: Position  # of the centre of gravity in R
    cg_height: Length
    wheelbase: Length  # front to rear wheels
    tread: Length  # left to right wheels
    radius: Length  # of the wheels, over half of their grousers
    width: Length  # of the wheels
    wheel_inertia: Inertia  # of a wheel with its gear and motor, about the axle
    drive_lag: Lag  # of a wheel's speed behind its demand
    stall_torque: Annotated[float, quantity("N m", gt=0.0, le=1e4)]  # of one drive at its wheel
    no_load_speed: Annotated[float, quantity("rad/s", gt=0.0, le=200.0)]  # of a wheel, at which its drive has no torque
    steered: Flag  # every wheel, or none: then it turns as a tank does
    steer_lag: Lag
    steer_limit_deg: Annotated[float, quantity("deg", gt=0.0, le=180.0)]
    steer_rate_limit_deg: Annotated[float, quantity("deg/s", gt=0.0, le=500.0)]
    slip_stiffness: Annotated[float, quantity("-", gt=0.0, le=200.0)]  # on firm ground, over load
    relaxation_length: Annotated[float, quantity("m", gt=0.0, le=1.0)]  # over which force follows slip
    rolling_resistance: Annotated[float, quantity("-", ge=0.0, le=0.5)]  # on firm ground, over load
    sinkage_limit: Length  # beyond which the rover is entrapped

    @property
    def steer_limit(self) -> float:
        """Largest angle of a wheel to either side [rad]."""
        return _DEGREE * self.steer_limit_deg

    @property
    def steer_rate_limit(self) -> float:
        """Largest rate of a wheel's angle [rad/s]."""
        return _DEGREE * self.steer_rate_limit_deg

    @property
    def wheel_places(self) -> FloatArray:
        """Wheels in R [m], (4, 2): front left, front right, rear left, rear right."""
        a, b = 0.5 * self.wheelbase, 0.5 * self.tread
        return np.array([[a, b], [a, -b], [-a, b], [-a, -b]])

    @property
    def effective_track(self) -> float:
        """Track [m] of a two-wheeled cart that turns as this rover does with its wheels straight, on firm ground.

        The moment of wheels that slip alike, right ones by (d - yaw b, -yaw a) over their speed and left ones mirrored,
        vanishes at a yaw rate d b / (a^2 + b^2): so it is for gentle turns, and for any turn on the spot.
        """
        a, b = 0.5 * self.wheelbase, 0.5 * self.tread
        return 2.0 * (a**2 + b**2) / b

    @model_validator(mode="after")
    def _consistent(self) -> Rover:
        if abs(self.cg_x) >= 0.5 * self.wheelbase:
            raise ValueError(f"cg_x = {self.cg_x:g} m must lie between the wheels: within {0.5 * self.wheelbase:g} m")
        if self.sinkage_limit >= self.radius:
            raise ValueError(f"sinkage_limit = {self.sinkage_limit:g} m must be below the radius, {self.radius:g} m")
        return self


def rover_names() -> tuple[str, ...]:
    """Names of the rovers that come with the program."""
    return _ROVERS.names()


def load_rover(name_or_path: str) -> Rover:
    """The rover of this name, or the one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    path = _ROVERS.file(name_or_path)
    return checked(Rover, without_sources(read_toml(path)), str(path))


def rover_sources(name_or_path: str) -> dict[str, str]:
    """Where a rover's numbers come from: key in its file to source.

    Raises:
        ValueError: if there is no such rover or file.
    """
    return sources(read_toml(_ROVERS.file(name_or_path)))
