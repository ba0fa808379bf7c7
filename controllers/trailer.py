"""Interface of trailer steering laws: data sheets in, commands out."""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray
from vehicle.option import PartParameters, quantity

KMH: Final = 1.0 / 3.6  # [m/s]


class Linkage(NamedTuple):
    """Steered axles that share one actuator."""

    axles: tuple[int, ...]  # indices among the steered axles, front to rear
    ratios: tuple[float, ...]  # angle of each over the actuator's [-]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrailerGeometry:
    """Data sheet of the steered trailer, without the tractor."""

    follow_distance: float  # hitch to follow point [m]
    axle_distances: tuple[float, ...]  # hitch to each axle, front to rear [m]
    steered: tuple[bool, ...]  # of each axle
    max_steer: float  # limit of the actuators' angle [rad]
    max_steer_rate: float  # [rad/s]
    actuator_lag: float  # first-order time constant of the steering actuators [s]
    linkages: tuple[Linkage, ...] = ()  # a steered axle in none of them has its own actuator
    scales: tuple[float, ...] = field(init=False, repr=False, compare=False)  # sizes of the ``steer_ratios``

    def __post_init__(self) -> None:
        object.__setattr__(self, "scales", tuple(map(abs, self.steer_ratios)))

    @property
    def steered_distances(self) -> tuple[float, ...]:
        """Hitch to each steered axle, front to rear [m]."""
        return tuple(x for x, is_steered in zip(self.axle_distances, self.steered, strict=True) if is_steered)

    @property
    def straight(self) -> tuple[float, ...]:
        """Zero angle of each steered axle [rad]."""
        return (0.0,) * sum(self.steered)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the steered axles that share an actuator, in the order of their first axles."""
        linked = {axle for linkage in self.linkages for axle in linkage.axles}
        groups = [linkage.axles for linkage in self.linkages]
        groups.extend((axle,) for axle in range(sum(self.steered)) if axle not in linked)
        return tuple(sorted(groups))

    @property
    def steer_ratios(self) -> tuple[float, ...]:
        """Angle of each steered axle over its actuator's [-]."""
        ratios = {a: r for linkage in self.linkages for a, r in zip(linkage.axles, linkage.ratios, strict=True)}
        return tuple(ratios.get(axle, 1.0) for axle in range(sum(self.steered)))

    def actuator_angles(self, angles: FloatArray) -> FloatArray:
        """Angles (n_actuators,) [rad] of the actuators for axles at ``angles`` (n_steered,)."""
        if not self.linkages:
            return angles.copy()
        own = angles / np.array(self.steer_ratios)
        return np.array([own[list(group)].mean() for group in self.groups])

    def axle_angles(self, actuators: FloatArray) -> FloatArray:
        """Angles (n_steered,) [rad] of the axles for ``actuators`` (n_actuators,)."""
        if not self.linkages:
            return actuators.copy()
        angles = np.array(self.steer_ratios)
        for actuator, group in zip(actuators, self.groups, strict=True):
            angles[list(group)] *= actuator
        return angles


@dataclass(frozen=True, slots=True)
class Combination:
    """Nominal data sheet of the whole combination, for laws that build a model of it.

    A law whose constructor has the keyword ``combination`` receives it.
    """

    vehicle: Vehicle
    unit: int  # index of the steered unit; the tractor is 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteerCommand:
    """Demanded road-wheel angles of the trailer's steered axles."""

    angles: FloatArray  # (n_steered,) front to rear, + left [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actuation:
    """State of a trailer's steering actuators, for laws that make use of it."""

    goal: FloatArray  # (n_steered,) angles to which the axles are on their way [rad]
    able: NDArray[np.bool_]  # (n_steered,) True for axles that answer to demands, be it slowly
    at_grip: NDArray[np.bool_] | None = None  # (n_steered,) True for those that have no more side force to give


class SpeedRange(NamedTuple):
    """Speeds that a law is for: full authority up to one, none from a higher one on."""

    full_up_to: float  # [m/s]
    none_from: float  # [m/s]

    def share(self, speed: float) -> float:
        """Authority of the law at a speed [m/s], 1 to 0."""
        return min(1.0, max(0.0, (self.none_from - abs(speed)) / (self.none_from - self.full_up_to)))


class LowSpeedParameters(PartParameters):
    """Parameters of a law that is not for all speeds.

    Defaults, for loops on the measured path: measured with estimates 0.1 s old. With the actuators of the vehicles here
    they are well damped at 30 km/h and oscillate at 40 to 50 km/h; with a lag of 0.5 s `mpc` does at 40 km/h.
    """

    full_up_to_kmh: float = quantity(25.0, "km/h", 1.0, 129.0, "speed up to which the law steers alone")
    none_from_kmh: float = quantity(40.0, "km/h", 2.0, 130.0, "speed from which on lqr steers, or none")

    @model_validator(mode="after")
    def _fades(self) -> Self:
        low, high = self.full_up_to_kmh, self.none_from_kmh
        if not low < high:
            raise ValueError(f"none_from_kmh = {high:g} km/h must exceed full_up_to_kmh = {low:g}")
        return self

    @property
    def speeds(self) -> SpeedRange:
        """The same in m/s."""
        return SpeedRange(KMH * self.full_up_to_kmh, KMH * self.none_from_kmh)


Memory = TypeVar("Memory")


class TrailerSteering(Protocol, Generic[Memory]):
    """A trailer steering law: pure, memory in and memory out, so that a run can be snapshotted and replayed.

    It is constructed as ``Name(trailer: TrailerGeometry, **parameters)``. A law with the keyword ``combination`` also
    receives the data sheet of the whole combination.
    """

    def init(self) -> Memory:
        """Memory before the first step."""
        ...

    def step(
        self, memory: Memory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[Memory, SteerCommand]:
        """New memory and command at ``tick``; ``off_tracking`` is the newest estimate, None before the first."""
        ...


class SteeringLaw(TrailerSteering[Memory], Protocol[Memory]):
    """A steering law with its declarations; those of the catalogue inherit from it.

    Their constructors raise a ValueError, one line, for a trailer that they cannot steer, such as one without steered
    axles.
    """

    uses_off_tracking: ClassVar[bool] = True  # if so, it is guarded against bad estimates
    speeds: SpeedRange | None = None  # None: for all speeds; else another law takes over above (`lqr.AllSpeeds`)
    above: "TrailerSteering[Any] | None" = None  # that law; None: the LQR
    beyond_reach: bool = False  # True: its demands are not held within what the actuators reach until the next one
    outside: str | None = None  # why the law is for no speed here, in words; None: it is for its ``speeds``


class ActuationAware(Protocol[Memory]):
    """A steering law that receives the state of its actuators before every step but the first."""

    def actuated(self, memory: Memory, actuation: Actuation) -> Memory:
        """Memory with the state of the actuators."""
        ...


def no_axle_answers(actuation: Actuation | None) -> bool:
    """True if it is known that no steered axle answers to demands for more side force."""
    if actuation is None:
        return False
    answers = actuation.able if actuation.at_grip is None else actuation.able & ~actuation.at_grip
    return not answers.any()
