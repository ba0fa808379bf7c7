"""What a trailer's controller knows of its own trailer, what it commands, and the shape of every such controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Generic, NamedTuple, Protocol, TypeVar

from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray
from vehicle.option import Option


class Linkage(NamedTuple):
    """Steered axles that one actuator turns."""

    axles: tuple[int, ...]  # by their place among the steered ones, front to rear
    ratios: tuple[float, ...]  # angle of each over the actuator's [-]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrailerGeometry:
    """The steered trailer's own data sheet; nothing of the tractor is in it."""

    follow_distance: float  # hitch to follow point [m]
    axle_distances: tuple[float, ...]  # hitch to each axle, front to rear [m]
    steered: tuple[bool, ...]  # which of them are steered
    max_steer: float  # limit of the actuators' angle [rad]
    max_steer_rate: float  # [rad/s]
    actuator_lag: float  # first-order time constant of the steering actuators [s]
    linkages: tuple[Linkage, ...] = ()  # steered axles that are in none of them have an actuator of their own

    @property
    def steered_distances(self) -> tuple[float, ...]:
        """Hitch to each steered axle, front to rear [m]."""
        return tuple(x for x, is_steered in zip(self.axle_distances, self.steered, strict=True) if is_steered)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Steered axles, by their place among the steered ones, that share an actuator; in the order of their first."""
        linked = {axle for linkage in self.linkages for axle in linkage.axles}
        groups = [linkage.axles for linkage in self.linkages]
        groups.extend((axle,) for axle in range(sum(self.steered)) if axle not in linked)
        return tuple(sorted(groups))

    @property
    def steer_ratios(self) -> tuple[float, ...]:
        """Angle of each steered axle over its actuator's [-]."""
        ratios = {a: r for linkage in self.linkages for a, r in zip(linkage.axles, linkage.ratios, strict=True)}
        return tuple(ratios.get(axle, 1.0) for axle in range(sum(self.steered)))


@dataclass(frozen=True, slots=True)
class Combination:
    """The nominal data sheet of the whole combination, for laws that build their own model of it.

    A law whose constructor has a keyword named ``combination`` is given it.
    """

    vehicle: Vehicle
    unit: int  # which of its units the law steers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteerCommand:
    """Demanded road-wheel angles of the trailer's steered axles."""

    angles: FloatArray  # (n_steered,) front to rear, + left [rad]


Memory = TypeVar("Memory")


class TrailerSteering(Protocol, Generic[Memory]):
    """A trailer steering law: pure, memory in and memory out, so that a run can be snapshotted and replayed.

    It is constructed with the trailer's geometry and, by keyword, its own parameters:
    ``Name(trailer: TrailerGeometry, **parameters)``; one that asks for it by the keyword ``combination`` is told
    what the trailer is part of, too.
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
    """A steering law with its declarations; those of the catalogue inherit from it."""

    uses_off_tracking: ClassVar[bool] = True  # if so, it is guarded against bad estimates
    options: ClassVar[tuple[Option, ...]] = ()
