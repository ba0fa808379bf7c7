"""Faults of the loop as plain data, the families of their kinds, and the names of the kinds.

A kind belongs to the family whose base class it has: ``MessageFault`` acts on the estimates under way to a trailer's
steering law or on the law's demands under way to the actuators, ``ActuatorFault`` on the actuators, ``BrakeShares`` on
the brakes of the simulated vehicle. None of them depends on the law, nor on how the off-tracking is estimated.
``scenarios.loop_faults.fault`` lists the kinds.
"""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, TypeGuard, TypeVar

import numpy as np

from sensors.faults.fault import TimedFault, defaults
from vehicle.combination.description import Vehicle
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray
from vehicle.option import Option

T = TypeVar("T")
Carried = Literal["estimates", "demands"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopFaultContext:
    """Properties of the faulty loop, handed to a fault kind's constructor."""

    vehicle: Vehicle  # the simulated one
    unit: int  # of the trailer whose loop it is
    rng: np.random.Generator  # of this fault alone

    @property
    def trailer(self) -> Unit:
        """The trailer whose loop it is."""
        return self.vehicle.led_unit(self.unit)


class LoopFaultKind:
    """Base of all fault kinds of the loop. The first line of the class's docstring is its description in listings."""

    options: ClassVar[tuple[Option, ...]] = ()  # numbers that set its severity, in this order

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        """A fault of this severity: one number for each of ``options``.

        Raises:
            ValueError: one line, if the vehicle cannot have this fault.
        """
        self._amount, self._context = amount, context


class MessageFault(LoopFaultKind, ABC):
    """Base of kinds that act on messages of the loop: estimates or demands."""

    carries: ClassVar[Carried]

    @abstractmethod
    def carried(self, tick: int, sent: Sequence[T], active: bool) -> list[T]:
        """Messages that arrive at this tick, oldest first.

        It is called at every step, also while the fault is not active and when nothing is sent.
        """


class ActuatorFault(LoopFaultKind, ABC):
    """Base of kinds that act on the steering actuators of a trailer."""

    @abstractmethod
    def demanded(self, tick: int, demand: FloatArray, angles: FloatArray, active: bool) -> FloatArray:
        """Demand (n_steered,) [rad] that makes sound actuators move as the faulty ones do.

        ``demand`` is the one that has arrived, ``angles`` are those of the axles now. It is called at every step, also
        while the fault is not active; then it returns the demand.
        """


class BrakeShares(LoopFaultKind, ABC):
    """Base of kinds that act on the brakes of the vehicle."""

    @abstractmethod
    def shares(self, tick: int, active: bool) -> FloatArray:
        """Share (n_wheels,) of its torque that the brake of each wheel has [-]; ones while the fault is not active."""


class LoopFault(TimedFault[LoopFaultKind]):
    """A fault of the loop."""

    __slots__ = ()

    def built(self, context: LoopFaultContext) -> LoopFaultKind:
        """The fault kind's object for one trailer's loop, or for the vehicle.

        Raises:
            ValueError: one line, if the vehicle cannot have this fault.
        """
        try:
            return self.kind(self.amount or defaults(self.kind), context)
        except ValueError as error:
            raise ValueError(f"faults: {self.name}: {error}") from None


LOOP_FAULTS: Final = {
    "estimate_loss": "scenarios.loop_faults.fault_kinds:EstimateLoss",
    "estimate_delay": "scenarios.loop_faults.fault_kinds:EstimateDelay",
    "demand_loss": "scenarios.loop_faults.fault_kinds:DemandLoss",
    "demand_delay": "scenarios.loop_faults.fault_kinds:DemandDelay",
    "actuator_stuck": "scenarios.loop_faults.fault_kinds:ActuatorStuck",
    "actuator_slow": "scenarios.loop_faults.fault_kinds:ActuatorSlow",
    "actuator_offset": "scenarios.loop_faults.fault_kinds:ActuatorOffset",
    "actuator_dead": "scenarios.loop_faults.fault_kinds:ActuatorDead",
    "brake_fault": "scenarios.loop_faults.fault_kinds:BrakeFault",
}


def is_loop_kind(part: object) -> TypeGuard[type[LoopFaultKind]]:
    """True if the part is a fault kind of the loop: a class of one of the families."""
    return inspect.isclass(part) and issubclass(part, MessageFault | ActuatorFault | BrakeShares)
