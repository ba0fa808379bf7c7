"""Units of a combination as data: a rigid body with axles, brakes, steering, suspensions, side wind and payload.

Positions are along a unit's own x axis (forward), from the rear-axle centre for the tractor and from the front hitch
for every towed unit, so that axles and follow points of towed units have negative x.
"""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, NamedTuple

from pydantic import Field, SerializeAsAny, field_validator, model_validator

from vehicle.foundation.quantity import (
    Breadth,
    Fraction,
    Frequency,
    Frozen,
    Gradient,
    Height,
    Inertia,
    Lag,
    Length,
    Mass,
    Position,
    quantity,
)
from vehicle.foundation.user_file import shown
from vehicle.tyres import Tyre
from vehicle.tyres.laws import TYRES, tyre_law

Modulation = Literal["wheel", "select_low"]
Distribution = Literal["load", "pressure"]

_TORQUE: Final = "10 N m is a hand cart's brake, 5e5 a dumper's"

AirLag = Annotated[float, quantity(..., "s", 0.01, 2.0, why="no brake answers within 10 ms or after 2 s")]


class AxleBrake(Frozen):
    """Service brake of an axle with two equal wheels."""

    torque: float = quantity(..., "N m", 10.0, 5e5, why=_TORQUE)  # of both wheels at full pressure
    lag: AirLag  # first-order time constant of the pressure in the chambers
    # At most, of the pressure over the full one
    fill_rate: float = quantity(..., "1/s", 0.1, 50.0, why="pressure builds up in 0.02 s to 10 s")
    abs: Modulation | None = None  # "wheel": each side has its modulator; "select_low": one, led by the slower side
    abs_group: str | None = None  # axles of a unit with the same name share their modulators


class Brakes(Frozen):
    """The system that controls the service brakes of a combination."""

    distribution: Distribution  # "load": forces in proportion to static loads, as EBS does; "pressure": equal pressure
    lag: AirLag  # from the pedal to the valves of the axles, first order
    abs: bool = True
    abs_slip: Fraction  # slip at which a modulator releases the pressure
    # Added to it: slower wheels may lock
    abs_slip_speed: float = quantity(..., "m/s", 0.05, 5.0, why="below it wheels may lock")
    abs_hysteresis: Fraction  # share of that limit by which the slip must fall until the modulator lets pressure in
    # Slip is predicted so far ahead from the spin's rate
    abs_lead: float = quantity(..., "s", 0.0, 0.2, why="a wheel locks within 0.2 s")
    # First order, of the pressure let out by ABS
    abs_release_lag: float = quantity(..., "s", 0.01, 1.0, why="no chamber empties within 10 ms; slower wheels lock")
    # Of the modulator's valves
    abs_valve_lag: float = quantity(..., "s", 0.002, 0.1, why="solenoid valves take some ms")


_DEG: Final = math.pi / 180.0  # [rad]; a product, as numbers of a vehicle may be symbols
_STIFFNESS: Final = "1e4 is a car's axle, and at 1e7 an axle is rigid beside its tyres"


class Suspension(Frozen):
    """Springs of one axle in roll, and its tyres under load: the table ``suspension`` of an axle."""

    roll_stiffness: float = quantity(..., "N m/rad", 1e4, 1e7, why=_STIFFNESS)  # springs and stabiliser
    roll_centre_height: float = quantity(
        ..., "m", 0.01, 2.0, why="roll centres lie between the ground and the top of the wheels"
    )
    # Vertical, of one wheel; of both tyres of a twin wheel
    tyre_stiffness: float = quantity(..., "N/m", 5e4, 1e7, why="1.5e5 is a car's tyre, 2e6 a twin wheel of a truck")
    roll_damping: float | None = quantity(
        None, "N m s/rad", 3e2, 1e6, why="1e3 is a car's axle, 1e5 one of a heavy truck"
    )  # None for all axles of a unit: by its ``suspension_damping``
    at_front: bool = False  # the unit's frame twists between this axle and the others

    def tyre_roll_stiffness(self, track: float, twin_spacing: float | None) -> float:
        """Roll stiffness of the axle on its tyres [N m/rad], with the spacing of twin tyres if it is given [m]."""
        squares = track**2 if twin_spacing is None else track**2 + twin_spacing**2
        return 0.5 * self.tyre_stiffness * squares


