"""Steered axles that are locked straight while a combination goes backwards.

The laws steer the follow point onto a path that the hitch has gone; backwards it is the hitch that comes behind. Real
steered trailer axles are centred and locked for reversing by a signal with the reversing lights.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from controllers.trailer import SteerCommand, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.limits import reachable
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK

_BACKWARD: Final = -0.25  # a combination that has stopped rocks back on its tyres at 0.1 m/s [m/s]
_FORWARD: Final = 0.25  # [m/s]


class ReverseLockMemory(NamedTuple):
    """What is carried from one step to the next."""

    law: Any  # memory of the law
    tick: int | None  # of the last step; None before the first
    locked: bool
    demand: tuple[float, ...]  # last command [rad]


class ReverseLock:
    """A law that is heard forwards only.

    It starts anew when the combination goes forward again: what it has remembered lies on the wrong side of the way.
    """

    def __init__(self, law: TrailerSteering[Any], trailer: TrailerGeometry) -> None:
        """The law of a trailer with steered axles."""
        self.law, self._trailer = law, trailer

    def init(self) -> ReverseLockMemory:
        """Nothing seen yet, wheels straight."""
        return ReverseLockMemory(self.law.init(), None, False, (0.0,) * len(self._trailer.steered_distances))

    def step(
        self, memory: ReverseLockMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[ReverseLockMemory, SteerCommand]:
        """New memory and command at ``tick``; the wheels straighten at the actuators' rate."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        locked = signals.speed < (_FORWARD if memory.locked else _BACKWARD)
        if locked:
            straight = np.zeros(len(memory.demand))
            command = SteerCommand(angles=reachable(self._trailer, np.array(memory.demand), straight, elapsed))
            return ReverseLockMemory(memory.law, tick, True, tuple(command.angles.tolist())), command
        law, command = self.law.step(self.law.init() if memory.locked else memory.law, tick, off_tracking, signals)
        return ReverseLockMemory(law, tick, False, tuple(command.angles.tolist())), command
