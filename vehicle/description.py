"""A combination of vehicles as data: what its file says, checked, and where each number comes from.

A number in a vehicle file is either plain or ``{ value = ..., source = "..." }``. Positions run along a unit's own
x axis (forward): from the rear-axle centre for the tractor, from the front hitch for every towed unit, so that
axles and follow points of towed units have negative x.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, model_validator

from vehicle.parameter_file import checked, nearest, read_toml, sources, without_sources

GRAVITY: Final = 9.81  # [m/s2]


def _quantity(unit: str, *, ge: float | None = None, gt: float | None = None, le: float) -> Any:
    return Field(ge=ge, gt=gt, le=le, strict=True, allow_inf_nan=False, json_schema_extra={"unit": unit})


# The limits are those of road vehicles from a hand cart to the largest road train: they catch slips of unit and sign.
Mass = Annotated[float, _quantity("kg", gt=0.0, le=2e5)]
Inertia = Annotated[float, _quantity("kg m2", gt=0.0, le=1e7)]
Position = Annotated[float, _quantity("m", ge=-40.0, le=40.0)]
Length = Annotated[float, _quantity("m", gt=0.0, le=10.0)]
Fraction = Annotated[float, _quantity("-", ge=0.0, le=1.0)]
Flag = Annotated[bool, Field(strict=True)]
Lag = Annotated[float, _quantity("s", gt=0.0, le=5.0)]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Tyre(_Frozen):
    """Tyre data of one wheel (a twin wheel counts as one), normalised by its vertical load."""

    cornering_stiffness: Annotated[float, _quantity("1/rad", gt=0.0, le=60.0)]  # at the nominal load
    longitudinal_stiffness: Annotated[float, _quantity("-", gt=0.0, le=60.0)]  # per unit of slip, at the nominal load
    nominal_load: Annotated[float, _quantity("N", gt=0.0, le=1e6)]  # per wheel
    load_sensitivity: Annotated[float, _quantity("-", ge=0.0, le=1.0)]  # relative loss of stiffness, per nominal load
    shape: Annotated[float, _quantity("-", ge=1.0, le=2.0)]  # C of the magic formula; at 1 the force never falls off
    curvature: Annotated[float, _quantity("-", ge=-10.0, le=1.0)]  # E of the magic formula
    relaxation_length: Annotated[float, _quantity("m", gt=0.0, le=3.0)]
    damping: Annotated[float, _quantity("s", ge=0.0, le=0.2)]  # of the carcass: damping over stiffness
    rolling_resistance: Annotated[float, _quantity("-", ge=0.0, le=0.3)]  # rolling drag over load


class Axle(_Frozen):
    """An axle with two equal wheels."""

    x: Position
    track: Length
    steered: Flag
    driven: Flag = False
    wheel_radius: Annotated[float, _quantity("m", gt=0.0, le=3.0)]
    wheel_inertia: Annotated[float, _quantity("kg m2", gt=0.0, le=1e4)]  # one wheel about its axis
    ackermann_x: Position | None = None  # where the axes of the axle's steered wheels meet; None: they stay parallel
    tyre: Tyre


class Steering(_Frozen):
    """The steering actuators of a unit, one per steered axle; files speak degrees, the rest of the program radians."""

    lag: Lag  # first-order time constant
    limit_deg: Annotated[float, _quantity("deg", gt=0.0, le=80.0)]
    rate_limit_deg: Annotated[float, _quantity("deg/s", gt=0.0, le=500.0)]

    @property
    def limit(self) -> float:
        """Largest road-wheel angle to either side [rad]."""
        return math.radians(self.limit_deg)

    @property
    def rate_limit(self) -> float:
        """Largest rate of the road-wheel angle [rad/s]."""
        return math.radians(self.rate_limit_deg)


class Drive(_Frozen):
    """What the driveline and the brakes together can do with a demanded acceleration."""

    lag: Lag  # first-order time constant of torque build-up
    max_acceleration: Annotated[float, _quantity("m/s2", gt=0.0, le=20.0)]
    max_power: Annotated[float, _quantity("W", gt=0.0, le=5e6)]  # at the wheels
    max_deceleration: Annotated[float, _quantity("m/s2", gt=0.0, le=20.0)]


class Unit(_Frozen):
    """One rigid unit of the chain: the tractor, a semi-trailer, a dolly."""

    name: str
    mass: Mass
    yaw_inertia: Inertia  # about the centre of gravity
    cg_x: Position
    cg_height: Length
    front_x: Position  # front end of the body
    rear_x: Position  # rear end of the body
    width: Length
    height: Length  # top of the body
    hitch_x: Position | None = None  # hitch for the next unit
    hitch_height: Annotated[float, _quantity("m", ge=0.0, le=10.0)] | None = None
    hitch_roll_share: Fraction = 0.0  # part of the roll moment that the unit in front takes through the hitch
    follow_x: Position | None = None  # the point of a towed unit that is to follow the hitch
    roll_gradient: Annotated[float, _quantity("rad/(m/s2)", ge=0.0, le=0.1)]  # body roll per lateral acceleration
    pitch_gradient: Annotated[float, _quantity("rad/(m/s2)", ge=0.0, le=0.1)]  # body pitch per braking
    roll_axis_height: Annotated[float, _quantity("m", ge=0.0, le=5.0)]
    suspension_lag: Lag  # of body attitude and load transfer behind the accelerations
    steering: Steering | None = None
    axles: Annotated[tuple[Axle, ...], Field(min_length=1)]

    @property
    def supports(self) -> tuple[float, float]:
        """Where along x the ground carries the unit, front and rear [m]: hitch and axles if towed, else its axles."""
        if all(axle.x < 0.0 for axle in self.axles):
            return 0.0, sum(axle.x for axle in self.axles) / len(self.axles)
        return self.axles[0].x, self.axles[-1].x

    @property
    def steered_axles(self) -> tuple[Axle, ...]:
        """The steered axles, front to rear."""
        return tuple(axle for axle in self.axles if axle.steered)

    @model_validator(mode="after")
    def _consistent(self) -> Unit:
        if self.rear_x >= self.front_x:
            raise ValueError(f"rear_x = {self.rear_x:g} m must be behind front_x = {self.front_x:g} m")
        if any(behind.x >= ahead.x for ahead, behind in zip(self.axles, self.axles[1:], strict=False)):
            raise ValueError("axles must be listed front to rear, each at its own x [m]")
        if self.steered_axles and self.steering is None:
            raise ValueError("a unit with steered axles needs a table 'steering'")
        if (self.hitch_x is None) != (self.hitch_height is None):
            raise ValueError("hitch_x and hitch_height [m] go together")
        return self


class Vehicle(_Frozen):
    """A combination: the tractor and the units it tows, front to rear."""

    name: str
    summary: str = ""
    drive: Drive
    units: Annotated[tuple[Unit, ...], Field(min_length=1)]

    @property
    def mass(self) -> float:
        """Mass of the whole combination [kg]."""
        return sum(unit.mass for unit in self.units)

    @property
    def length(self) -> float:
        """Overall length of the straight combination [m]."""
        origin = 0.0
        rears = [self.units[0].rear_x]
        for ahead, unit in zip(self.units, self.units[1:], strict=False):
            origin += ahead.hitch_x or 0.0
            rears.append(origin + unit.rear_x)
        return self.units[0].front_x - min(rears)

    @property
    def n_wheels(self) -> int:
        """Number of wheels."""
        return 2 * sum(len(unit.axles) for unit in self.units)

    @model_validator(mode="after")
    def _a_chain(self) -> Vehicle:
        tractor, towed = self.units[0], self.units[1:]
        if not tractor.steered_axles:
            raise ValueError("units.0: the tractor needs a steered axle")
        if not any(axle.driven for axle in tractor.axles):
            raise ValueError("units.0: the tractor needs a driven axle")
        if len(tractor.axles) < 2:
            raise ValueError("units.0: the tractor needs two axles or more to stand on")
        for k, unit in enumerate(self.units[:-1]):
            if unit.hitch_x is None:
                raise ValueError(f"units.{k}: hitch_x [m] is missing, yet another unit follows")
        for k, unit in enumerate(towed, start=1):
            if any(axle.x >= 0.0 for axle in unit.axles):
                raise ValueError(f"units.{k}: axles of a towed unit lie behind its hitch: x must be below 0 m")
            if any(axle.driven for axle in unit.axles):
                raise ValueError(f"units.{k}: only axles of the tractor can be driven")
            if unit.follow_x is not None and unit.follow_x >= 0.0:
                raise ValueError(f"units.{k}: follow_x = {unit.follow_x:g} m must be below 0 m, behind the hitch")
        return self


def vehicle_names() -> tuple[str, ...]:
    """Names of the vehicles that come with the program."""
    return tuple(sorted(path.stem for path in _shipped().glob("*.toml")))


def load_vehicle(name_or_path: str) -> Vehicle:
    """The vehicle of this name, or the one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    path = _file_of(name_or_path)
    plain = without_sources(read_toml(path))
    return checked(Vehicle, _with_tyres(plain, path), str(path))


