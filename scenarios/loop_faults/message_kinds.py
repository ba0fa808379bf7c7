"""Fault kinds of messages: estimates under way to the law, and its demands under way to the actuators.

A law that gets no new estimate knows its age. An actuator that gets no new demand holds the last one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Final

from scenarios.loop_faults.fault import Carried, LoopFaultContext, MessageFault, T
from vehicle.clock import TICK, Pipe
from vehicle.option import Option

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
