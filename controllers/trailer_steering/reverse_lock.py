"""Lock of the steered axles in reverse.

The laws steer the follow point onto the path of the hitch; in reverse the follow point leads. Real steered trailer
axles are centred and locked in reverse by the signal of the reversing lights.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from controllers.trailer import Actuation, SteerCommand, TrailerGeometry, TrailerSteering, told_actuation
from controllers.trailer_steering.limits import reachable
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.closing import close_part

_BACKWARD: Final = -0.25  # below the 0.1 m/s at which a stopped combination rocks on its tyres [m/s]
_FORWARD: Final = 0.25  # [m/s]


class ReverseLockMemory(NamedTuple):
    """State between two steps."""

    law: Any  # memory of the law
    tick: int | None  # of the last step; None before the first
    locked: bool
    demand: tuple[float, ...]  # last command [rad]


class ReverseLock:
    """A law that steers forwards only and starts with a new memory after reversing."""

    def __init__(self, law: TrailerSteering[Any], trailer: TrailerGeometry) -> None:
        """Lock a ``law`` for a trailer with steered axles."""
        self.law, self._trailer = law, trailer

    def init(self) -> ReverseLockMemory:
        """Memory of a new run, wheels straight."""
        return ReverseLockMemory(self.law.init(), None, False, (0.0,) * len(self._trailer.steered_distances))

    def actuated(self, memory: ReverseLockMemory, actuation: Actuation) -> ReverseLockMemory:
        """Memory with the law told what its actuators do."""
        return memory._replace(law=told_actuation(self.law, memory.law, actuation))

    def step(
        self, memory: ReverseLockMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[ReverseLockMemory, SteerCommand]:
        """New memory and command at ``tick``; in reverse the wheels return to straight at the actuators' rate."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        locked = signals.speed < (_FORWARD if memory.locked else _BACKWARD)
        if locked:
            straight = np.zeros(len(memory.demand))
            command = SteerCommand(angles=reachable(self._trailer, np.array(memory.demand), straight, elapsed))
            return ReverseLockMemory(memory.law, tick, True, tuple(command.angles.tolist())), command
        law, command = self.law.step(self.law.init() if memory.locked else memory.law, tick, off_tracking, signals)
        return ReverseLockMemory(law, tick, False, tuple(command.angles.tolist())), command

    def close(self) -> None:
        """Close the law."""
        close_part(self.law)
