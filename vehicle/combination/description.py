"""Combinations of vehicles as data: the validated contents of a vehicle file, and the sources of its numbers.

A number in a vehicle file is either plain or ``{ value = ..., source = "..." }``. Positions are along a unit's own
x axis (forward), from the rear-axle centre for the tractor and from the front hitch for every towed unit, so that
axles and follow points of towed units have negative x.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Annotated, Any, Final, NamedTuple

from pydantic import Field, SerializeAsAny, field_validator, model_validator

from vehicle.combination.brake_channels import check_brakes
from vehicle.combination.brake_data import AxleBrake, Brakes, with_brakes
from vehicle.combination.payload import Payload
from vehicle.combination.powertrain_data import AirDrag, Powertrain
from vehicle.combination.roll_data import Coupling, RollBody, Suspension
from vehicle.combination.side_wind_data import SideWind
from vehicle.parameter_file import checked, nearest, read_toml, sources, without_sources
from vehicle.parameter_library import ParameterLibrary
from vehicle.quantities import (
    Breadth,
    Flag,
    Fraction,
    Frequency,
    Frozen,
    Gradient,
    Height,
    Inertia,
    Lag,
    Mass,
    Position,
    quantity,
)
from vehicle.tyres import Tyre
from vehicle.tyres.laws import TYRES
from vehicle.user_file import shown

GRAVITY: Final = 9.81  # [m/s2]
_DEGREE: Final = math.pi / 180.0  # [rad]; a product, as numbers of a vehicle may be symbols

_GRIP: Final = "tyres hold 1.5 times the weight at most, 15 m/s2"

_UNIT_NAME: Final = re.compile(r"[^\W\d_]([\w -]{0,38}[\w-])?")
_LIGHTEST_TRACTOR: Final = 300.0  # [kg]
_ENDINGS: Final = ("command", "std")  # of signals that have another one of the same beginning
_VEHICLES: Final = ParameterLibrary("vehicle", "parameters")


RollSteer = Annotated[
    float, quantity("rad/rad", ge=-0.5, le=0.5, why="leaf springs and links have 0.05 to 0.2; 0.5 is a steering system")
]
BumpSteer = Annotated[
    float, quantity("rad/m", ge=-1.0, le=1.0, why="suspensions have up to 0.2 rad/m, 1 deg a decimetre")
]


class Axle(Frozen):
    """An axle with two equal wheels."""

    x: Position
    track: Breadth
    steered: Flag
    driven: Flag = False
    wheel_radius: Annotated[
        float, quantity("m", ge=0.1, le=2.1, why="the smallest trailer tyre has 0.1 m, the largest of dumpers 2.0 m")
    ]
    wheel_inertia: Annotated[  # one wheel about its axis
        float,
        quantity("kg m2", ge=0.05, le=1e4, why="0.05 is 5 kg at 0.1 m, 1e4 is the largest dumper's, 5 t at 1.4 m"),
    ]
    ackermann_x: Position | None = None  # at which the axes of the steered wheels meet; None: the wheels stay parallel
    steer_group: str | None = None  # axles of a unit with the same name are turned by one actuator
    steer_ratio: Annotated[
        float, quantity("-", ge=-2.0, le=2.0, why="the actuator's own axle has 1; no linkage doubles its angle")
    ] = 1.0  # angle of the axle over its actuator's
    roll_steer: RollSteer | None = None  # angle of the axle per roll of the body against it; None: it does not steer so
    bump_steer: BumpSteer | None = None  # outward angle of each wheel as the body rises from it; None: likewise
    lifted: Flag = False  # off the ground, carries no load
    bogie: str | None = None  # axles of a unit with the same name are a compensated group
    load_share: Annotated[
        float, quantity("-", gt=0.0, le=10.0, why="an axle on the ground carries; beyond 10 the others carry nothing")
    ] = 1.0  # load relative to the others of its group
    twin_spacing: (
        Annotated[float, quantity("m", ge=0.1, le=1.5, why="twin tyres stand side by side, 0.2 m to 0.5 m on trucks")]
        | None
    ) = None  # between the contact patches of twin tyres, which then scrub; None: one patch in their middle
    tyre: SerializeAsAny[Tyre]
    brake: AxleBrake | None = None  # None: none, or as ``Vehicle.brakes`` says
    suspension: Suspension | None = None  # in roll; given for all axles of a vehicle or for none

    @field_validator("tyre", mode="before")
    @classmethod
    def _of_its_law(cls, tyre: object) -> object:
        """Build the tyre from a table by the law that it names."""
        if not isinstance(tyre, dict):
            return tyre
        if tyre.get("model") not in TYRES:
            raise ValueError(f"model = {tyre.get('model')!r} must be one of {', '.join(TYRES)}")
        return TYRES[tyre["model"]].model_validate(tyre)


class Steering(Frozen):
    """Steering actuators of a unit; degrees in files, radians elsewhere."""

    lag: Lag  # first-order time constant
    limit_deg: Annotated[float, quantity("deg", gt=0.0, le=80.0, why="a wheel square to its axle does not steer")]
    rate_limit_deg: Annotated[
        float, quantity("deg/s", gt=0.0, le=500.0, why="no actuator turns a loaded wheel by more than 500 deg/s")
    ]

    @property
    def limit(self) -> float:
        """Largest road-wheel angle to either side [rad]."""
        return _DEGREE * self.limit_deg

    @property
    def rate_limit(self) -> float:
        """Largest rate of the road-wheel angle [rad/s]."""
        return _DEGREE * self.rate_limit_deg


class LoadSharing(Frozen):
    """Data by which the axles of a unit's groups equalise their loads on uneven road."""

    stiffness: Annotated[
        float, quantity("N/m", ge=1e3, le=1e8, why="1 kN/m is a bicycle's, 100 MN/m a steel wheel's on rail")
    ]  # vertical, of one axle's springs and tyres in series
    lag: Annotated[
        float, quantity("s", ge=0.05, le=1e6, why="below 0.05 s leave the table out: loads are then equal at once")
    ]  # in which the loads become equal again


