"""A rover and its soil as data: the contents of their files, checked, and the source of each number."""

import math
from typing import Annotated, Any, Final, Literal, NamedTuple

import casadi as ca
import numpy as np
from pydantic import Field, model_validator

from vehicle.foundation.quantity import Fraction, Frozen, Lag, Length, Position, checked, quantity
from vehicle.foundation.user_file import ParameterLibrary, read_toml, sources, without_sources
from vehicle.frames import FloatArray
from vehicle.rover.command import WheelPlace, corner_wheels
from vehicle.tyres import Num


class Footprint(NamedTuple):
    """Places of the wheels in R as shares of the two half sizes; wheels are in mirrored pairs around R's origin."""

    half_length: Num  # x of the foremost wheels [m]
    half_width: Num  # y of the outermost left wheels [m]
    along: tuple[float, ...]  # x of each wheel over the half length, -1 to 1
    across: tuple[float, ...]  # y of each wheel over the half width, -1 to 1

    @property
    def places(self) -> list[tuple[Num, Num]]:
        """x and y of each wheel in R [m]."""
        shares = zip(self.along, self.across, strict=True)
        return [(along * self.half_length, across * self.half_width) for along, across in shares]

    def loads(self, normal: Num, pitch: Num, roll: Num) -> list[Num]:
        """Loads [N] of the wheels from a normal force [N] and its moments [N m] that load the front and the left.

        The normal force and two moments are three equations, too few for four or six loads. All contacts are taken as
        equally stiff. Under a rigid body the loads are then linear in place, N_k = N/n + A x_k + B y_k. Of all loads in
        balance these have the least elastic energy, the least sum of N_k^2. For mirrored pairs around the origin the
        sums of x_k, y_k and x_k y_k vanish, so A = pitch / sum x_k^2 and B = roll / sum y_k^2.

        A load that would be negative is 0. From there on, far beyond the slopes of any sand, loads do not balance.
        """
        forward = pitch / (self.half_length * sum(along**2 for along in self.along))
        leftward = roll / (self.half_width * sum(across**2 for across in self.across))
        share = normal / len(self.along)
        return [
            ca.fmax(share + along * forward + across * leftward, 0.0)
            for along, across in zip(self.along, self.across, strict=True)
        ]


_DEGREE: Final = math.pi / 180.0  # [rad]; not math.radians, which takes no symbols
_TOLERANCE: Final = 1e-9  # of wheel places that must mirror each other [m]

_ROVERS: Final = ParameterLibrary("rover", "rovers", "el_dorado_ii")


_Mass = Annotated[float, quantity(..., "kg", 0.0, 2e5, above=True)]  # from a model to the largest dumper
_Inertia = Annotated[float, quantity(..., "kg m2", 0.0, 1e7, above=True)]


class RoverWheel(Frozen):
    """One wheel of a rover."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    x: Position  # in R, + ahead of the body centre
    y: Position  # in R, + left
    driven: bool
    steered: bool


class _RoverBase(Frozen):
    """Everything about a rover but the places of its wheels, which are alike."""

    name: str
    summary: str = ""
    mass: _Mass
    yaw_inertia: _Inertia  # about the centre of gravity
    cg_x: Position  # of the centre of gravity in R
    cg_height: Length
    radius: Length  # of the wheels, over half of their grousers
    width: Length  # of the wheels
    wheel_inertia: _Inertia  # of a wheel with its gear and motor, about the axle
    drive_lag: Lag  # of a wheel's speed behind its demand
    stall_torque: float = quantity(..., "N m", 0.0, 1e4, above=True)  # of one drive at its wheel
    # Of a wheel, at which its drive has no torque
    no_load_speed: float = quantity(..., "rad/s", 0.0, 200.0, above=True)
    steer_lag: Lag
    steer_limit_deg: float = quantity(..., "deg", 0.0, 180.0, above=True)
    steer_rate_limit_deg: float = quantity(..., "deg/s", 0.0, 500.0, above=True)
    slip_stiffness: float = quantity(..., "-", 0.0, 200.0, above=True)  # on firm ground, over load
    relaxation_length: float = quantity(..., "m", 0.0, 1.0, above=True)  # over which force follows slip
    rolling_resistance: float = quantity(..., "-", 0.0, 0.5)  # on firm ground, over load
    sinkage_limit: Length  # beyond which the rover is entrapped


class _FourWheels(_RoverBase):
    """Short form of a file: four driven wheels at the corners of a rectangle around R's origin."""

    wheelbase: Length  # front to rear wheels
    tread: Length  # left to right wheels
    steered: bool  # all wheels, or none: then it turns by different speeds of its sides

    def long_form(self) -> dict[str, Any]:
        """The same rover with a list of wheels."""
        plain = self.model_dump(exclude={"wheelbase", "tread", "steered"})
        places = corner_wheels(self.wheelbase, self.tread)
        return plain | {"wheels": [place._asdict() | {"driven": True, "steered": self.steered} for place in places]}


