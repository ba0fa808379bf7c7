"""Kinematics of a trailer led at its hitch: axle angles, prediction, and motion from the combination's own signals.

The lateral velocity of a rigid trailer is linear along its axis and the longitudinal one constant. So the tangent of
the direction of travel beta(x) at the distance x behind the hitch is linear in x:

    tan beta(x) = tan gamma_h (1 - x/Lf) + tan beta_f x/Lf

with the direction gamma_h of the hitch and beta_f of the follow point, Lf behind it. An axle steered by that angle
rolls without slip; all of them then share one instantaneous centre.

Where the axles slip, the moment of their side forces about the hitch, ``sum(x_i C (tan beta_i - tan delta_i))`` for
small slip, balances the moments of inertia and of the ground's slope. Divided by ``C sum(x_i)`` it is the *mean slip*:
a property of the load, not of the steering, so that it can be measured at one moment and used at the next.

Motion from signals: from the tractor's rear axle to the rear, every hitch adds its unit's yaw rate times its lever. The
rear axle rolls without slip unless its lateral speed is given. It slips in proportion to the lateral acceleration, and
by the scrub of all tyres. The front wheels, whose speed is measured, roll along the direction in which they point and
not in that in which they travel; the yaw rate gives the difference.

Dead reckoning: O is the trailer's frame S at the start. An estimate of the path replaces the reckoned path up to its
tick; the later part stays.
"""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.equations import settle
from controllers.trailer import Actuation, Combination, Linkage, TrailerGeometry
from estimators.estimates import OffTracking
from estimators.hitch_motion import HitchMotion, hitch_motions
from estimators.off_tracking.hitch_path import crossing, tangent
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray, Pose2, arc_length, limited_angle, wrap

_NEWTON_STEPS = 5  # from the solution for small angles: 1e-12 rad within the range of axles
_STEEPEST = 1.3  # limit of directions of travel, 74 deg: the tangent stays finite [rad]