def vehicle_sources(name_or_path: str) -> dict[str, str]:
    """Where a vehicle's numbers come from: dotted key in its file to source.

    Raises:
        ValueError: if there is no such vehicle or file.
    """
    return sources(read_toml(_file_of(name_or_path)))


def _shipped() -> Path:
    return Path(str(resources.files("vehicle"))) / "parameters"


def _file_of(name_or_path: str) -> Path:
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    known = vehicle_names()
    if name_or_path not in known:
        hint = nearest(name_or_path, known)
        raise ValueError(f"unknown vehicle '{name_or_path}'{hint} (known: {', '.join(known)}; or a .toml file)")
    return _shipped() / f"{name_or_path}.toml"


def _with_tyres(plain: dict[str, Any], path: Path) -> dict[str, Any]:
    """The contents with each axle's ``tyre = "name"`` replaced by the table ``[tyres.name]``."""
    tables = plain.pop("tyres", {})
    if not isinstance(tables, dict):
        raise ValueError(f"{path}: tyres: must be tables [tyres.name]")
    tyres = {name: checked(Tyre, table, str(path), f"tyres.{name}") for name, table in tables.items()}
    for key, axle in _axles(plain):
        name = axle.get("tyre")
        if isinstance(name, str):
            if name not in tyres:
                raise ValueError(
                    f"{path}: {key}.tyre = '{name}': there is no table [tyres.{name}]{nearest(name, tyres)}"
                )
            axle["tyre"] = tyres[name]
    return plain


def _axles(plain: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Dotted key and table of every axle; what is not even shaped like one is left for the models to refuse."""
    units = plain.get("units")
    for i, unit in enumerate(units if isinstance(units, list) else ()):
        axles = unit.get("axles") if isinstance(unit, dict) else None
        for k, axle in enumerate(axles if isinstance(axles, list) else ()):
            if isinstance(axle, dict):
                yield f"units.{i}.axles.{k}", axle
