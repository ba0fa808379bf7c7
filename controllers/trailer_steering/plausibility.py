"""Plausibility checks of off-tracking estimates: health, age, motion, and continuity with the previous estimate.

Wheel speeds and gyros of the combination show how fast the trailer really moves. A frozen camera is detected by them:
in its estimate the trailer stands still. Distance that the estimate lacks against the wheels is also missing in the
hitch path, until the follow point has passed that place.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from controllers.trailer_steering.hitch_motion import HitchMotion
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.parity import MotionReference
from vehicle.clock import TICK

# assumed: several times the errors of wheel speeds, gyros and odometry, and the change of motion of a braking or
# turning trailer within the 0.3 s by which an estimate is late.
_SPEED: Final = 0.3  # [m/s]
_SPEED_SHARE: Final = 0.15  # [-]
_YAW_RATE: Final = 0.1  # [rad/s]
_MISSING: Final = 0.1  # of the follow distance: a path error of about 0.1 rad times that in a tight turn [-]
_INTERVAL: Final = 100  # between estimates, if it is not known [ticks]
_LONGEST_INTERVAL: Final = 300  # over which the motion in an estimate is a mean [ticks]
_SIGMAS: Final = 3.0  # of an estimate's own standard deviation: no jump


class Limits(NamedTuple):
    """Largest accepted values of an estimate."""

    age: float  # on arrival [s]
    std: float  # of a degraded estimate [m]
    jump: float  # deviation from the value predicted by the trailer's motion [m]


class Travel(NamedTuple):
    """Distance travelled according to estimates and wheels."""

    newest: OffTracking | None = None  # estimate that arrived last
    missing: float = 0.0  # distance of the estimates less than that of the wheels [m]


def moved_on(travel: Travel, estimate: OffTracking, motion: HitchMotion, follow_distance: float) -> Travel:
    """Travel with a new estimate; missing distance decays over a follow distance."""
    if travel.newest is None:
        return Travel(estimate)
    interval = (estimate.tick - travel.newest.tick) * TICK
    rolled = abs(motion.v_x) * interval
    kept = travel.missing * math.exp(-rolled / follow_distance)
    # A lost motion is bridged at the velocity before it.
    return Travel(estimate, kept + (motion.v_x - estimate.v_x) * interval)


def motion_reference(estimate: OffTracking, before: OffTracking | None) -> MotionReference | None:
    """The motion in an estimate, to compare signals with; None if it is lost, or taken from the signals themselves.

    Its velocities are means since the estimate ``before``. While the path is still short the estimate is lost, but its
    motion is not: the path grows.
    """
    values = (estimate.v_x, estimate.v_y, estimate.yaw_rate)
    grows = before is not None and len(estimate.path) > len(before.path)
    if (estimate.health is Health.LOST and not grows) or estimate.bridged > 0.0 or not all(map(math.isfinite, values)):
        return None
    previous = estimate.tick - _INTERVAL if before is None else max(before.tick, estimate.tick - _LONGEST_INTERVAL)
    return MotionReference(estimate.tick, previous, *values)


def usable(estimate: OffTracking, tick: int, limits: Limits) -> bool:
    """True if the estimate is healthy enough and not too old."""
    vague = estimate.health is Health.DEGRADED and estimate.std > limits.std
    lost = estimate.health is Health.LOST or not math.isfinite(estimate.value)
    return not (vague or lost) and estimate.age(tick) <= limits.age


def motion_agrees(estimate: OffTracking, travel: Travel, motion: HitchMotion, follow_distance: float) -> bool:
    """True if the motion of the trailer in the estimate agrees with its wheels and gyro."""
    slower = abs(motion.v_x - estimate.v_x) > _SPEED + _SPEED_SHARE * abs(motion.v_x)
    turns = abs(motion.yaw_rate - estimate.yaw_rate) > _YAW_RATE
    return not (slower or turns or abs(travel.missing) > _MISSING * follow_distance)


def jumps(before: OffTracking, estimate: OffTracking, follow_distance: float, limits: Limits) -> bool:
    """True if the estimate deviates from the previous one, carried on by the trailer's motion.

    The path stands still while the follow point moves: in the trailer's frame a point of the path at (-L_f, e) has the
    lateral speed -v_y + r L_f, and the path, inclined by its tangent, passes at v_x - r e.
    """
    interval = (estimate.tick - before.tick) * TICK
    tangent = math.tan(0.5 * (before.path_tangent + estimate.path_tangent))
    rate = estimate.yaw_rate * follow_distance - estimate.v_y
    rate += tangent * (estimate.v_x - estimate.yaw_rate * estimate.value)
    deviation = estimate.value - before.value - rate * interval
    return abs(deviation) > limits.jump + _SIGMAS * estimate.std
