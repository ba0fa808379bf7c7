"""What a trailer's controller knows of its own trailer, what it commands, and the shape of every such controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from estimators.estimates import OffTracking
from sensors.messages import SteerAngles
from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class TrailerGeometry:
    """The steered trailer's own data sheet; nothing of the tractor is in it."""

    follow_distance: float  # hitch to follow point [m]
    axle_distances: tuple[float, ...]  # hitch to each axle, front to rear [m]
    steered: tuple[bool, ...]  # which of them are steered
    max_steer: float  # road-wheel angle limit [rad]
    max_steer_rate: float  # [rad/s]
    actuator_lag: float  # first-order time constant of the steering actuators [s]

    @property
    def steered_distances(self) -> tuple[float, ...]:
        """Hitch to each steered axle, front to rear [m]."""
        return tuple(x for x, is_steered in zip(self.axle_distances, self.steered, strict=True) if is_steered)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteerCommand:
    """Demanded road-wheel angles of the trailer's steered axles."""

    angles: FloatArray  # (n_steered,) front to rear, + left [rad]


Memory = TypeVar("Memory")


class TrailerSteering(Protocol, Generic[Memory]):
    """A trailer steering law: pure, memory in and memory out, so that a run can be snapshotted and replayed.

    It is constructed with the trailer's geometry and, by keyword, its own parameters:
    ``Name(trailer: TrailerGeometry, **parameters)``.
    """

    def init(self) -> Memory:
        """Memory before the first step."""
        ...

    def step(
        self, memory: Memory, tick: int, off_tracking: OffTracking | None, steer: SteerAngles
    ) -> tuple[Memory, SteerCommand]:
        """New memory and command at ``tick``; ``off_tracking`` is the newest estimate, None before the first."""
        ...
