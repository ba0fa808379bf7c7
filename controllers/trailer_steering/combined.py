"""One law for all speeds: a low-speed law for towns and yards, the LQR for the open road.

The low-speed law fades out over one band of speeds and the LQR fades in over another; the command is their sum. Between
the bands little steering is needed: a low-speed law would oscillate there, and the trailer itself is well damped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.command_steer import CommandSteer
from controllers.trailer_steering.ct_at import CtAt
from controllers.trailer_steering.kinematics import reachable
from controllers.trailer_steering.lqr import KMH, Lqr, LqrMemory
from controllers.trailer_steering.path_preview import PathPreview
from controllers.trailer_steering.virtual_driver import VirtualDriver
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.option import option

LowSpeed = Literal["command_steer", "ct_at", "path_preview", "virtual_driver"]
_LOW_SPEED: Final[dict[LowSpeed, Callable[[TrailerGeometry, Combination], SteeringLaw[Any]]]] = {
    "command_steer": lambda trailer, combination: CommandSteer(trailer, combination=combination),
    "ct_at": lambda trailer, combination: CtAt(trailer, combination=combination),
    "path_preview": lambda trailer, combination: PathPreview(trailer),
    "virtual_driver": lambda trailer, combination: VirtualDriver(trailer),
}

# assumed, between the speed of a tight turn and that of a road; the low-speed laws oscillate at 50 km/h [m/s].
_FULL_UP_TO, _NONE_FROM = 25.0 * KMH, 45.0 * KMH


class CombinedMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    low: Any  # memory of the low-speed law
    high: LqrMemory
    demand: tuple[float, ...]  # last command [rad]


class Combined(SteeringLaw[CombinedMemory]):
    """Sum of a low-speed law and the LQR, each in its range of speeds."""

    class Parameters(Lqr.Parameters):
        """Name of the law at low speed, and the parameters of the LQR."""

        low_speed: LowSpeed = option("name of the law at low speed", "path_preview")

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        """A controller for the trailer of a ``combination``.

        Raises:
            ValueError: if the trailer has no steered axle.
        """
        given = parameters or self.Parameters()
        self._trailer = trailer
        self._high = Lqr(trailer, combination=combination, parameters=given)
        self._low = _LOW_SPEED[given.low_speed](trailer, combination)

    def init(self) -> CombinedMemory:
        """Wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return CombinedMemory(None, self._low.init(), self._high.init(), straight)

    def step(
        self, memory: CombinedMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CombinedMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        share = min(1.0, max(0.0, (_NONE_FROM - signals.speed) / (_NONE_FROM - _FULL_UP_TO)))  # of the low-speed law
        high, command = self._high.step(memory.high, tick, off_tracking, signals)
        wanted = command.angles
        if share > 0.0:
            low, command = self._low.step(memory.low, tick, off_tracking, signals)
            wanted = wanted + share * command.angles
        else:
            low = self._low.init()  # it must not adapt while another law steers
        demand = reachable(self._trailer, np.array(memory.demand), wanted, elapsed)
        return CombinedMemory(tick, low, high, tuple(demand.tolist())), SteerCommand(angles=demand)