@dataclass(frozen=True, slots=True, eq=False)
class AxleGroup:
    """Axles of a trailer, for the moment balance about the hitch."""

    steered: FloatArray  # (n_steered,) hitch to steered axles [m]
    fixed: FloatArray  # (n_fixed,) hitch to the others [m]
    centre: float  # mean distance of all axles [m]
    first_moment: float  # sum of all distances [m]
    second_moment: float  # sum of their squares [m2]
    follow_distance: float  # [m]
    max_steer: float  # of the actuators [rad]
    linkages: tuple[Linkage, ...]  # steered axles that share an actuator

    @classmethod
    def of(cls, trailer: TrailerGeometry) -> "AxleGroup":
        """The axle group of a trailer's data sheet."""
        every, steered = np.array(trailer.axle_distances), np.array(trailer.steered, dtype=bool)
        return cls(
            steered=every[steered],
            fixed=every[~steered],
            centre=float(every.mean()),
            first_moment=float(every.sum()),
            second_moment=float(every @ every),
            follow_distance=trailer.follow_distance,
            max_steer=trailer.max_steer,
            linkages=trailer.linkages,
        )

    def mean_slip(self, v_x: float, v_y: float, yaw_rate: float, angles: FloatArray) -> float:
        """Moment-weighted mean of tan(direction) - tan(steer angle) [-] for the hitch's velocity v_x, v_y [m/s]."""
        travel = self.first_moment * v_y / v_x - self.second_moment * yaw_rate / v_x
        return (travel - float(self.steered @ np.tan(angles))) / self.first_moment

    def yaw_per_metre(self, hitch_direction: float, steer_moment: float, mean_slip: float) -> float:
        """Yaw [rad] per metre of the hitch's path, for ``steer_moment = sum(x_i tan(delta_i))`` [m].

        Solves the moment balance for the yaw rate: the inverse of `mean_slip`. A prediction asks 60 times a step, so
        that usual directions are neither wrapped nor limited.
        """
        direction = hitch_direction
        if not -_STEEPEST <= direction <= _STEEPEST:
            direction = limited_direction(wrap(hitch_direction))
        lead = self.first_moment * (math.tan(direction) - mean_slip)
        return math.cos(hitch_direction) * (lead - steer_moment) / self.second_moment

    def steer_moment(self, angles: FloatArray) -> FloatArray:
        """``sum(x_i tan(delta_i))`` [m] of angles (..., n_steered) [rad]."""
        return np.tan(angles) @ self.steered

    def steer_angles(self, hitch_direction: float, follow_direction: float, mean_slip: float) -> FloatArray:
        """Angles (n_steered,) [rad], within the limit, for travel of the follow point along ``follow_direction`` [rad].

        The steered axles share the mean slip and the scrub of the fixed axles equally; the others take over what an
        axle at its limit lacks. Linked axles turn with their actuator.
        """
        lead, follow = math.tan(limited_direction(hitch_direction)), math.tan(limited_direction(follow_direction))
        slope = (follow - lead) / self.follow_distance
        scrub = float(self.fixed @ (lead + slope * self.fixed))
        tangents = lead + slope * self.steered
        missing = scrub - self.first_moment * mean_slip  # of the steer moment [m]
        return self.linked(np.arctan(self._shared(tangents, missing)))

    def slip_angles(self, mean_slip: float) -> FloatArray:
        """Equal angles (n_steered,) [rad] that compensate the mean slip."""
        missing = -self.first_moment * mean_slip
        return self.linked(np.arctan(self._shared(np.zeros(len(self.steered)), missing)))

    def with_moment(self, angles: FloatArray, missing: float, free: NDArray[np.bool_]) -> FloatArray:
        """Angles (n_steered,) [rad] with the ``missing`` steer moment [m] shared equally by the ``free`` axles."""
        if not free.any():
            return angles
        return np.where(free, self.linked(np.arctan(self._shared(np.tan(angles), missing, free))), angles)

    def linked(self, angles: FloatArray) -> FloatArray:
        """Angles (n_steered,) [rad] that the linkages allow, each linkage with the steer moment of the given angles."""
        if not self.linkages:
            return angles
        turned = angles.copy()
        for linkage in self.linkages:
            axles, ratios = list(linkage.axles), np.array(linkage.ratios)
            turned[axles] = ratios * self._actuator_angle(self.steered[axles], ratios, angles[axles])
        return turned

    def _actuator_angle(self, distances: FloatArray, ratios: FloatArray, angles: FloatArray) -> float:
        """Angle of an actuator [rad], within its limit, at which its axles have the moment of the given angles."""
        moment = float(distances @ np.tan(angles))
        angle = moment / float(distances @ ratios)
        for _ in range(_NEWTON_STEPS):
            tangents = np.tan(ratios * limited_direction(angle))
            slope = float((distances * ratios) @ (1.0 + tangents**2))
            angle = limited_direction(angle) - (float(distances @ tangents) - moment) / slope
        return limited_angle(angle, self.max_steer)

    def _shared(self, tangents: FloatArray, missing: float, free: NDArray[np.bool_] | None = None) -> FloatArray:
        """Tangents with the missing moment [m] shared equally by the free axles, by default all, below the limit."""
        limit = math.tan(self.max_steer)
        free = np.ones(len(tangents), dtype=bool) if free is None else free
        for _ in tangents:
            tangents = np.where(free, tangents + missing / float(self.steered[free].sum()), tangents)
            clipped = np.clip(tangents, -limit, limit)
            missing = float(self.steered @ (tangents - clipped))
            tangents, free = clipped, free & (np.abs(tangents) < limit)
            if missing == 0.0 or not free.any():
                break
        return tangents


def limited_direction(direction: float) -> float:
    """The direction [rad], limited to where its tangent is useful."""
    return limited_angle(direction, _STEEPEST)