class RollBody(Frozen):
    """A unit's body in roll: its table ``roll``."""

    inertia: Inertia  # about the axis along the body through its centre of gravity
    frame_stiffness: float | None = quantity(
        None, "N m/rad", 1e4, 1e8, why="a ladder frame has some 1e5 to 1e6; leave out a rigid body"
    )  # twist between front support (axles ``at_front`` or the fifth wheel) and rear; None: rigid


class Coupling(Frozen):
    """The fifth wheel under a unit's front end: its table ``coupling``. Without it, the hitch rolls freely."""

    roll_stiffness: float = quantity(..., "N m/rad", 1e4, 1e8, why=_STIFFNESS)
    plate_width: float = quantity(
        ..., "m", 0.1, 3.0, why="fifth wheels are 0.6 m to 1 m wide, turntables as wide as the unit"
    )  # over which it presses on the trailer's plate
    lash_deg: float = quantity(..., "deg", 0.0, 20.0, why="the kingpin catches a trailer that separates")

    @property
    def lash(self) -> float:
        """Angle between separation and the kingpin's catch [rad]."""
        return _DEG * self.lash_deg


class SideWind(Frozen):
    """A unit's body in side wind: its table ``side_wind``."""

    area: float = quantity(..., "m2", 0.5, 200.0, why="of the side: a car has 4 m2, a trailer of 4 m 45 m2")
    # Side force over dynamic pressure, area and sine of the wind's angle to the unit
    coefficient: float = quantity(..., "-", 0.2, 5.0, why="bodies of vehicles have 0.8 to 2")
    x: Position  # of the pressure's centre
    height: Height  # of the pressure's centre


class Payload(Frozen):
    """The load on a unit, included in the numbers of the laden unit."""

    mass: Mass
    cg_x: Position
    cg_height: Length
    # Of a box with the load's yaw inertia: beyond the body where the laden unit's inertia needs it
    length: float = quantity(..., "m", 0.0, 40.0, above=True, why="no unit is longer than 40 m")
    width: Length
    height: Length  # of the box; the load bed lies below its centre by half of it

    @property
    def yaw_inertia(self) -> float:
        """About its own centre of gravity [kg m2]."""
        return self.mass * (self.length**2 + self.width**2) / 12.0

    @property
    def roll_inertia(self) -> float:
        """About its own centre of gravity [kg m2]."""
        return self.mass * (self.width**2 + self.height**2) / 12.0


class MassProperties(NamedTuple):
    """Mass properties of a unit."""

    mass: float  # [kg]
    cg_x: float  # [m]
    cg_height: float  # [m]
    yaw_inertia: float  # about the centre of gravity [kg m2]
    roll_inertia: float | None = None  # the same; None: not known


def without(laden: MassProperties, payload: Payload, removed: float) -> MassProperties:
    """Mass properties without the share ``removed`` of the payload, by the parallel-axis theorem; not checked."""
    gone = removed * payload.mass
    mass = laden.mass - gone
    cg_x = (laden.mass * laden.cg_x - gone * payload.cg_x) / mass
    cg_height = (laden.mass * laden.cg_height - gone * payload.cg_height) / mass
    along = gone * (payload.cg_x - laden.cg_x) ** 2 + mass * (cg_x - laden.cg_x) ** 2
    up = gone * (payload.cg_height - laden.cg_height) ** 2 + mass * (cg_height - laden.cg_height) ** 2
    roll = laden.roll_inertia
    return MassProperties(
        mass,
        cg_x,
        cg_height,
        laden.yaw_inertia - removed * payload.yaw_inertia - along,
        None if roll is None else roll - removed * payload.roll_inertia - up,
    )


_UNIT_NAME: Final = re.compile(r"[^\W\d_]([\w -]{0,38}[\w-])?")
_ENDINGS: Final = ("command", "std")  # of signals that have another one of the same beginning

RollSteer = Annotated[
    float, quantity(..., "rad/rad", -0.5, 0.5, why="leaf springs and links have 0.05 to 0.2; 0.5 is a steering system")
]
Camber = Annotated[float, quantity(..., "rad", -0.2, 0.2, why="wheels stand within 10 deg of upright")]
BumpSteer = Annotated[
    float, quantity(..., "rad/m", -1.0, 1.0, why="suspensions have up to 0.2 rad/m, 1 deg a decimetre")
]


