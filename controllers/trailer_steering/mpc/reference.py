"""Reference heading of the trailer: the one that puts its follow point on the hitch's path, at every step.

A rigid trailer led at the hitch has one degree of freedom, its heading. With the hitch at h the follow point is on the
path if it is at the path's point P at the follow distance from h: the required heading is that of h - P, and near it
the off-tracking is the follow distance times the heading difference. The path behind the hitch is measured; only the
hitch's next second has to be predicted.

A lost estimate has no off-tracking, but it contains the path of the hitch since the odometry began. If the trailer was
nearly straight at that time, its follow point is assumed to have been on the path: the trailer's axis at that time
continues the path to the rear.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from controllers.trailer_steering.mpc.observer import Reckoned
from estimators.estimates import Health, OffTracking
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_PIECE: Final = 0.2  # longest chord of a path: 0.4 mm inside of a turn of 12 m radius [m]
_SAME: Final = 1e-6  # points closer together count as one: their distance is rounding [m]
_STRAIGHT: Final = 0.1  # articulation up to which the follow point is assumed on the path, 6 deg [rad]
_LEAST_SPEED: Final = 0.1  # of the first estimate of a path [m/s]


class HitchCourse(NamedTuple):
    """Predicted motion of the hitch over n steps, in the present trailer frame S."""

    speed: float  # [m/s]
    rate: float  # of the direction of travel [rad/s]
    directions: FloatArray  # (n,) of travel at the ends of the steps [rad]
    points: FloatArray  # (n, 2) positions at the ends of the steps [m]


class Reference(NamedTuple):
    """Reference at n steps."""

    headings: FloatArray  # (n,) with the follow point on the path, in S [rad]
    offsets: FloatArray  # (n,) of the path from the middle of hitch and follow point, + left [m]


def hitch_course(direction: float, rate: float, speed: float, step: float, n: int) -> HitchCourse:
    """Motion on a circle from a direction of travel [rad] in n steps of ``step`` [s]."""
    directions: FloatArray = direction + rate * step * np.arange(n + 1, dtype=np.float64)
    middles = 0.5 * (directions[1:] + directions[:-1])
    points = np.cumsum(speed * step * np.column_stack([np.cos(middles), np.sin(middles)]), axis=0)
    return HitchCourse(speed, rate, directions[1:], points)


def denser(path: FloatArray) -> FloatArray:
    """The path (n, 2) with points on a cubic spline between those that are more than ``_PIECE`` apart.

    Chords would lie 1 mm inside of a tight turn. Where estimates were missing, points are metres apart.
    """
    s = arc_length(path)
    apart = np.flatnonzero(np.diff(s, prepend=-1.0) > _SAME)
    path, s = path[apart], s[apart]
    if len(path) < 3:
        return path
    pieces = np.ceil(np.diff(s) / _PIECE).astype(np.intp)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    share = (np.arange(len(first)) - first) / np.repeat(pieces, pieces)
    stations = np.append(np.repeat(s[:-1], pieces) + share * np.repeat(np.diff(s), pieces), s[-1])
    points: FloatArray = CubicSpline(s, path)(stations)
    return points


def reference(ahead: FloatArray, behind: FloatArray, distance: float) -> Reference | None:
    """Reference for the hitch at ``ahead`` (n, 2), in the order of travel; None if the path is too short.

    ``behind`` (m, 2) is the path so far, newest first, in the same frame, and ``distance`` that of the follow point
    [m].
    """
    n, line = len(ahead), np.concatenate([ahead[::-1], behind])
    apart = line[None, :, :] - ahead[:, None, :]
    later = np.arange(len(line)) < (n - 1 - np.arange(n))[:, None]  # than the step
    away = np.where(later, 0.0, np.hypot(apart[..., 0], apart[..., 1]))
    beyond = np.argmax(away >= distance, axis=1)
    if not beyond.all():
        return None
    rows = np.arange(n)
    to_hitch = -_at_distance(apart[rows, beyond - 1], apart[rows, beyond], distance)
    c, s = to_hitch.T / distance
    x = apart[..., 0] * c[:, None] + apart[..., 1] * s[:, None]
    nearest = np.argmin(np.where(later, np.inf, np.abs(x + 0.5 * distance)), axis=1)
    middle = apart[rows, nearest]
    return Reference(np.arctan2(s, c), middle[:, 1] * c - middle[:, 0] * s)


def _at_distance(near: FloatArray, far: FloatArray, distance: float) -> FloatArray:
    """Points (n, 2) of the chords from ``near`` to ``far`` that lie at the distance [m] from the origin."""
    chord = far - near
    # |near + t chord| = distance, t the root between 0 and 1
    a, b, c = (np.sum(p * q, axis=1) for p, q in ((chord, chord), (near, chord), (near, near)))
    t = (np.sqrt(np.maximum(b**2 - a * (c - distance**2), 0.0)) - b) / a
    points: FloatArray = near + t[:, None] * chord
    return points


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
    if path is None or (not complete and len(points) < len(path.estimate.path)):
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