def check_steered(law: str, trailer: TrailerGeometry) -> None:
    """Refuse a trailer without steered axles.

    Raises:
        ValueError: if none of its axles is steered.
    """
    if not trailer.steered_distances:
        raise ValueError(f"{law}: the trailer has no steered axle: choose trailer_steering=none")


def check_towed(law: str, combination: Combination) -> None:
    """Refuse a vehicle that tows nothing.

    Raises:
        ValueError: if its own axles would have to be steered.
    """
    if combination.unit == 0:
        raise ValueError(f"{law}: models a trailer behind a hitch, and {combination.vehicle.name} tows nothing")


def reachable(trailer: TrailerGeometry, last: FloatArray, wanted: FloatArray, elapsed: float) -> FloatArray:
    """The wanted angles (n_steered,) [rad], limited to those within reach of the last ones in ``elapsed`` [s]."""
    turn, angles = trailer.max_steer_rate * elapsed, []
    for angle, goal, scale in zip(last.tolist(), wanted.tolist(), trailer.scales, strict=True):
        near = min(max(goal, angle - turn * scale), angle + turn * scale)
        angles.append(limited_angle(near, trailer.max_steer * scale))
    return np.array(angles)


MEASURABLE: Final = 0.5  # below this speed the odometry's noise of some mm per frame hides the slip [m/s]

_STEP = 0.02  # of the integration [s]; a turn of 1 deg per step, accurate to 1e-5 with the midpoint rule
_TICK: Final = attrgetter("tick")


class SteerReading(NamedTuple):
    """One past reading of the steer encoders."""

    tick: int
    angles: tuple[float, ...]  # [rad]


SteerHistory = tuple[SteerReading, ...]  # oldest first


def recorded(history: SteerHistory, signals: CombinationSignals, span: int) -> SteerHistory:
    """The history of the last ``span`` ticks with a new reading."""
    if history and signals.tick <= history[-1].tick:
        return history
    kept = history[bisect_left(history, signals.tick - span, key=_TICK) :]
    return (*kept, SteerReading(signals.tick, tuple(signals.angles.tolist())))


def angles_at(history: SteerHistory, ticks: FloatArray) -> FloatArray:
    """Angles (n, n_steered) [rad] read at past ticks (n,), interpolated."""
    first = max(0, bisect_right(history, float(ticks.min()), key=_TICK) - 1)
    history = history[first : bisect_left(history, float(ticks.max()), key=_TICK) + 1] or history[-1:]
    read_at, read = zip(*history, strict=True)
    angles = np.empty((len(ticks), len(read[0])))
    for k, axle in enumerate(zip(*read, strict=True)):
        angles[:, k] = np.interp(ticks, read_at, axle)
    return angles


def slip_between(before: OffTracking, estimate: OffTracking, axles: AxleGroup, history: SteerHistory) -> float:
    """Mean slip of the axles [-] between two estimates."""
    # The velocities are means over the last frame interval; the angles at its middle belong to them.
    angles = angles_at(history, np.array([0.5 * (before.tick + estimate.tick)]))[0]
    return axles.mean_slip(max(estimate.v_x, MEASURABLE), estimate.v_y, estimate.yaw_rate, angles)


_STIRRED: Final = math.radians(1.0)  # distance from the demand, ten times the encoders' noise [rad]
_AT_RATE: Final = 0.9  # of the rate limit: what moves faster may be held by it
_EXPECTED: Final = 2e-5  # weight of the data sheet: of two axles 2 deg from their demands for 0.4 s [rad2 s2]
_REMEMBERED: Final = 1e-3  # most that is remembered, 20 s of that; older answers are forgotten [rad2 s2]
_KNOWN: Final = 0.3  # share by which the data sheet may be wrong before the measured lag takes its place
_LARGEST_LAG: Final = 1.0  # [s]