class Drive(Frozen):
    """Limits and lag of driveline and brakes under a demanded acceleration."""

    lag: Lag  # first-order time constant of torque build-up
    max_acceleration: Annotated[float, quantity("m/s2", gt=0.0, le=15.0, why=_GRIP)]
    max_power: Annotated[  # at the wheels
        float, quantity("W", ge=1e3, le=5e6, why="1 kW moves the lightest vehicle; powers are in W, not kW")
    ]
    max_deceleration: Annotated[  # demanded by a full brake application
        float, quantity("m/s2", gt=0.0, le=15.0, why=_GRIP)
    ]


class Actuator(NamedTuple):
    """The axles that one steering actuator turns."""

    axles: tuple[int, ...]  # numbers in ``Unit.axles``
    ratios: tuple[float, ...]  # angle of each over the actuator's [-]


class Unit(Frozen):
    """One rigid unit of the chain: the tractor, a semi-trailer, a dolly."""

    name: str
    mass: Mass
    yaw_inertia: Inertia  # about the centre of gravity
    cg_x: Position
    cg_height: Height
    front_x: Position  # front end of the body
    rear_x: Position  # rear end of the body
    width: Breadth
    height: Height  # top of the body
    hitch_x: Position | None = None  # hitch for the next unit
    hitch_height: (
        Annotated[float, quantity("m", ge=0.1, le=3.0, why="couplings are 0.3 m to 1.5 m above the ground")] | None
    ) = None
    hitch_roll_share: Fraction = 0.0  # share of the roll moment that the unit in front takes through the hitch
    follow_x: Position | None = None  # point of a towed unit that should retrace the hitch's path
    roll_gradient: Gradient | None = None  # body roll per lateral acceleration; None: follows from the suspensions
    pitch_gradient: Gradient  # body pitch per braking
    roll_axis_height: Annotated[
        float, quantity("m", ge=0.0, le=3.0, why="roll axes lie between the ground and the top of the wheels")
    ]
    heave_frequency: Frequency  # of the body on its springs, undamped
    pitch_frequency: Frequency
    roll_frequency: Frequency | None = None  # None: follows from the suspensions
    suspension_damping: Annotated[  # damping ratio of heave, pitch and roll
        float, quantity("-", gt=0.0, le=2.0, why="0.1 to 0.5 on the road; above 1 a body no longer oscillates")
    ]
    steering: Steering | None = None
    axles: Annotated[tuple[Axle, ...], Field(min_length=1)]  # on the ground; a file lists lifted axles here, too
    lifted_axles: tuple[Axle, ...] = ()
    load_sharing: LoadSharing | None = None  # None: the axles of a group share its load at once
    roll: RollBody | None = None  # given with the suspensions of all axles
    coupling: Coupling | None = None  # of the front hitch, given with ``roll``; None: it transmits no roll moment
    side_wind: SideWind | None = None  # None: the wind does not act on the unit
    payload: Payload | None = None  # the part of the laden unit that is load; None: no other load case

    @field_validator("name")
    @classmethod
    def _is_part_of_names(cls, name: str) -> str:
        """Refuse a name that cannot be a part of signal names and of the paths of ``plant.…``."""
        if not _UNIT_NAME.fullmatch(name):
            rule = "letters, digits, spaces, _ and -, beginning with a letter, at most 40 characters"
            raise ValueError(f"'{shown(name, 40)}' must be {rule}")
        if name in _ENDINGS:
            raise ValueError(f"'{name}' is an ending of signal names: choose another name")
        return name

    @property
    def rear_hitch(self) -> tuple[float, float]:
        """Position along x and height [m] of the hitch for the next unit; zeros without one."""
        x, height = self.hitch_x, self.hitch_height
        return 0.0 if x is None else x, 0.0 if height is None else height

    @property
    def hitch_lag(self) -> float:
        """Lag [s] of the load transfer that the front hitch's force causes: that of the pitching body."""
        return 1.0 / (math.tau * self.pitch_frequency)

    @property
    def roll_swing(self) -> tuple[float, float]:
        """Roll gradient [rad/(m/s2)] and frequency [Hz] of a unit whose suspensions are not given."""
        assert self.roll_gradient is not None
        assert self.roll_frequency is not None
        return self.roll_gradient, self.roll_frequency

    @property
    def steered_axles(self) -> tuple[Axle, ...]:
        """The steered axles, front to rear."""
        return tuple(axle for axle in self.axles if axle.steered)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The steering actuators in the order of their foremost axles; an axle without a group has its own."""
        groups: dict[str | int, list[int]] = {}
        for k, axle in enumerate(self.axles):
            if axle.steered:
                groups.setdefault(k if axle.steer_group is None else axle.steer_group, []).append(k)
        return tuple(
            Actuator(tuple(group), tuple(self.axles[k].steer_ratio for k in group)) for group in groups.values()
        )

    @model_validator(mode="after")
    def _separate_lifted(self) -> Unit:
        if any(behind.x >= ahead.x for ahead, behind in zip(self.axles, self.axles[1:], strict=False)):
            raise ValueError("axles must be listed front to rear, each at its own x [m]")
        raised = tuple(axle for axle in self.axles if axle.lifted)
        if len(raised) == len(self.axles):
            raise ValueError("at least one axle must stay on the ground: all are lifted")
        if raised:  # a frozen model sets derived fields at construction this way
            object.__setattr__(self, "lifted_axles", raised)
            object.__setattr__(self, "axles", tuple(axle for axle in self.axles if not axle.lifted))
        return self

    @model_validator(mode="after")
    def _is_consistent(self) -> Unit:
        if self.rear_x >= self.front_x:
            raise ValueError(f"rear_x = {self.rear_x:g} m must be behind front_x = {self.front_x:g} m")
        if any(axle.steer_ratio == 0.0 for axle in self.steered_axles):
            raise ValueError("steer_ratio = 0 turns no axle: it must be between -2 and 2 and not 0")
        if self.steered_axles and self.steering is None:
            raise ValueError("a unit with steered axles needs a table 'steering'")
        if (self.hitch_x is None) != (self.hitch_height is None):
            raise ValueError("hitch_x and hitch_height [m] go together")
        return self


class Vehicle(Frozen):
    """A combination: the tractor and the units it tows, front to rear."""

    name: str
    summary: str = ""
    drive: Drive
    powertrain: Powertrain | None = None  # None: mass times demand up to ``Drive.max_power``, no governor
    air: AirDrag | None = None  # None: no drag of the air
    brakes: Brakes | None = None  # None: braking forces in proportion to static loads, without limit or ABS
    units: Annotated[tuple[Unit, ...], Field(min_length=1)]
    exposed: Flag = False  # to wind, see ``in_wind``; without it, nothing of the wind is computed
    has_torque_inputs: Flag = False  # see ``with_torque_inputs``
    has_failing_brakes: Flag = False  # see ``with_failing_brakes``

    @field_validator("has_torque_inputs", "has_failing_brakes")
    @classmethod
    def _is_no_data(cls, given: bool) -> bool:
        if given:
            raise ValueError("is no data of a vehicle: leave it out")
        return given

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
            origin += ahead.rear_hitch[0]
            rears.append(origin + unit.rear_x)
        return self.units[0].front_x - min(rears)

    def supports(self, unit: int) -> tuple[float, float]:
        """Positions along x of a unit's supports, front and rear [m]: hitch and axles if towed, else its axles."""
        axles = self.units[unit].axles
        if unit == 0:
            return axles[0].x, axles[-1].x
        return 0.0, sum(axle.x for axle in axles) / len(axles)

    def in_wind(self) -> Vehicle:
        """The vehicle with inputs of the wind at each unit.

        Raises:
            ValueError: one line, if its file does not say how the wind acts.
        """
        if not any(unit.side_wind for unit in self.units):
            raise ValueError(f"{self.name}: a gust needs the table 'side_wind' of a unit")
        if not self.has_springs:
            raise ValueError(f"{self.name}: a gust needs the tables 'suspension' and 'roll'")
        return self.model_copy(update={"exposed": True})

    def with_torque_inputs(self) -> Vehicle:
        """The vehicle with inputs for driving and braking torques of every axle, besides those of its own driveline."""
        return self.model_copy(update={"has_torque_inputs": True})

    def with_failing_brakes(self) -> Vehicle:
        """The vehicle with inputs for the share of its torque that the brake of every wheel has.

        Raises:
            ValueError: one line, if its file describes no brakes.
        """
        if self.brakes is None:
            raise ValueError(f"the file of vehicle {self.name} has no table [brakes]")
        return self.model_copy(update={"has_failing_brakes": True})

    @property
    def has_springs(self) -> bool:
        """True if suspensions in roll are given, False if gradients and frequencies are given instead."""
        return self.units[0].roll is not None

    @property
    def n_wheels(self) -> int:
        """Number of wheels."""
        return 2 * sum(len(unit.axles) for unit in self.units)

    @model_validator(mode="after")
    def _rolls_on_springs_or_gradients(self) -> Vehicle:
        if self.has_springs or any(axle.suspension for unit in self.units for axle in unit.axles):
            self._check_springs()
            return self
        for k, unit in enumerate(self.units):
            for name in ("roll_gradient", "roll_frequency"):
                if getattr(unit, name) is None:
                    raise ValueError(f"units.{k}: {name} is missing, or tables 'roll' and 'suspension' of every axle")
            if unit.roll is not None or unit.coupling is not None:
                raise ValueError(f"units.{k}: tables 'roll' and 'coupling' need the table 'suspension' of every axle")
        return self

    def _check_springs(self) -> None:
        for k, unit in enumerate(self.units):
            axles = sorted((*unit.axles, *unit.lifted_axles), key=lambda axle: -axle.x)
            missing = [f"units.{k}.axles.{n}.suspension" for n, axle in enumerate(axles) if axle.suspension is None]
            if unit.roll is None:
                missing.append(f"units.{k}.roll")
            if missing:
                raise ValueError(f"table '{missing[0]}' is missing: suspensions are given for all axles or for none")
            for name, short in (("roll_gradient", None), ("roll_frequency", None), ("hitch_roll_share", 0.0)):
                if getattr(unit, name) != short:
                    raise ValueError(f"units.{k}: {name} follows from the suspensions: leave out one of the two")
            if k == 0 and unit.coupling is not None:
                raise ValueError("units.0: table 'coupling' belongs to the towed unit whose front hitch it is")

    @model_validator(mode="after")
    def _is_a_chain(self) -> Vehicle:
        tractor, towed = self.units[0], self.units[1:]
        if tractor.mass < _LIGHTEST_TRACTOR:
            lightest = f"{_LIGHTEST_TRACTOR:g} kg, the lightest motor vehicle on four wheels"
            raise ValueError(f"units.0.mass = {tractor.mass:g} must be at least {lightest}; masses are in kg, not t")
        names = [unit.name.replace(" ", "_") for unit in self.units]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"units: two have the name '{name}': each needs its own, which its signals carry")
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
        check_brakes(self)
        return self