class Axle(Frozen):
    """An axle with two equal wheels."""

    x: Position
    track: Breadth
    steered: bool
    steered_by_law: bool = False  # of the first unit: a steering law turns it, not the driver
    driven: bool = False
    wheel_radius: float = quantity(
        ..., "m", 0.1, 2.1, why="the smallest trailer tyre has 0.1 m, the largest of dumpers 2.0 m"
    )
    wheel_inertia: float = quantity(
        ..., "kg m2", 0.05, 1e4, why="0.05 is 5 kg at 0.1 m, 1e4 is the largest dumper's, 5 t at 1.4 m"
    )  # one wheel about its axis
    ackermann_x: Position | None = None  # at which the axes of the steered wheels meet; None: the wheels stay parallel
    steer_group: str | None = None  # axles of a unit with the same name are turned by one actuator
    steer_ratio: float = quantity(
        1.0, "-", -2.0, 2.0, why="the actuator's own axle has 1; no linkage doubles its angle"
    )  # angle of the axle over its actuator's
    roll_steer: RollSteer | None = None  # angle of the axle per roll of the body against it; None: it does not steer so
    bump_steer: BumpSteer | None = None  # outward angle of each wheel as the body rises from it; None: likewise
    camber: Camber | None = None  # of each wheel, + top outwards; only laws from tyre files know it; None: upright
    lifted: bool = False  # off the ground, carries no load
    bogie: str | None = None  # axles of a unit with the same name are a compensated group
    load_share: float = quantity(
        1.0, "-", 0.0, 10.0, above=True, why="an axle on the ground carries; beyond 10 the others carry nothing"
    )  # load relative to the others of its group
    twin_spacing: float | None = quantity(
        None, "m", 0.1, 1.5, why="twin tyres stand side by side, 0.2 m to 0.5 m on trucks"
    )  # between the contact patches of twin tyres, which then scrub; None: one patch in their middle
    tyre: SerializeAsAny[Tyre]
    brake: AxleBrake | None = None  # None: none, or as ``Vehicle.brakes`` says
    suspension: Suspension | None = None  # in roll; given for all axles of a vehicle or for none

    @field_validator("tyre", mode="before")
    @classmethod
    def _of_its_law(cls, tyre: object) -> object:
        """Build the tyre from a table by the law that it names."""
        if not isinstance(tyre, dict):
            return tyre
        law = tyre_law(tyre.get("model"))
        if law is None:
            raise ValueError(f"model = {tyre.get('model')!r} must be one of {', '.join(TYRES)}")
        return law.model_validate(tyre)


class Steering(Frozen):
    """Steering actuators of a unit; degrees in files, radians elsewhere."""

    lag: Lag  # first-order time constant
    limit_deg: float = quantity(..., "deg", 0.0, 80.0, above=True, why="a wheel square to its axle does not steer")
    rate_limit_deg: float = quantity(
        ..., "deg/s", 0.0, 500.0, above=True, why="no actuator turns a loaded wheel by more than 500 deg/s"
    )

    @property
    def limit(self) -> float:
        """Largest road-wheel angle to either side [rad]."""
        return _DEG * self.limit_deg

    @property
    def rate_limit(self) -> float:
        """Largest rate of the road-wheel angle [rad/s]."""
        return _DEG * self.rate_limit_deg


class LoadSharing(Frozen):
    """Data by which the axles of a unit's groups equalise their loads on uneven road."""

    # Vertical, of one axle's springs and tyres in series
    stiffness: float = quantity(..., "N/m", 1e3, 1e8, why="1 kN/m is a bicycle's, 100 MN/m a steel wheel's on rail")
    # In which the loads become equal again
    lag: float = quantity(..., "s", 0.05, 1e6, why="below 0.05 s leave the table out: loads are then equal at once")


class Actuator(NamedTuple):
    """The axles that one steering actuator turns."""

    axles: tuple[int, ...]  # numbers in ``Unit.axles``
    ratios: tuple[float, ...]  # angle of each over the actuator's [-]


