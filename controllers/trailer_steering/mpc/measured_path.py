"""Path of the hitch back to the follow point: measured, and partly assumed while it is shorter than the trailer.

A lost estimate has no off-tracking, but it contains the path of the hitch since the odometry began. If the trailer was
nearly straight at that time, its follow point is assumed to have been on the path: the trailer's axis at that time
continues the path to the rear.
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

_STRAIGHT: Final = 0.1  # articulation up to which the follow point is assumed on the path, 6 deg [rad]
_LEAST_SPEED: Final = 0.1  # of the first estimate of a path [m/s]


class MeasuredPath(NamedTuple):
    """Path of the hitch in an estimate, in the trailer's frame S at its tick."""

    estimate: OffTracking
    interval: float  # since the estimate before [s]
    points: FloatArray  # (n, 2) newest first [m]
    complete: bool  # True if it reaches back to the follow point
    axis: float  # direction of the trailer's axis at the oldest point [rad]
    straight: bool  # True if the trailer was straight there


def with_estimate(
    path: MeasuredPath | None, estimate: OffTracking | None, follow_distance: float
) -> MeasuredPath | None:
    """The path of a new usable estimate, or the one before."""
    if estimate is None or (path is not None and estimate.tick <= path.estimate.tick):
        return path
    points = estimate.path
    complete = bool((points[:, 0] <= -follow_distance).any())
    if len(points) < 2 or (complete and estimate.health is Health.LOST):
        return path
    speed = math.hypot(estimate.v_x, estimate.v_y)
    if path is None or (not complete and len(points) < len(path.points) // 2 + 1):  # that one is twice as dense
        if speed < _LEAST_SPEED:
            return path
        interval = float(np.hypot(*points[-1])) / speed
        axis, straight = -estimate.yaw_rate * interval, abs(estimate.hitch_direction) < _STRAIGHT
    else:
        interval = (estimate.tick - path.estimate.tick) * TICK
        axis, straight = path.axis - estimate.yaw_rate * interval, path.straight
    return MeasuredPath(estimate, interval, denser(points), complete, axis, straight)


def path_now(path: MeasuredPath, moved: Reckoned, follow_distance: float) -> FloatArray | None:
    """Points (n, 2) in the present trailer frame S, newest first, with the motion since; None if they are too few."""
    points = np.concatenate([moved.hitch_path, path.points])
    if not path.complete:
        if not path.straight:
            return None
        back = np.array([math.cos(path.axis), math.sin(path.axis)])
        points = np.concatenate([points, points[-1] - np.outer([0.5, 2.0], follow_distance * back)])
    return moved.frame.inverse().apply(points)
