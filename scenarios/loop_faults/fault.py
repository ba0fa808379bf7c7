"""Faults of the loop behind the sensors: as plain data, and the kinds of steering actuators, messages and brakes.

A kind belongs to the family whose base class it has: ``MessageFault`` acts on the estimates under way to a trailer's
steering law or on the law's demands under way to the actuators, ``ActuatorFault`` on the actuators, ``BrakeShares`` on
the brakes of the simulated vehicle. None of them depends on the law, nor on how the off-tracking is estimated.
``scenarios.loop_faults.fault`` lists the kinds.

The plant's actuators follow a demand with a lag and limits. A fault changes the demand so that they move as faulty ones
do, in every plant. Axles that one actuator turns share its fault.

A law that gets no new estimate knows its age. An actuator that gets no new demand holds the last one.
"""

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, TypeGuard, TypeVar

import numpy as np

from sensors.faults.fault import Options, TimedFault, defaults
from vehicle.clock import TICK, Pipe
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import wheels
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

    options: ClassVar[Options] = ()  # numbers that set its severity, in this order

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
    "estimate_loss": "scenarios.loop_faults.fault:EstimateLoss",
    "estimate_delay": "scenarios.loop_faults.fault:EstimateDelay",
    "demand_loss": "scenarios.loop_faults.fault:DemandLoss",
    "demand_delay": "scenarios.loop_faults.fault:DemandDelay",
    "actuator_stuck": "scenarios.loop_faults.fault:ActuatorStuck",
    "actuator_slow": "scenarios.loop_faults.fault:ActuatorSlow",
    "actuator_offset": "scenarios.loop_faults.fault:ActuatorOffset",
    "actuator_dead": "scenarios.loop_faults.fault:ActuatorDead",
    "brake_fault": "scenarios.loop_faults.fault:BrakeFault",
}


def is_loop_kind(part: object) -> TypeGuard[type[LoopFaultKind]]:
    """True if the part is a fault kind of the loop: a class of one of the families."""
    return inspect.isclass(part) and issubclass(part, MessageFault | ActuatorFault | BrakeShares)


_AXLE: Final = Option("axle", 0, "steered axle of the trailer from the front; 0: all", low=0, high=20)


class _OnAxles(ActuatorFault):
    """Base of the kinds below: picks the faulty axles, and knows when the fault began. Its last number is the axle."""

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        super().__init__(amount, context)
        self._axles = _faulty_axles(context.trailer, int(amount[-1]))  # (n_steered,)
        self._held: FloatArray | None = None  # last demand on the faulty actuators [rad]; None: the fault is not active
        self._tick = 0  # of that demand

    def demanded(self, tick: int, demand: FloatArray, angles: FloatArray, active: bool) -> FloatArray:
        """Demand for the faulty axles, and the given one for the others."""
        if not active:
            self._held = None
            return demand
        held = angles if self._held is None else self._held
        elapsed = 0.0 if self._held is None else (tick - self._tick) * TICK
        self._held, self._tick = self.moved(held, demand, elapsed), tick
        return np.where(self._axles, self._held, demand)

    @abstractmethod
    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """Demand (n_steered,) [rad] on faulty actuators, from the last one, ``elapsed`` [s] before.

        At the beginning of the fault the last one is the angle of each axle.
        """


class ActuatorStuck(_OnAxles):
    """The trailer's steered axles stay at their angles.

    Steered tag axles of trucks do so after faults of their valves: "fixed in current position" (Scania, fault code
    ESTA 0254).
    """

    options: ClassVar[Options] = (_AXLE,)

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """The angles at the beginning."""
        return held


class ActuatorSlow(_OnAxles):
    """The trailer's steered axles turn at a share of their highest rate."""

    options: ClassVar[Options] = (
        Option("share", 0.2, "rate limit over that of sound actuators", low=0.001, high=1.0),
        _AXLE,
    )

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        super().__init__(amount, context)
        trailer = context.trailer
        limit = trailer.steering.rate_limit if trailer.steering else 0.0
        self._rates = amount[0] * limit * np.array([abs(axle.steer_ratio) for axle in trailer.steered_axles])  # [rad/s]

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """The demand, as far as the axles come."""
        return _towards(demand, held, self._rates * elapsed)


class ActuatorOffset(_OnAxles):
    """The trailer's steered axles stand beside their demand."""

    options: ClassVar[Options] = (
        Option("offset", 2.0, "added to the demand, + left", unit="deg", low=-45.0, high=45.0),
        _AXLE,
    )

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """The demand with the offset."""
        return demand + math.radians(self._amount[0])


