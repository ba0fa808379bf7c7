"""Fault kinds of transmission and timing: they apply to the messages of any sensor."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import ClassVar, Final

from sensors.faults.fault import FaultContext, T
from sensors.messages import Message, Sensor
from vehicle.option import Option

_SHARE: Final = Option("share", 0.1, "share of messages", low=0.0, high=1.0)


class AnySensorFault:
    """Base of fault kinds that apply to every sensor."""

    options: ClassVar[tuple[Option, ...]] = ()
    needs: ClassVar[str] = "a sensor"

    @classmethod
    def applies_to(cls, message: type[Message]) -> bool:
        """Any message will do."""
        return True


class Dropout(AnySensorFault):
    """Messages are lost at random."""

    options: ClassVar[tuple[Option, ...]] = (_SHARE,)

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

    options: ClassVar[tuple[Option, ...]] = (_SHARE,)

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

    options: ClassVar[tuple[Option, ...]] = ()

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        super().__init__((1.0,), context)


class Delay(AnySensorFault):
    """Messages arrive late, stamped with the time of their capture.

    Messages that are still under way when the fault ends are lost.
    """

    options: ClassVar[tuple[Option, ...]] = (
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