class Answers(NamedTuple):
    """How fast the actuators have answered so far: least squares of their rate over the distance from the demand."""

    stirred: float = 0.0  # sum of squared distances times periods [rad2 s2]
    moved: float = 0.0  # sum of movements times distances times periods [rad2 s]

    def with_reading(self, trailer: TrailerGeometry, history: SteerHistory, actuation: Actuation | None) -> "Answers":
        """With the movement between the last two readings, towards the goal of that time."""
        if actuation is None or len(history) < 2:
            return self
        before, now = history[-2:]
        elapsed = (now.tick - before.tick) * TICK
        stirred, moved = self
        for goal, able, was, angle in zip(actuation.goal, actuation.able, before.angles, now.angles, strict=True):
            distance, movement = goal - was, angle - was
            if able and abs(distance) > _STIRRED and abs(movement) < _AT_RATE * trailer.max_steer_rate * elapsed:
                stirred += (distance * elapsed) ** 2
                moved += movement * distance * elapsed
        kept = min(1.0, _REMEMBERED / stirred) if stirred > 0.0 else 1.0
        return Answers(kept * stirred, kept * moved)

    def lag(self, trailer: TrailerGeometry) -> float:
        """Lag of the actuators [s]: that of the data sheet, unless they clearly have another one."""
        known = trailer.actuator_lag
        if known <= 0.0 or self.stirred == 0.0:
            return known
        measured = (self.stirred + _EXPECTED) / max(self.moved + _EXPECTED / known, 1e-9)
        return known if abs(measured - known) < _KNOWN * known else min(measured, _LARGEST_LAG)


class Ahead(NamedTuple):
    """The trailer at a later time, in its frame S at an estimate's tick."""

    frame: Pose2  # S at the later time
    hitch_direction: float  # direction of the hitch's travel in that frame [rad]


class Predictor:
    """Predicts a trailer from an estimate's tick to a later one.

    The hitch moves on a circle at constant speed, as nothing else is known of the tractor. The trailer turns by its own
    axles, with the angles read and then those on their way to the demand.
    """

    def __init__(self, trailer: TrailerGeometry, axles: AxleGroup) -> None:
        self._trailer, self._axles = trailer, axles

    def ahead(
        self,
        estimate: OffTracking,
        mean_slip: float,
        history: SteerHistory,
        demand: FloatArray,
        until: int,
        lag: float,
    ) -> Ahead:
        """The trailer at the tick ``until``, with its steering on the way to ``demand`` (n_steered,) [rad].

        ``lag`` is that of the actuators [s].
        """
        speed = math.hypot(estimate.v_x, estimate.v_y)
        course_rate = estimate.hitch_direction_rate + estimate.yaw_rate
        steps = max(1, math.ceil((until - estimate.tick) * TICK / _STEP))
        dt = (until - estimate.tick) * TICK / steps
        middles: FloatArray = estimate.tick + (np.arange(steps, dtype=np.float64) + 0.5) * (dt / TICK)
        moments = self._axles.steer_moment(self._angles(history, demand, middles, lag)).tolist()
        yaw_per_metre, first, advance = self._axles.yaw_per_metre, estimate.hitch_direction, dt * speed
        half_advance = 0.5 * dt * speed
        x = y = psi = 0.0
        for k, moment in enumerate(moments):
            course = first + course_rate * (k + 0.5) * dt
            half = half_advance * yaw_per_metre(course - psi, moment, mean_slip)
            psi += advance * yaw_per_metre(course - psi - half, moment, mean_slip)
            x += advance * math.cos(course)
            y += advance * math.sin(course)
        return Ahead(Pose2(x, y, psi), limited_direction(wrap(first + course_rate * steps * dt - psi)))

    def _angles(self, history: SteerHistory, demand: FloatArray, ticks: FloatArray, lag: float) -> FloatArray:
        """Steer angles (n, n_steered) [rad] at past and future ticks."""
        newest = history[-1]
        coming = int(ticks.searchsorted(newest.tick, side="right"))
        angles = angles_at(history, ticks)
        waits = (ticks[coming:, None] - newest.tick) * TICK
        angles[coming:] = settle(newest.angles, demand, waits, lag=lag, max_rate=self._trailer.max_steer_rate)
        return angles


