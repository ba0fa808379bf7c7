"""Motion of hitch and tractor axle from the combination's own sensors, and the hitch's path from it.

O is the trailer's frame S at the start. An estimate of the path replaces the reckoned path up to its tick; the later
part stays.

From the tractor's rear axle to the rear, every hitch adds its unit's yaw rate times its lever. The rear axle rolls
without slip unless its lateral speed is given.

The rear axle slips in proportion to the lateral acceleration, and by the scrub of all tyres. The front wheels, whose
speed is measured, roll along the direction in which they point and not in that in which they travel; the yaw rate tells
the two apart.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from itertools import pairwise
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np

from controllers.trailer import Combination
from estimators.estimates import OffTracking
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray, Pose2, wrap


class HitchMotion(NamedTuple):
    """Motion of a trailer at its hitch, along its own axes."""

    v_x: float  # [m/s]
    v_y: float  # + left [m/s]
    yaw_rate: float  # [rad/s]

    @property
    def direction(self) -> float:
        """Direction of the line along which the hitch travels, either way, against the trailer's axis, + left [rad]."""
        return math.atan2(math.copysign(1.0, self.v_x) * self.v_y, abs(self.v_x))


def hitch_motion(combination: Combination, signals: CombinationSignals, lateral_speed: float = 0.0) -> HitchMotion:
    """Motion of the steered trailer; ``lateral_speed`` is that of the tractor's rear axle [m/s]."""
    v_x, v_y = signals.speed, lateral_speed
    towing = combination.vehicle.units[: combination.unit]
    for unit, angle, yaw_rate in zip(towing, signals.articulation.tolist(), signals.yaw_rates.tolist(), strict=False):
        v_y += yaw_rate * unit.rear_hitch[0]
        c, s = math.cos(angle), math.sin(angle)
        v_x, v_y = c * v_x - s * v_y, s * v_x + c * v_y
    return HitchMotion(v_x, v_y, float(signals.yaw_rates[combination.unit]))


_SPACING = 0.1  # of the path's points: the chord of a 10 m circle is off by 0.1 mm [m]
_RECENT = 1500  # age of the oldest pose kept, and so of the oldest estimate that can be used [ticks]
_KEPT = 2.0  # length of the path in follow distances; a half circle to the follow point has pi / 2
_TICK: Final = attrgetter("tick")


class Moment(NamedTuple):
    """Pose of S at a tick."""

    tick: int
    X_OS: Pose2


class ReckonedPath(NamedTuple):
    """Pose of the trailer and path of its hitch."""

    reach: float  # length of the path that is kept [m]
    X_OS: Pose2
    recent: tuple[Moment, ...]  # oldest first
    ticks: FloatArray  # (n,) of the points, newest first; -inf before the first step
    points: FloatArray  # (n, 2) of the hitch's path in O, newest first [m]

    def in_trailer(self) -> FloatArray:
        """The path (n + 1, 2) in the present S, newest first, beginning at the hitch itself [m]."""
        points: FloatArray = self.X_OS.inverse().apply(self.points)
        return np.concatenate([np.zeros((1, 2)), points])


def straight_behind(follow_distance: float) -> ReckonedPath:
    """Initial path: straight along the trailer's axis."""
    reach = _KEPT * follow_distance
    x = -np.arange(_SPACING, reach, _SPACING)
    points = np.column_stack([x, np.zeros(len(x))])
    return ReckonedPath(reach, Pose2(0.0, 0.0, 0.0), (), np.full(len(x), -np.inf), points)


