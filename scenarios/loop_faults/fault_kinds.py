"""Fault kinds of steering actuators, of messages in the loop, and of the brakes.

The plant's actuators follow a demand with a lag and limits. A fault changes the demand so that they move as faulty ones
do, in every plant. Axles that one actuator turns share its fault.

A law that gets no new estimate knows its age. An actuator that gets no new demand holds the last one.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Final

import numpy as np

from scenarios.loop_faults.fault import ActuatorFault, BrakeShares, Carried, LoopFaultContext, MessageFault, T
from vehicle.clock import TICK, Pipe
from vehicle.combination.layout import wheels
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray
from vehicle.option import Option

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

    options: ClassVar[tuple[Option, ...]] = (_AXLE,)

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """The angles at the beginning."""
        return held


class ActuatorSlow(_OnAxles):
    """The trailer's steered axles turn at a share of their highest rate."""

    options: ClassVar[tuple[Option, ...]] = (
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

    options: ClassVar[tuple[Option, ...]] = (
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

    options: ClassVar[tuple[Option, ...]] = (
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
    """Mask (n_steered,) of the steered axles that one fault concerns.

    Raises:
        ValueError: one line, if there is no such axle.
    """
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
    options: ClassVar[tuple[Option, ...]] = (Option("share", 0.3, "share of estimates", low=0.0, high=1.0),)


class EstimateDelay(_Delay):
    """Estimates reach the steering law late."""

    carries: ClassVar[Carried] = "estimates"
    options: ClassVar[tuple[Option, ...]] = (_DELAY,)


class DemandLoss(_Loss):
    """Demands are lost at random on their way to the actuators, which hold the last one."""

    carries: ClassVar[Carried] = "demands"
    options: ClassVar[tuple[Option, ...]] = (Option("share", 0.3, "share of demands", low=0.0, high=1.0),)


class DemandDelay(_Delay):
    """Demands reach the actuators late."""

    carries: ClassVar[Carried] = "demands"
    options: ClassVar[tuple[Option, ...]] = (_DELAY,)


class BrakeFault(BrakeShares):
    """Brakes of a unit, of one of its axles or of one side have a share of their torque; the retarder stays sound."""

    options: ClassVar[tuple[Option, ...]] = (
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
