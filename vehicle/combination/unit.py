"""Units of a combination as data: a rigid body with its axles, steering actuators and suspensions.

Positions are along a unit's own x axis (forward), from the rear-axle centre for the tractor and from the front hitch
for every towed unit, so that axles and follow points of towed units have negative x.
"""

from __future__ import annotations

import math
import re
from typing import Annotated, Final, NamedTuple

from pydantic import Field, SerializeAsAny, field_validator, model_validator

from vehicle.combination.brake_data import AxleBrake
from vehicle.combination.payload import Payload
from vehicle.combination.roll_data import Coupling, RollBody, Suspension
from vehicle.combination.side_wind_data import SideWind
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

_DEGREE: Final = math.pi / 180.0  # [rad]; a product, as numbers of a vehicle may be symbols
_UNIT_NAME: Final = re.compile(r"[^\W\d_]([\w -]{0,38}[\w-])?")
_ENDINGS: Final = ("command", "std")  # of signals that have another one of the same beginning

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
