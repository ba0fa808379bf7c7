"""The hitch's way so far, as far back as the follow point: measured, and while it is shorter than the trailer, assumed.

An estimate without health has no off-tracking, but the path of the hitch since the odometry began is in it. A trailer
that stood nearly straight behind its hitch then had its follow point on the way there, as far as anyone can tell: the
trailer's axis of that moment is taken for the path before.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from controllers.trailer_steering.mpc.observer import Reckoned
from controllers.trailer_steering.mpc.reference import denser
from estimators.estimates import Health, OffTracking
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_STRAIGHT: Final = 0.1  # articulation up to which a trailer is taken to have followed its hitch, 6 deg [rad]
_LEAST_SPEED: Final = 0.1  # of an estimate that can begin a way [m/s]


class Way(NamedTuple):
    """What an estimate tells of the hitch's way, in the trailer's frame S at its tick."""

    seen: OffTracking
    interval: float  # since the estimate before [s]
    path: FloatArray  # (n, 2) newest first [m]
    whole: bool  # whether it reaches back to the follow point
    axis: float  # direction of the trailer's axis where the path begins, if that is assumed to go on [rad]
    straight: bool  # whether the trailer was straight there


def with_estimate(way: Way | None, seen: OffTracking | None, follow_distance: float) -> Way | None:
    """The way by a new estimate; the one before where there is none, or none to be used."""
    if seen is None or (way is not None and seen.tick <= way.seen.tick):
        return way
    whole = bool((seen.path[:, 0] <= -follow_distance).any())
    if len(seen.path) < 2 or (whole and seen.health is Health.LOST):
        return way
    speed = math.hypot(seen.v_x, seen.v_y)
    if way is None or (not whole and len(seen.path) < len(way.path) // 2 + 1):  # that one is twice as dense
        if speed < _LEAST_SPEED:
            return way
        interval = float(np.hypot(*seen.path[-1])) / speed
        axis, straight = -seen.yaw_rate * interval, abs(seen.hitch_direction) < _STRAIGHT
    else:
        interval = (seen.tick - way.seen.tick) * TICK
        axis, straight = way.axis - seen.yaw_rate * interval, way.straight
    return Way(seen, interval, denser(seen.path), whole, axis, straight)


def way_so_far(way: Way, moved: Reckoned, follow_distance: float) -> FloatArray | None:
    """The way (n, 2) in the trailer's frame S of now, newest first, after it has moved on; None if it is too short."""
    points = np.concatenate([moved.hitch_way, way.path])
    if not way.whole:
        if not way.straight:
            return None
        back = np.array([math.cos(way.axis), math.sin(way.axis)])
        points = np.concatenate([points, points[-1] - np.outer([0.5, 2.0], follow_distance * back)])
    return moved.frame.inverse().apply(points)