_REACH = 0.75  # half window of the fit to the path at the follow point [m]


class Target(NamedTuple):
    """The path at the follow point, in the trailer's frame."""

    offset: float  # + when it lies left [m]
    direction: float  # + left [rad]
    curvature: float  # + left [1/m]


def target_on(path: FloatArray, s: FloatArray, follow_distance: float) -> Target | None:
    """The point of a path (n, 2), newest first, at the follow point; None if it does not reach back that far.

    ``s`` is its `arc_length` (n,) [m].
    """
    passed = crossing(path, s, -follow_distance)
    if passed is None:
        return None
    tangent_there = tangent(path, s, passed.s, _REACH)
    return Target(passed.y, limited_direction(tangent_there.direction), tangent_there.curvature)


def hitch_motion(
    combination: Combination, signals: CombinationSignals, lateral_speed: float = 0.0, speed: float | None = None
) -> HitchMotion:
    """Motion of the steered trailer; ``lateral_speed`` is that of the tractor's rear axle [m/s].

    Its ``speed`` [m/s] is by default that of the signals. A vehicle that tows nothing is led by its foremost axle,
    whose wheels roll without slip where they are steered to.
    """
    v_x = signals.speed if speed is None else speed
    v_y = lateral_speed + (v_x * math.tan(signals.steer) if combination.unit == 0 else 0.0)
    levers = combination.vehicle.hitch_levers(combination.unit)
    return hitch_motions(v_x, v_y, levers, signals.yaw_rates.tolist(), signals.articulation.tolist())[-1]


_SPACING = 0.1  # of the path's points: the chord of a 10 m circle is off by 0.1 mm [m]
_RECENT = 1500  # age of the oldest pose kept, and so of the oldest estimate that can be used [ticks]
_KEPT = 2.0  # length of the path in follow distances; a half circle to the follow point has pi / 2


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


def extended(path: ReckonedPath, tick: int, motion: HitchMotion, elapsed: float) -> ReckonedPath:
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
    points = np.concatenate([((now.x, now.y),), path.points])
    count = 1 + int(arc_length(points).searchsorted(path.reach))
    return path._replace(ticks=np.concatenate([(float(tick),), path.ticks])[:count], points=points[:count])


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
    """Motion of a tractor's rear axle and of the steered trailer's hitch, with slip."""

    def __init__(self, combination: Combination) -> None:
        """For the signals of the combination's steered trailer."""
        self._combination = combination
        self._is_towing = combination.unit > 0  # else the signals are of the leading point itself
        self._front_x = combination.vehicle.units[0].steered_axles[0].x
        self._scrub = TyreScrub(combination.vehicle, combination.unit)

    def slip(self, signals: CombinationSignals) -> float:
        """Slip angle of the rear axle [rad], + when it moves to the left of its own direction of travel."""
        if not self._is_towing:
            return 0.0
        acceleration = signals.speed * float(signals.yaw_rates[0])
        return _REAR * acceleration + _SCRUB * self._scrub.slip(signals)

    def speed(self, signals: CombinationSignals, slip: float) -> float:
        """Speed of the rear axle [m/s] with its slip angle [rad].

        ``signals.speed`` is the rolling speed of the front wheels times the cosine of their angle.
        """
        if not self._is_towing:
            return signals.speed
        c, s = math.cos(signals.steer), math.sin(signals.steer)
        return (signals.speed - self._front_x * float(signals.yaw_rates[0]) * s * c) / (c * c + slip * s * c)

    def of_hitch(self, signals: CombinationSignals, more_slip: float = 0.0) -> HitchMotion:
        """Motion of the trailer, with ``more_slip`` [rad] of the rear axle than by the data sheet."""
        slip = more_slip + self.slip(signals)
        speed = self.speed(signals, slip)
        return hitch_motion(self._combination, signals, speed * slip, speed)
