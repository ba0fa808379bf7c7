"""Laws on the combination's own signals, without an estimate: straight axles, command steer, and the heading law CT-AT.

Command steer turns the axles with the articulation, as mechanical and hydraulic systems do by a linkage from the
turntable. To emulate a rigid axle L' behind the hitch,
an axle at the distance x is turned by

    tan delta(x) = -(x - L')/L' tan gamma_h

with the direction of the hitch's travel gamma_h against the trailer's axis: the lateral velocity of a rigid trailer is
linear along its axis and zero at L'. With L' half the follow distance L_f, follow point and hitch run on the same
circle in a steady turn. At the entry gamma_h leads and the rear swings out, because the law does not know the path.

Published systems use the articulation angle for gamma_h. Here the part that the hitch adds, in front of or behind the
tractor's rear axle, comes from tractor speed and gyro; without it L' = L_f/2 would leave some off-tracking.

CT-AT (conventional tractor, active trailer) turns the follow point into the heading that the hitch had at the same
place. Source: Jujnovich & Cebon, "Path-following steering control for articulated vehicles", J. Dyn. Syst. Meas.
Control 135(3), 2013, as de Saxe & Cebon 2018 describe it. A non-linear law compares the headings at front and rear of
the trailer, from speed, articulation angle and gyros; a reference trailer handles saturated steering. Its equations and
gains were not available. Derived here:

- the hitch's heading is stored along its dead-reckoned path, and the one required at the rear is that of the place
  which the follow point passes (exact for any articulation; equal arc lengths of hitch and follow point would drift
  apart);
- with it as the follow point's direction of travel, the axles roll without slip (``kinematics``);
- the reference trailer has no limits and its follow point is always on the path: its axis is the chord from the path to
  the hitch. The heading difference to it, times ``heading_gain``, is added.

Tyre slip is not modelled. On a slippery or cambered road the heading error grows until it balances the slip, and a
steady off-tracking of about follow distance times slip over gain remains: the known weakness of the scheme.
"""

import math
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import (
    AxleGroup,
    HitchMotion,
    ReckonedPath,
    check_steered,
    extended,
    hitch_motion,
    limited_direction,
    reachable,
    straight_behind,
)
from estimators.estimates import OffTracking
from estimators.off_tracking.hitch_path import crossing, tangent
from sensors.messages import CombinationSignals
from vehicle.clock import elapsed_since
from vehicle.frames import FloatArray, arc_length
from vehicle.option import PartParameters, quantity

_CREEP = 0.2  # below this speed the direction of travel is sensor noise, and the axles keep their angles [m/s]
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
        return CommandSteerMemory(None, self._trailer.straight)

    def step(
        self, memory: CommandSteerMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CommandSteerMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
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


_REACH = 0.5  # half window of the heading's fit to the path [m]


class CtAtMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    path: ReckonedPath
    demand: tuple[float, ...]  # last command [rad]


class CtAt(SteeringLaw[CtAtMemory]):
    """Steer angles that match the trailer's heading to the path of its hitch; the off-tracking is not used."""

    class Parameters(PartParameters):
        """Gain against the reference trailer, and preview against the actuators' lag."""

        heading_gain: float = quantity(1.5, "-", 0.0, 5.0, "turn of the follow point per heading error")
        preview: float | None = quantity(
            None, "s", 0.0, 1.0, "preview time of the required heading", default_text="the actuators' lag"
        )

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        """A controller for the trailer of a ``combination``.

        Raises:
            ValueError: if the trailer has no steered axle, or its actuators are too slow for the preview.
        """
        check_steered("ct_at", trailer)
        given = parameters or self.Parameters()
        self._gain = given.heading_gain
        self._preview = trailer.actuator_lag if given.preview is None else given.preview
        self.Parameters.option("preview").check(self._preview, "preview")
        self._trailer, self._combination = trailer, combination
        self._axles = AxleGroup.of(trailer)

    def init(self) -> CtAtMemory:
        """Straight road behind, wheels straight."""
        return CtAtMemory(None, straight_behind(self._trailer.follow_distance), self._trailer.straight)

    def step(
        self, memory: CtAtMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CtAtMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
        motion = hitch_motion(self._combination, signals)
        path = extended(memory.path, tick, motion, elapsed)
        wanted = last = np.array(memory.demand)
        required = self._required_direction(path.in_trailer(), motion) if motion.v_x >= _CREEP else None
        if required is not None:
            wanted = self._axles.steer_angles(limited_direction(motion.direction), limited_direction(required), 0.0)
        demand = reachable(self._trailer, last, wanted, elapsed)
        return CtAtMemory(tick, path, tuple(demand.tolist())), SteerCommand(angles=demand)

    def _required_direction(self, path: FloatArray, motion: HitchMotion) -> float | None:
        """Required direction of the follow point's travel [rad] when the axles have answered; None if unknown."""
        s = arc_length(path)
        passed = crossing(path, s, -self._trailer.follow_distance)
        if passed is None:
            return None
        speed = math.hypot(motion.v_x, motion.v_y - self._trailer.follow_distance * motion.yaw_rate)  # of the rear
        ahead = max(0.0, passed.s - speed * self._preview)
        heading = tangent(path, s, ahead, _REACH).direction - motion.yaw_rate * self._preview
        difference = math.atan2(passed.y, self._trailer.follow_distance)  # of heading to the reference trailer
        return heading + self._gain * difference
