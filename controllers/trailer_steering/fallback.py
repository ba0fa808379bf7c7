"""Fallback steering without an off-tracking estimate: by articulation at manoeuvring speed, straight above."""

from __future__ import annotations

from typing import ClassVar, Final, Literal

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.command_steer import CommandSteer, CommandSteerMemory
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals

FallbackName = Literal["command_steer", "straight"]

# Command steer shortens the wheelbase, which destabilises a trailer at speed; systems in use lock there. Assumed,
# between the speed of a tight turn and that of a road: full authority up to 30 km/h, none from 50 km/h on [m/s].
_FULL_UP_TO: Final = 8.3
_NONE_FROM: Final = 13.9


class Fallback(SteeringLaw[CommandSteerMemory]):
    """Command steer with half the follow distance, reduced with speed; or straight wheels at any speed."""

    uses_off_tracking: ClassVar[bool] = False

    def __init__(self, trailer: TrailerGeometry, *, combination: Combination, name: FallbackName) -> None:
        """Construct it for a trailer with steered axles."""
        self._law = CommandSteer(trailer, combination=combination)
        self._steers = name == "command_steer"

    def init(self) -> CommandSteerMemory:
        """Wheels straight."""
        return self._law.init()

    def step(
        self, memory: CommandSteerMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CommandSteerMemory, SteerCommand]:
        """New memory and command at ``tick``; wheels stay straight if a signal is not finite."""
        read = np.concatenate([[signals.speed], signals.articulation, signals.yaw_rates])
        if not (self._steers and np.isfinite(read).all()):
            return self._law.init(), SteerCommand(angles=np.zeros(len(memory.demand)))
        memory, command = self._law.step(memory, tick, None, signals)
        share = min(1.0, max(0.0, (_NONE_FROM - abs(signals.speed)) / (_NONE_FROM - _FULL_UP_TO)))
        return memory, SteerCommand(angles=share * command.angles)