class Rover(_RoverBase):
    """A rigid body on four or six wheels, which stand in mirrored pairs; their middle is R's origin."""

    wheels: Annotated[tuple[RoverWheel, ...], Field(min_length=4, max_length=6)]  # in the order of commands and signals

    @property
    def steer_limit(self) -> float:
        """Largest angle of a steered wheel to either side [rad]."""
        return _DEGREE * self.steer_limit_deg

    @property
    def steer_rate_limit(self) -> float:
        """Largest rate of a wheel's angle [rad/s]."""
        return _DEGREE * self.steer_rate_limit_deg

    @property
    def places(self) -> tuple[WheelPlace, ...]:
        """The wheels as the rover's software knows them."""
        return tuple(WheelPlace(wheel.name, wheel.x, wheel.y) for wheel in self.wheels)

    @property
    def wheel_places(self) -> FloatArray:
        """Wheels in R [m], (n, 2)."""
        return np.array([(wheel.x, wheel.y) for wheel in self.wheels])

    @property
    def footprint(self) -> Footprint:
        """Places of the wheels as the equations take them."""
        length, width = max(wheel.x for wheel in self.wheels), max(wheel.y for wheel in self.wheels)
        along, across = (
            tuple(wheel.x / length for wheel in self.wheels),
            tuple(wheel.y / width for wheel in self.wheels),
        )
        return Footprint(length, width, along, across)

    @property
    def rear_left(self) -> int:
        """Index of the rearmost wheel on the left, the one whose trace the camera watches."""
        return min(range(len(self.wheels)), key=lambda k: (self.wheels[k].y < 0.0, self.wheels[k].x))

    @property
    def steered(self) -> bool:
        """True if any wheel is steered; otherwise the rover turns by different speeds of its sides."""
        return any(wheel.steered for wheel in self.wheels)

    @property
    def wheelbase(self) -> float:
        """Distance from the rearmost to the foremost wheels [m]."""
        return max(wheel.x for wheel in self.wheels) - min(wheel.x for wheel in self.wheels)

    @property
    def tread(self) -> float:
        """Distance from the outermost left to the outermost right wheels [m]."""
        return max(wheel.y for wheel in self.wheels) - min(wheel.y for wheel in self.wheels)

    @property
    def effective_track(self) -> float:
        """Track [m] of a two-wheeled cart that turns as this rover does with its wheels straight, on firm ground.

        The wheels slip by (d - yaw |y|, -yaw x) over their speed, on the left mirrored. Their moment vanishes at a yaw
        rate d sum |y| / sum (x^2 + y^2): valid for gentle turns, and for any turn on the spot.
        """
        left = [wheel for wheel in self.wheels if wheel.y > 0.0]
        return 2.0 * sum(wheel.x**2 + wheel.y**2 for wheel in left) / sum(wheel.y for wheel in left)

    @model_validator(mode="after")
    def _consistent(self) -> "Rover":
        _check_wheels(self.wheels)
        if abs(self.cg_x) >= 0.5 * self.wheelbase:
            raise ValueError(f"cg_x = {self.cg_x:g} m must lie between the wheels: within {0.5 * self.wheelbase:g} m")
        if self.sinkage_limit >= self.radius:
            raise ValueError(f"sinkage_limit = {self.sinkage_limit:g} m must be below the radius, {self.radius:g} m")
        return self


def _check_wheels(wheels: tuple[RoverWheel, ...]) -> None:
    """Refuse wheels whose loads or turns the equations do not describe."""
    if len(wheels) % 2:
        raise ValueError(f"wheels: {len(wheels)} of them; a rover has 4 or 6")
    if len({wheel.name for wheel in wheels}) < len(wheels):
        raise ValueError(f"wheels: two have the same name: {', '.join(wheel.name for wheel in wheels)}")
    for wheel in wheels:
        twins = [one for one in wheels if math.dist((one.x, one.y), (wheel.x, -wheel.y)) < _TOLERANCE]
        alike = len(twins) == 1 and (twins[0].driven, twins[0].steered) == (wheel.driven, wheel.steered)
        if not alike or abs(wheel.y) < _TOLERANCE:
            raise ValueError(
                f"wheels: {wheel.name} at x = {wheel.x:g} m, y = {wheel.y:g} m needs one mirrored wheel, "
                "equally driven and steered, on the other side"
            )
    middle = math.fsum(wheel.x for wheel in wheels) / len(wheels)
    if abs(middle) > _TOLERANCE:
        raise ValueError(f"wheels: the mean of their x is {middle:g} m and must be 0, as R's origin is their middle")
    if max(wheel.x for wheel in wheels) < _TOLERANCE:
        raise ValueError("wheels: all of them stand on one line across the rover, which would tip over")
    if not any(wheel.driven for wheel in wheels):
        raise ValueError("wheels: none of them is driven")