def grouped(names: Mapping[int, str | None]) -> list[tuple[int, ...]]:
    """Axles with the same name of their group, in the order of their foremost ones; an axle without a name is alone."""
    groups: dict[str | int, list[int]] = {}
    for axle, name in names.items():
        groups.setdefault(axle if name is None else name, []).append(axle)
    return [tuple(group) for group in groups.values()]


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
    hitch_height: float | None = quantity(None, "m", 0.1, 3.0, why="couplings are 0.3 m to 1.5 m above the ground")
    hitch_roll_share: Fraction = 0.0  # share of the roll moment that the unit in front takes through the hitch
    follow_x: Position | None = None  # point that should retrace the path of the hitch, or of a first unit's front axle
    roll_gradient: Gradient | None = None  # body roll per lateral acceleration; None: follows from the suspensions
    pitch_gradient: Gradient  # body pitch per braking
    roll_axis_height: float = quantity(
        ..., "m", 0.0, 3.0, why="roll axes lie between the ground and the top of the wheels"
    )
    heave_frequency: Frequency  # of the body on its springs, undamped
    pitch_frequency: Frequency
    roll_frequency: Frequency | None = None  # None: follows from the suspensions
    suspension_damping: float = quantity(
        ..., "-", 0.0, 2.0, above=True, why="0.1 to 0.5 on the road; above 1 a body no longer oscillates"
    )  # damping ratio of heave, pitch and roll
    steering: Steering | None = None
    rear_steering: Steering | None = None  # of the axles ``steered_by_law``; None: as ``steering``
    axles: Annotated[tuple[Axle, ...], Field(min_length=1)]  # on the ground; a file lists lifted axles here, too
    lifted_axles: tuple[Axle, ...] = ()
    load_sharing: LoadSharing | None = None  # None: the axles of a group share its load at once
    roll: RollBody | None = None  # given with the suspensions of all axles
    coupling: Coupling | None = None  # of the front hitch, given with ``roll``; None: it transmits no roll moment
    side_wind: SideWind | None = None  # None: the wind does not act on the unit
    payload: Payload | None = None  # the part of the laden unit that is load; None: no other load case
    origin_x: float = 0.0  # of the frame, ahead of that of the file, see ``Vehicle.led`` [m]

    @field_validator("origin_x")
    @classmethod
    def _is_no_data(cls, given: float) -> float:
        if given:
            raise ValueError("is no data of a unit: leave it out")
        return given

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
    def n_by_driver(self) -> int:
        """Number of the steered axles of a first unit that its driver turns; they are the foremost ones."""
        return sum(not axle.steered_by_law for axle in self.steered_axles)

    @property
    def driver_actuators(self) -> tuple[Actuator, ...]:
        """The steering actuators of a first unit that follow its driver; the others follow a law."""
        return tuple(one for one in self.actuators if not self.axles[one.axles[0]].steered_by_law)

    @property
    def wheelbase(self) -> float:
        """Foremost steered axle of a first unit to the origin of its file, the centre of its rear axles [m]."""
        return self.steered_axles[0].x + self.origin_x

    def steering_of(self, axle: Axle) -> Steering | None:
        """Data of the actuator that turns an axle."""
        return self.rear_steering or self.steering if axle.steered_by_law else self.steering

    def shifted(self, x: float) -> "Unit":
        """The unit with the origin of its frame moved forward by ``x`` [m]."""

        def back(value: float | None) -> float | None:
            return None if value is None else value - x

        def axle(one: Axle) -> Axle:
            return one.model_copy(update={"x": one.x - x, "ackermann_x": back(one.ackermann_x)})

        positions = ("cg_x", "front_x", "rear_x", "hitch_x", "follow_x")
        changes: dict[str, Any] = {name: back(getattr(self, name)) for name in positions}
        changes |= {"axles": tuple(map(axle, self.axles)), "lifted_axles": tuple(map(axle, self.lifted_axles))}
        if self.side_wind:
            changes["side_wind"] = self.side_wind.model_copy(update={"x": self.side_wind.x - x})
        if self.payload:
            changes["payload"] = self.payload.model_copy(update={"cg_x": self.payload.cg_x - x})
        return self.model_copy(update={**changes, "origin_x": self.origin_x + x})

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The steering actuators in the order of their foremost axles; an axle without a group has its own."""
        groups = grouped({k: axle.steer_group for k, axle in enumerate(self.axles) if axle.steered})
        return tuple(Actuator(group, tuple(self.axles[k].steer_ratio for k in group)) for group in groups)

    @model_validator(mode="after")
    def _separate_lifted(self) -> "Unit":
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
    def _is_consistent(self) -> "Unit":
        if self.rear_x >= self.front_x:
            raise ValueError(f"rear_x = {self.rear_x:g} m must be behind front_x = {self.front_x:g} m")
        if any(axle.steer_ratio == 0.0 for axle in self.steered_axles):
            raise ValueError("steer_ratio = 0 turns no axle: it must be between -2 and 2 and not 0")
        if self.steered_axles and self.steering is None:
            raise ValueError("a unit with steered axles needs a table 'steering'")
        if (self.hitch_x is None) != (self.hitch_height is None):
            raise ValueError("hitch_x and hitch_height [m] go together")
        return self
