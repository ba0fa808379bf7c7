"""Fault kinds of messages: transmission and timing of any sensor, and the combination's own sensors.

The latter act on the signals of one trailer: its hitch is the one at its front, its gyro the one on its body.
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import replace
from typing import ClassVar, Final

from sensors.faults.fault import FaultContext, Options, T
from sensors.messages import CombinationSignals, Message, Sensor
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option

_SHARE: Final = Option("share", 0.1, "share of messages", low=0.0, high=1.0)


class AnySensorFault:
    """Base of fault kinds that apply to every sensor."""

    options: ClassVar[Options] = ()
    needs: ClassVar[str] = "a sensor"

    @classmethod
    def applies_to(cls, message: type[Message]) -> bool:
        """Any message will do."""
        return True


class Dropout(AnySensorFault):
    """Messages are lost at random."""

    options: ClassVar[Options] = (_SHARE,)

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        (self._share,) = amount
        self._rng = context.rng

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        """The message, unless it is lost."""
        message = sensor.sample(truth)
        lost = self._rng.random() < self._share
        return None if lost and active else message


class Duplicate(AnySensorFault):
    """Messages are replaced at random by the previous one, under the new time."""

    options: ClassVar[Options] = (_SHARE,)

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        (self._share,) = amount
        self._rng = context.rng
        self._last: Message | None = None

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        """The message, or the last sound one with the stamp of this tick."""
        message = sensor.sample(truth)
        repeated = self._rng.random() < self._share
        if repeated and active and self._last is not None:
            return replace(self._last, tick=truth.tick)
        self._last = message
        return message


class Freeze(Duplicate):
    """The last message before the fault is repeated, under the new time."""

    options: ClassVar[Options] = ()

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        super().__init__((1.0,), context)


class Delay(AnySensorFault):
    """Messages arrive late, stamped with the time of their capture.

    Messages that are still under way when the fault ends are lost.
    """

    options: ClassVar[Options] = (
        Option("delay", 1, "messages are late by so many captures", unit="captures", low=1, high=50),
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        (self._captures,) = amount
        self._waiting: deque[Message | None] = deque()

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        """The message that arrives at this tick."""
        message = sensor.sample(truth)
        if not active:
            self._waiting.clear()
            return message
        self._waiting.append(message)
        return self._waiting.popleft() if len(self._waiting) > self._captures else None


class SignalFault(ABC):
    """Base of fault kinds that apply to the combination's own sensors; a subclass writes ``degraded``."""

    options: ClassVar[Options] = ()
    needs: ClassVar[str] = "a combination's own sensors"

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        self._amount, self._unit = amount, context.unit

    @classmethod
    def applies_to(cls, message: type[Message]) -> bool:
        """Only signals of a combination will do."""
        return issubclass(message, CombinationSignals)

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        """The signals, degraded while the fault is active."""
        signals = sensor.sample(truth)
        return self.degraded(signals, active) if isinstance(signals, CombinationSignals) else signals

    @abstractmethod
    def degraded(self, signals: CombinationSignals, active: bool) -> CombinationSignals:
        """Signals of the faulty sensor; the given ones while the fault is not active."""


class ArticulationOffset(SignalFault):
    """The hitch-angle sensor of the trailer is shifted."""

    options: ClassVar[Options] = (Option("offset", 2.0, "added to the hitch angle", unit="deg", low=-90.0, high=90.0),)

    def degraded(self, signals: CombinationSignals, active: bool) -> CombinationSignals:
        """Signals with a shifted hitch angle."""
        if not active:
            return signals
        angle = float(signals.articulation[self._unit - 1]) + math.radians(self._amount[0])
        return replace(signals, articulation=_with(signals.articulation, self._unit - 1, angle))


class ArticulationStuck(SignalFault):
    """The hitch-angle sensor of the trailer stays at its last reading; from the first sample on: at zero."""

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        super().__init__(amount, context)
        self._last = 0.0  # [rad]

    def degraded(self, signals: CombinationSignals, active: bool) -> CombinationSignals:
        """Signals with the hitch angle of the last sample before the fault."""
        if active:
            return replace(signals, articulation=_with(signals.articulation, self._unit - 1, self._last))
        self._last = float(signals.articulation[self._unit - 1])
        return signals


class GyroBias(SignalFault):
    """The trailer's gyro has a constant bias."""

    options: ClassVar[Options] = (Option("bias", 1.0, "added to the yaw rate", unit="deg/s", low=-300.0, high=300.0),)

    def degraded(self, signals: CombinationSignals, active: bool) -> CombinationSignals:
        """Signals with a biased yaw rate."""
        if not active:
            return signals
        rate = float(signals.yaw_rates[self._unit]) + math.radians(self._amount[0])
        return replace(signals, yaw_rates=_with(signals.yaw_rates, self._unit, rate))


class GyroDrift(SignalFault):
    """The bias of the trailer's gyro grows from zero at a constant rate."""

    options: ClassVar[Options] = (
        Option("drift", 0.1, "growth of the bias per second", unit="deg/s2", low=-100.0, high=100.0),
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        super().__init__(amount, context)
        self._begin: int | None = None  # first sample of the fault [ticks]

    def degraded(self, signals: CombinationSignals, active: bool) -> CombinationSignals:
        """Signals with a drifting yaw rate."""
        if not active:
            return signals
        self._begin = signals.tick if self._begin is None else self._begin
        bias = math.radians(self._amount[0]) * (signals.tick - self._begin) * TICK
        rate = float(signals.yaw_rates[self._unit]) + bias
        return replace(signals, yaw_rates=_with(signals.yaw_rates, self._unit, rate))


class WheelSpeedDropout(SignalFault):
    """The wheel-speed sensors give no pulses: the speed reads zero."""

    def degraded(self, signals: CombinationSignals, active: bool) -> CombinationSignals:
        """Signals with a speed of zero."""
        return replace(signals, speed=0.0) if active else signals


def _with(values: FloatArray, index: int, value: float) -> FloatArray:
    """A copy of the array with another value at one place."""
    changed = values.copy()
    changed[index] = value
    return changed
