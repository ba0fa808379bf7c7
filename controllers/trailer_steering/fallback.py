"""What steers a trailer whose off-tracking is not known: its articulation at manoeuvring speed, else nothing."""

from __future__ import annotations

from typing import ClassVar, Final, Literal

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.command_steer import CommandSteer, CommandSteerMemory
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals

FallbackName = Literal["command_steer", "straight"]

# Command steer shortens the wheelbase, which unsettles a trailer at speed: systems in use lock there. Whole up to
# 30 km/h and gone at 50 km/h; assumed, between a tight turn's speed and a road's [m/s].
_WHOLE: Final = 8.3
_GONE: Final = 13.9


class Fallback(SteeringLaw[CommandSteerMemory]):
    """Command steer that follows the hitch in steady turns, fading with speed; or straight wheels at any speed."""

    uses_off_tracking: ClassVar[bool] = False

    def __init__(self, trailer: TrailerGeometry, *, combination: Combination, name: FallbackName) -> None:
        """For a trailer with steered axles."""
        self._law = CommandSteer(trailer, combination=combination)
        self._steers = name == "command_steer"

    def init(self) -> CommandSteerMemory:
        """Wheels straight."""
        return self._law.init()

    def step(
        self, memory: CommandSteerMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CommandSteerMemory, SteerCommand]:
        """New memory and command at ``tick``; signals that are no numbers leave the wheels straight."""
        told = np.concatenate([[signals.speed], signals.articulation, signals.yaw_rates])
        if not (self._steers and np.isfinite(told).all()):
            return self._law.init(), SteerCommand(angles=np.zeros(len(memory.demand)))
        memory, command = self._law.step(memory, tick, None, signals)
        share = min(1.0, max(0.0, (_GONE - abs(signals.speed)) / (_GONE - _WHOLE)))
        return memory, SteerCommand(angles=share * command.angles)