def vehicle_names() -> tuple[str, ...]:
    """Names of the vehicles in the library."""
    return _VEHICLES.names()


def load_vehicle(name_or_path: str) -> Vehicle:
    """The vehicle of this name, or the one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    path = _VEHICLES.file(name_or_path)
    return vehicle_from(without_sources(read_toml(path)), str(path))


def vehicle_from(contents: dict[str, Any], file: str) -> Vehicle:
    """Build a vehicle from the contents of its file, sources removed.

    Raises:
        ValueError: one line naming file, key, value, limit and unit.
    """
    return checked(Vehicle, with_brakes(_with_tyres(contents, file), list(_axles(contents)), file), file)


def vehicle_sources(name_or_path: str) -> dict[str, str]:
    """Sources of a vehicle's numbers, by dotted key in its file.

    Raises:
        ValueError: if there is no such vehicle or file.
    """
    return sources(read_toml(_VEHICLES.file(name_or_path)))


def _with_tyres(contents: dict[str, Any], file: str) -> dict[str, Any]:
    """The contents with the data of table ``[tyres.name]`` in place of each axle's ``tyre = "name"``."""
    tables = contents.get("tyres", {})
    if not isinstance(tables, dict):
        raise ValueError(f"{file}: tyres: must be tables [tyres.name]")
    tyres = {name: _tyre(table, file, f"tyres.{name}", name) for name, table in tables.items()}
    for key, axle in _axles(contents):
        tyre = axle.get("tyre")
        if isinstance(tyre, dict):
            axle["tyre"] = _tyre(tyre, file, f"{key}.tyre")
        elif isinstance(tyre, str):
            if tyre not in tyres:
                raise ValueError(f"{file}: {key}.tyre = '{tyre}': no table [tyres.{tyre}]{nearest(tyre, tyres)}")
            axle["tyre"] = tyres[tyre]
    return {key: value for key, value in contents.items() if key != "tyres"}


def _tyre(table: object, file: str, key: str, name: str = "") -> Tyre:
    """Tyre data from a table, by the law that it names."""
    if not isinstance(table, dict):
        raise ValueError(f"{file}: {key}: must be a table")
    if "model" not in table:
        raise ValueError(f"{file}: key '{key}.model' is missing: one of {', '.join(TYRES)}")
    model = table["model"]
    if model not in TYRES:
        raise ValueError(f"{file}: {key}.model = {model!r} is not a tyre law{nearest(str(model), TYRES)}")
    return checked(TYRES[model], {"name": name, **table}, file, key)


def _axles(plain: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Dotted key and table of every axle; entries of another shape are left for the models to refuse."""
    units = plain.get("units")
    for i, unit in enumerate(units if isinstance(units, list) else ()):
        axles = unit.get("axles") if isinstance(unit, dict) else None
        for k, axle in enumerate(axles if isinstance(axles, list) else ()):
            if isinstance(axle, dict):
                yield f"units.{i}.axles.{k}", axle
