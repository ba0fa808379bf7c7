"""Laws without an estimate: command steer, whose axles turn with the articulation, and straight axles.

Mechanical and hydraulic systems do this by a linkage from the turntable. To emulate a rigid axle L' behind the hitch,
an axle at the distance x is turned by

    tan delta(x) = -(x - L')/L' tan gamma_h

with the direction of the hitch's travel gamma_h against the trailer's axis: the lateral velocity of a rigid trailer is
linear along its axis and zero at L'. With L' half the follow distance L_f, follow point and hitch run on the same
circle in a steady turn. At the entry gamma_h leads and the rear swings out, because the law does not know the path.

Published systems use the articulation angle for gamma_h. Here the part that the hitch adds, in front of or behind the
tractor's rear axle, comes from tractor speed and gyro; without it L' = L_f/2 would leave some off-tracking.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import AxleGroup, check_steered, limited_direction, reachable
from controllers.trailer_steering.reckoned_motion import hitch_motion
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.option import PartParameters, quantity

_CREEP = 0.2  # below this speed the direction of travel is sensor noise [m/s]
_SHORTEST, _LONGEST = 0.1, 2.0  # of the follow distance; a shorter one needs more steer than any axle has


class CommandSteerMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    demand: tuple[float, ...]  # last command [rad]


class CommandSteer(SteeringLaw[CommandSteerMemory]):
    """Steer angles as a function of the articulation; the off-tracking is not used."""

    uses_off_tracking: ClassVar[bool] = False

    class Parameters(PartParameters):
        """Geometry of the emulated trailer."""

        rigid_length: float | None = quantity(
            None, "m", 0.1, 40.0, "hitch to the emulated rigid axle", default_text="half the follow distance"
        )

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        """A controller for the trailer of a ``combination``.

        Raises:
            ValueError: if the trailer has no steered axle, or the length is outside 0.1 to 2 follow distances.
        """
        check_steered("command_steer", trailer)
        given = (parameters or self.Parameters()).rigid_length
        length = 0.5 * trailer.follow_distance if given is None else given
        low, high = _SHORTEST * trailer.follow_distance, _LONGEST * trailer.follow_distance
        replace(self.Parameters.option("rigid_length"), low=low, high=high).check(length, "rigid_length")
        self._trailer, self._combination = trailer, combination
        self._axles = AxleGroup.of(trailer)
        self._beyond = trailer.follow_distance / length - 1.0  # distance of the follow point behind L', over L'

    def init(self) -> CommandSteerMemory:
        """Wheels straight."""
        return CommandSteerMemory(None, (0.0,) * len(self._trailer.steered_distances))

    def step(
        self, memory: CommandSteerMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CommandSteerMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        wanted = last = np.array(memory.demand)
        if abs(signals.speed) >= _CREEP:
            lead = limited_direction(hitch_motion(self._combination, signals).direction)
            wanted = self._axles.steer_angles(lead, -math.atan(self._beyond * math.tan(lead)), 0.0)
        demand = reachable(self._trailer, last, wanted, elapsed)
        return CommandSteerMemory(tick, tuple(demand.tolist())), SteerCommand(angles=demand)


class Unsteered(SteeringLaw[None]):
    """Zero demand on every steered axle."""

    uses_off_tracking: ClassVar[bool] = False

    def __init__(self, trailer: TrailerGeometry) -> None:
        self._axles = len(trailer.steered_distances)

    def init(self) -> None:
        """No memory."""
        return

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        """Straight wheels."""
        return None, SteerCommand(angles=np.zeros(self._axles))