def moved(path: ReckonedPath, tick: int, motion: HitchMotion, elapsed: float) -> ReckonedPath:
    """The path after ``elapsed`` [s] of this motion up to ``tick``."""
    here, turn = path.X_OS, motion.yaw_rate * elapsed
    middle = here.psi + 0.5 * turn
    c, s = math.cos(middle), math.sin(middle)
    dx, dy = elapsed * motion.v_x, elapsed * motion.v_y
    now = Pose2(here.x + c * dx - s * dy, here.y + s * dx + c * dy, wrap(here.psi + turn))
    recent = (*path.recent[bisect_left(path.recent, tick - _RECENT, key=_TICK) :], Moment(tick, now))
    path = path._replace(X_OS=now, recent=recent)
    if math.hypot(now.x - path.points[0, 0], now.y - path.points[0, 1]) < _SPACING:
        return path
    points = np.concatenate([[[now.x, now.y]], path.points])
    count = 2 + int(np.searchsorted(np.cumsum(np.hypot(*np.diff(points, axis=0).T)), path.reach))
    return path._replace(ticks=np.concatenate([[float(tick)], path.ticks])[:count], points=points[:count])


def corrected(path: ReckonedPath, estimate: OffTracking) -> ReckonedPath:
    """The path with its part up to an estimate's tick replaced; unchanged if the estimate is older than the poses."""
    then = _pose_at(path.recent, estimate.tick)
    if then is None:
        return path
    newer = path.ticks > estimate.tick
    older = then.apply(estimate.path)
    count = len(older)
    ticks = np.concatenate([path.ticks[newer], np.full(count, float(estimate.tick))])
    return path._replace(ticks=ticks, points=np.concatenate([path.points[newer], older]))


def motion_between(path: ReckonedPath, since: int, until: int) -> HitchMotion | None:
    """Mean motion between two past ticks, along the axes of S halfway; None outside the range of poses."""
    before, after = _pose_at(path.recent, since), _pose_at(path.recent, until)
    if before is None or after is None or until <= since:
        return None
    elapsed = (until - since) * TICK
    turn = wrap(after.psi - before.psi)
    c, s = math.cos(before.psi + 0.5 * turn), math.sin(before.psi + 0.5 * turn)
    dx, dy = (after.x - before.x) / elapsed, (after.y - before.y) / elapsed
    return HitchMotion(c * dx + s * dy, c * dy - s * dx, turn / elapsed)


def _pose_at(recent: tuple[Moment, ...], tick: int) -> Pose2 | None:
    """S at a past tick, interpolated between poses; None outside their range."""
    for before, after in pairwise(recent):
        if before.tick <= tick <= after.tick:
            share = (tick - before.tick) / (after.tick - before.tick)
            a, b = before.X_OS, after.X_OS
            turn = share * wrap(b.psi - a.psi)
            return Pose2(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), wrap(a.psi + turn))
    return None


# As in ``estimators.off_tracking.dead_reckoning``, where their spread is stated.
_REAR = -0.02  # slip of driven truck tyres per lateral acceleration: 1/(5 g) [rad s2/m]
_SCRUB = 0.9  # 1 if tyres are linear, 0.7 on friction of 0.3 [-]


class TractorMotion:
    """Velocity of a tractor's rear axle."""

    def __init__(self, combination: Combination) -> None:
        """For the signals of the combination's steered trailer."""
        self._front_x = combination.vehicle.units[0].steered_axles[0].x
        self._scrub = TyreScrub(combination.vehicle, combination.unit)

    def slip(self, signals: CombinationSignals) -> float:
        """Slip angle of the rear axle [rad], + when it moves to the left of its own direction of travel."""
        acceleration = signals.speed * float(signals.yaw_rates[0])
        return _REAR * acceleration + _SCRUB * self._scrub.slip(signals)

    def speed(self, signals: CombinationSignals, slip: float) -> float:
        """Speed of the rear axle [m/s] with its slip angle [rad].

        ``signals.speed`` is the rolling speed of the front wheels times the cosine of their angle.
        """
        c, s = math.cos(signals.steer), math.sin(signals.steer)
        return (signals.speed - self._front_x * float(signals.yaw_rates[0]) * s * c) / (c * c + slip * s * c)