def rover_names() -> tuple[str, ...]:
    """Names of the shipped rovers."""
    return _ROVERS.names()


def load_rover(name_or_path: str) -> Rover:
    """Load a shipped rover by its name, or one from a ``.toml`` file.

    A file has a list ``wheels``, or in its place ``wheelbase``, ``tread`` and ``steered`` of four driven wheels.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    path = _ROVERS.file(name_or_path)
    plain = without_sources(read_toml(path))
    if "wheels" not in plain:
        plain = checked(_FourWheels, plain, str(path), usual=_ROVERS.usual).long_form()
    return checked(Rover, plain, str(path), usual=_ROVERS.usual)


def rover_sources(name_or_path: str) -> dict[str, str]:
    """Sources of a rover's numbers, by key in its file.

    Raises:
        ValueError: if there is no such rover or file.
    """
    return sources(read_toml(_ROVERS.file(name_or_path)))


_Modulus = Annotated[float, quantity(..., "m", 0.0, 0.5, above=True)]
_Change = Annotated[float, quantity(..., "m/rad", -0.5, 0.5)]

_SOILS: Final = ParameterLibrary("soil", "soils", "toyoura_sand")


class Soil(Frozen):
    """Soil under a rigid wheel: strength, pressure over sinkage, and shear.

    The pressure at a sinkage z under a wheel of width b is, by ``pressure_law``, Bekker's (k_c / b + k_phi) z^n or
    Reece's (c k_c + rho k_phi b) (z / b)^n. Reece's k_phi is multiplied by the mass density, as in the files of the
    Tohoku group: with the specific weight in its place the soil would be 9.8 times too stiff.
    """

    name: str
    summary: str = ""
    pressure_law: Literal["bekker", "reece"]
    shear_law: Literal["separate", "combined"]  # mobilise the shear strength along and across separately, or together
    cohesion: float = quantity(..., "Pa", 0.0, 1e5)  # c
    friction_angle_deg: float = quantity(..., "deg", 0.0, 55.0, above=True)  # phi
    density: float = quantity(..., "kg/m3", 0.0, 5000.0, above=True)  # rho
    exponent: float = quantity(..., "-", 0.0, 3.0, above=True)  # n
    exponent_by_slip: float = quantity(..., "-", 0.0, 2.0)  # increase of n for a slip ratio of 1
    exponent_by_skid: float = quantity(..., "-", 0.0, 2.0)  # increase of n for a slip ratio of -1
    k_c: float = quantity(..., "Pa m^(1-n) (bekker), - (reece)", 0.0, 1e9)
    k_phi: float = quantity(..., "Pa/m^n (bekker), m2/s2 (reece)", 0.0, 1e9)
    crest_at_rest: Fraction  # a_0: angle of the largest pressure over the entry angle, without slip
    crest_by_slip: float = quantity(..., "-", 0.0, 1.0)  # a_1: increase of a_0 for a slip ratio of 1
    exit_ratio: float = quantity(..., "-", 0.0, 2.0)  # lambda: exit height over sinkage
    shear_x: _Modulus  # k_x without side slip
    shear_x_by_angle: _Change  # increase of k_x with the slip angle
    shear_x_by_angle_squared: float = quantity(..., "m/rad2", -0.5, 0.5)
    shear_y: _Modulus  # k_y without side slip
    shear_y_by_angle: _Change

    @property
    def friction_angle(self) -> float:
        """Angle of internal friction [rad]."""
        return math.pi / 180.0 * self.friction_angle_deg


def soil_names() -> tuple[str, ...]:
    """Names of the shipped soils."""
    return _SOILS.names()


def load_soil(name_or_path: str) -> Soil:
    """Load a shipped soil by its name, or one from a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    path = _SOILS.file(name_or_path)
    return checked(Soil, without_sources(read_toml(path)), str(path), usual=_SOILS.usual)