class ActuatorDead(_OnAxles):
    """The trailer's steered axles have no power: they centre themselves and stay straight.

    Steered tag axles of trucks do so after a fault of their supply: "centered due to a fault" (Scania, fault code
    EST 0239). The rate at which the centring cylinders turn them is assumed.
    """

    options: ClassVar[Options] = (
        Option("rate", 5.0, "at which the axles return to straight", unit="deg/s", low=0.1, high=90.0),
        _AXLE,
    )

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """Straight, as far as the axles come."""
        return _towards(np.zeros_like(held), held, np.full(len(held), math.radians(self._amount[0]) * elapsed))


def _towards(target: FloatArray, held: FloatArray, steps: FloatArray) -> FloatArray:
    """The held angles, moved towards the target by the ``steps`` (n,) [rad] at most."""
    moved: FloatArray = held + np.clip(target - held, -steps, steps)
    return moved


def _faulty_axles(trailer: Unit, axle: int) -> FloatArray:
    """Mask (n_steered,) of the steered axles that one fault concerns."""
    steered = [k for k, one in enumerate(trailer.axles) if one.steered]
    if axle > len(steered):
        axles = "1 steered axle" if len(steered) == 1 else f"{len(steered)} steered axles"
        raise ValueError(f"axle = {axle}: {trailer.name} has {axles}")
    faulty = {
        k for actuator in trailer.actuators if axle == 0 or steered[axle - 1] in actuator.axles for k in actuator.axles
    }
    return np.array([k in faulty for k in steered])


_DELAY: Final = Option("delay", 0.2, "added to the time under way", unit="s", low=0.001, high=60.0)


class _Loss(MessageFault):
    """Messages that are lost at random."""

    def carried(self, tick: int, sent: Sequence[T], active: bool) -> list[T]:
        """Messages that are not lost."""
        kept = [self._context.rng.random() >= self._amount[0] for _ in sent]
        return [message for message, is_kept in zip(sent, kept, strict=True) if is_kept or not active]


class _Delay(MessageFault):
    """Messages that arrive late.

    Those still under way when the fault ends are lost.
    """

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        super().__init__(amount, context)
        self._ticks = round(amount[0] / TICK)
        self._under_way: Pipe[Any] = Pipe()

    def carried(self, tick: int, sent: Sequence[T], active: bool) -> list[T]:
        """Messages whose time has come."""
        if not active:
            self._under_way = Pipe()
            return list(sent)
        for message in sent:
            self._under_way = self._under_way.put(tick + self._ticks, message)
        self._under_way, due = self._under_way.deliver(tick)
        return list(due)


class EstimateLoss(_Loss):
    """Estimates are lost at random on their way to the steering law."""

    carries: ClassVar[Carried] = "estimates"
    options: ClassVar[Options] = (Option("share", 0.3, "share of estimates", low=0.0, high=1.0),)


class EstimateDelay(_Delay):
    """Estimates reach the steering law late."""

    carries: ClassVar[Carried] = "estimates"
    options: ClassVar[Options] = (_DELAY,)


class DemandLoss(_Loss):
    """Demands are lost at random on their way to the actuators, which hold the last one."""

    carries: ClassVar[Carried] = "demands"
    options: ClassVar[Options] = (Option("share", 0.3, "share of demands", low=0.0, high=1.0),)


class DemandDelay(_Delay):
    """Demands reach the actuators late."""

    carries: ClassVar[Carried] = "demands"
    options: ClassVar[Options] = (_DELAY,)


class BrakeFault(BrakeShares):
    """Brakes of a unit, of one of its axles or of one side have a share of their torque; the retarder stays sound."""

    options: ClassVar[Options] = (
        Option("share", 0.0, "torque over that of sound brakes", low=0.0, high=1.0),
        Option("unit", 0, "1 the tractor, 2 the first trailer, ...; 0: the last", low=0, high=20),
        Option("axle", 0, "of that unit from the front; 0: all", low=0, high=20),
        Option("side", 0, "1 left, -1 right, 0 both", low=-1, high=1),
    )

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        super().__init__(amount, context)
        share, side, units = amount[0], int(amount[3]), context.vehicle.units
        unit, axle = int(amount[1]) or len(units), int(amount[2])
        if unit > len(units):
            raise ValueError(f"unit = {unit}: {context.vehicle.name} has {len(units)} units")
        named = units[unit - 1]
        if axle > len(named.axles):
            raise ValueError(f"axle = {axle}: {named.name} has {len(named.axles)} axles")
        chosen = [
            wheel.unit == unit - 1 and axle in (0, wheel.axle_in_unit + 1) and side in (0, wheel.side)
            for wheel in wheels(context.vehicle)
        ]
        braked = [wheel.brake is not None for wheel in wheels(context.vehicle)]
        if not any(there and brake for there, brake in zip(chosen, braked, strict=True)):
            raise ValueError(f"no brake there: {named.name} has none on the axles that the fault names")
        self._shares: FloatArray = np.where(chosen, share, 1.0)

    def shares(self, tick: int, active: bool) -> FloatArray:
        """Shares of all wheels."""
        return self._shares if active else np.ones_like(self._shares)
