"""One law for all speeds: a low-speed law for the manoeuvres of towns and yards, the LQR for the open road.

What the low-speed law asks for fades out over one band of speeds, the LQR fades in over another; their sum is the
command. In between, where a low-speed law would swing and a trailer is damped well by itself, hardly any is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.command_steer import CommandSteer
from controllers.trailer_steering.ct_at import CtAt
from controllers.trailer_steering.lateral_design import KMH
from controllers.trailer_steering.limits import reachable
from controllers.trailer_steering.lqr import Lqr, LqrMemory
from controllers.trailer_steering.path_preview import PathPreview
from controllers.trailer_steering.virtual_driver import VirtualDriver
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.option import Option

_LOW_SPEED: Final[dict[str, Callable[[TrailerGeometry, Combination], SteeringLaw[Any]]]] = {
    "command_steer": lambda trailer, combination: CommandSteer(trailer, combination=combination),
    "ct_at": lambda trailer, combination: CtAt(trailer, combination=combination),
    "path_preview": lambda trailer, combination: PathPreview(trailer),
    "virtual_driver": lambda trailer, combination: VirtualDriver(trailer),
}
_LOW_SPEED_OPTION: Final = Option(
    "low_speed", "path_preview", "name of the law at low speed", choices=tuple(_LOW_SPEED)
)

# assumed: between a tight turn's speed and a road's; path preview, command steer and the like swing at 50 km/h [m/s].
_WHOLE, _GONE = 25.0 * KMH, 45.0 * KMH


class CombinedMemory(NamedTuple):
    """What the law carries from one step to the next."""

    tick: int | None  # of the last step; None before the first
    low: Any  # memory of the low-speed law
    high: LqrMemory
    demand: tuple[float, ...]  # last command [rad]


class Combined(SteeringLaw[CombinedMemory]):
    """A low-speed law and the LQR, each at its speeds."""

    options: ClassVar[tuple[Option, ...]] = (_LOW_SPEED_OPTION, *Lqr.options)

    def __init__(
        self,
        trailer: TrailerGeometry,
        *,
        combination: Combination,
        low_speed: str = "path_preview",
        from_speed_kmh: float = 45.0,
        full_speed_kmh: float = 70.0,
        off_tracking_weight: float = 0.04,
        acceleration_weight: float = 0.03,
    ) -> None:
        """A controller for the trailer; all but ``low_speed``, the law's name, are the parameters of `Lqr`.

        Raises:
            ValueError: if the trailer has no steered axle, a law is unknown, or a parameter is outside its limits.
        """
        _LOW_SPEED_OPTION.check(low_speed, "low_speed")
        self._trailer = trailer
        self._high = Lqr(
            trailer,
            combination=combination,
            off_tracking_weight=off_tracking_weight,
            acceleration_weight=acceleration_weight,
            from_speed_kmh=from_speed_kmh,
            full_speed_kmh=full_speed_kmh,
        )
        self._low = _LOW_SPEED[low_speed](trailer, combination)

    def init(self) -> CombinedMemory:
        """Wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return CombinedMemory(None, self._low.init(), self._high.init(), straight)

    def step(
        self, memory: CombinedMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CombinedMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        share = min(1.0, max(0.0, (_GONE - signals.speed) / (_GONE - _WHOLE)))  # of the low-speed law
        high, command = self._high.step(memory.high, tick, off_tracking, signals)
        wanted = command.angles
        if share > 0.0:
            low, command = self._low.step(memory.low, tick, off_tracking, signals)
            wanted = wanted + share * command.angles
        else:
            low = self._low.init()  # what it would learn of a trailer that another law steers is wrong
        demand = reachable(self._trailer, np.array(memory.demand), wanted, elapsed)
        return CombinedMemory(tick, low, high, tuple(demand.tolist())), SteerCommand(angles=demand)
