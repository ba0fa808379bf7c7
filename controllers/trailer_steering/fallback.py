"""Fallback steering without an off-tracking estimate: by dead reckoning or articulation at low speed, straight above.

Dead reckoning keeps the rear on the path of the hitch, where command steer lets it swing out at the entry of a turn and
cut in at its exit. It needs sensors that agree with each other. Where an articulation does not change by the difference
of two yaw rates, or a wheel speed repeats itself, command steer takes over: it errs, but its error does not grow.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, Literal, NamedTuple

import numpy as np

from controllers.trailer import Combination, TrailerGeometry
from controllers.trailer_steering.command_steer import CommandSteer, CommandSteerMemory
from controllers.trailer_steering.reckoned_driver import ReckonedDriver, ReckonedDriverMemory
from estimators.estimates import OffTracking
from estimators.off_tracking.signal_quality import agree
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray

FallbackName = Literal["dead_reckoning", "command_steer", "straight"]

# Command steer shortens the wheelbase, which destabilises a trailer at speed; systems in use lock there. Assumed,
# between the speed of a tight turn and that of a road: full authority up to 30 km/h, none from 50 km/h on [m/s].
_FULL_UP_TO: Final = 8.3
_NONE_FROM: Final = 13.9
_COMPARED: Final = 2000  # signals that are tested against each other [ticks]
_GAP: Final = 0.3  # without signals, after which the path is unknown [s]
_CHANGE_TIME: Final = 2.0  # from one way of steering to the other [s]
_UNLIMITED: Final = 1e3  # rate of the laws here; the guard limits it for all of them [rad/s]


class FallbackMemory(NamedTuple):
    """State of the fallback between two steps."""

    reckoning: ReckonedDriverMemory
    rows: tuple[tuple[float, ...], ...] = ()  # signals of the last seconds in the order of `DeadReckoning.row`
    doubted: float = 0.0  # distance until the reckoned path is made of signals that agree [m]
    steered_at: int | None = None  # last step of steering [ticks]
    share: float = 1.0  # of dead reckoning against command steer


class Fallback:
    """Steering by dead reckoning or command steer, reduced with speed; or straight wheels at any speed."""

    def __init__(self, trailer: TrailerGeometry, *, combination: Combination, name: FallbackName) -> None:
        """Construct it for a trailer with steered axles."""
        free = replace(trailer, max_steer_rate=_UNLIMITED)
        self._trailer, self._unit, self._name = trailer, combination.unit, name
        self._reckoning = ReckonedDriver(free, combination)
        self._command_steer = CommandSteer(free, combination=combination)

    def init(self) -> FallbackMemory:
        """Straight road behind."""
        return FallbackMemory(self._reckoning.init())

    def observed(
        self, memory: FallbackMemory, tick: int, estimate: OffTracking | None, signals: CombinationSignals
    ) -> FallbackMemory:
        """Memory with the signals of ``tick``, and with an estimate if there is a new one that can be relied on."""
        if self._name != "dead_reckoning" or not _are_finite(signals):
            return memory
        before, length = memory.reckoning.tick, self._trailer.follow_distance
        elapsed = 0.0 if before is None else (tick - before) * TICK
        reckoning = self._reckoning.reckoned(memory.reckoning, tick, estimate, signals)
        doubted = length if elapsed > _GAP else max(0.0, memory.doubted - abs(signals.speed) * elapsed)
        if reckoning.estimate is not memory.reckoning.estimate:
            doubted = 0.0
        rows = (*[row for row in memory.rows if row[0] >= tick - _COMPARED], _row(signals, self._unit))
        return memory._replace(reckoning=reckoning, rows=rows, doubted=doubted)

    def steered(
        self, memory: FallbackMemory, tick: int, signals: CombinationSignals, last: FloatArray
    ) -> tuple[FallbackMemory, FloatArray]:
        """New memory and angles (n_steered,) [rad], not limited in rate; straight if a signal is not finite.

        ``last`` are the angles demanded so far.
        """
        if self._name == "straight" or not _are_finite(signals):
            return memory, np.zeros(len(last))
        _, command = self._command_steer.step(CommandSteerMemory(tick - 1, tuple(last.tolist())), tick, None, signals)
        angles = command.angles
        if self._name == "dead_reckoning":
            memory = self._with_share(memory, tick)
            reckoning, by_path = self._reckoning.steered(memory.reckoning, tick, signals, last)
            memory = memory._replace(reckoning=reckoning)
            angles = memory.share * by_path + (1.0 - memory.share) * angles
        authority = min(1.0, max(0.0, (_NONE_FROM - abs(signals.speed)) / (_NONE_FROM - _FULL_UP_TO)))
        return memory, authority * angles

    def _with_share(self, memory: FallbackMemory, tick: int) -> FallbackMemory:
        """Memory after a test of the signals; on the way from one way of steering to the other."""
        if not agree(np.array(memory.rows), self._unit):
            memory = memory._replace(doubted=self._trailer.follow_distance)
        wanted = 0.0 if memory.doubted > 0.0 else 1.0
        pause = math.inf if memory.steered_at is None else (tick - memory.steered_at) * TICK
        step = 1.0 if pause > _GAP else pause / _CHANGE_TIME
        share = memory.share + max(-step, min(step, wanted - memory.share))
        return memory._replace(share=share, steered_at=tick)


def _are_finite(signals: CombinationSignals) -> bool:
    read = (signals.speed, *signals.articulation.tolist(), *signals.yaw_rates.tolist(), *signals.angles.tolist())
    return all(map(math.isfinite, read))


def _row(signals: CombinationSignals, unit: int) -> tuple[float, ...]:
    ahead, rates = signals.articulation[:unit].tolist(), signals.yaw_rates[: unit + 1].tolist()
    return (signals.tick, signals.speed, signals.steer, 0.0, *ahead, *rates)
