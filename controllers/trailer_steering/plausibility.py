"""Whether an off-tracking estimate can be believed: its health and age, its motion, and what it said just before.

The combination's own wheel speeds and gyros tell how fast the trailer really goes, so that a frozen camera shows: its
trailer stands still. What the estimate's way falls short of the wheels' way is missing in the hitch path, too, until
the follow point has passed it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from controllers.trailer_steering.hitch_motion import HitchMotion
from estimators.estimates import Health, OffTracking
from vehicle.clock import TICK

# assumed: several times what wheel speeds, gyros and odometry err by, and what a braking or turning trailer changes in
# the 0.3 s that an estimate is late.
_SPEED: Final = 0.3  # [m/s]
_SPEED_SHARE: Final = 0.15  # [-]
_YAW_RATE: Final = 0.1  # [rad/s]
_MISSING: Final = 0.1  # of the follow distance: in a tight turn the path then errs by some 0.1 rad times that way [-]
_SIGMAS: Final = 3.0  # of an estimate's own uncertainty are no jump


class Limits(NamedTuple):
    """Beyond which an estimate is not believed."""

    age: float  # when it arrives [s]
    std: float  # of one that is degraded [m]
    jump: float  # beside where the trailer's motion takes it [m]


class Way(NamedTuple):
    """The newest estimate that arrived, and how much its way has fallen short of the wheels' [m]."""

    newest: OffTracking | None = None
    missing: float = 0.0


def moved_on(way: Way, seen: OffTracking, motion: HitchMotion, follow_distance: float) -> Way:
    """The way with a new estimate; what was missing is forgotten over a follow distance."""
    if way.newest is None:
        return Way(seen)
    interval = (seen.tick - way.newest.tick) * TICK
    rolled = abs(motion.v_x) * interval
    kept = way.missing * math.exp(-rolled / follow_distance)
    # A lost motion is bridged at the velocity before: the way is as good as that.
    return Way(seen, kept + (motion.v_x - seen.v_x) * interval)


def usable(seen: OffTracking, tick: int, limits: Limits) -> bool:
    """Whether it is healthy enough, and not too old."""
    vague = seen.health is Health.LOST or (seen.health is Health.DEGRADED and seen.std > limits.std)
    return not vague and math.isfinite(seen.value) and seen.age(tick) <= limits.age


def moves_as_told(seen: OffTracking, way: Way, motion: HitchMotion, follow_distance: float) -> bool:
    """Whether the trailer moves in the estimate as its wheels and gyro say it does."""
    slower = abs(motion.v_x - seen.v_x) > _SPEED + _SPEED_SHARE * abs(motion.v_x)
    turns = abs(motion.yaw_rate - seen.yaw_rate) > _YAW_RATE
    return not (slower or turns or abs(way.missing) > _MISSING * follow_distance)


def jumps(before: OffTracking, seen: OffTracking, follow_distance: float, limits: Limits) -> bool:
    """Whether it lies beside what the one before and the trailer's motion since make of it.

    The path stands still while the follow point is carried along: in the trailer's frame a point of it at (-L_f, e)
    moves sideways by -v_y + r L_f, and the path there slides past at v_x - r e, inclined by its tangent.
    """
    interval = (seen.tick - before.tick) * TICK
    tangent = math.tan(0.5 * (before.path_tangent + seen.path_tangent))
    rate = seen.yaw_rate * follow_distance - seen.v_y + tangent * (seen.v_x - seen.yaw_rate * seen.value)
    deviation = seen.value - before.value - rate * interval
    return abs(deviation) > limits.jump + _SIGMAS * seen.std
