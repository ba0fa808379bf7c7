"""Kinematics of a trailer led at its hitch, and its prediction to the time when its steering has answered.

The lateral velocity of a rigid trailer is linear along its axis and the longitudinal one constant. So the tangent of
the direction of travel beta(x) at the distance x behind the hitch is linear in x:

    tan beta(x) = tan gamma_h (1 - x/Lf) + tan beta_f x/Lf

with the direction gamma_h of the hitch and beta_f of the follow point, Lf behind it. An axle steered by that angle
rolls without slip; all of them then share one instantaneous centre.

Where the axles slip, the moment of their side forces about the hitch, ``sum(x_i C (tan beta_i - tan delta_i))`` for
small slip, balances the moments of inertia and of the ground's slope. Divided by ``C sum(x_i)`` it is the *mean slip*:
a property of the load, not of the steering, so that it can be measured at one moment and used at the next.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.equations import settle
from controllers.trailer import Linkage, TrailerGeometry
from estimators.estimates import OffTracking
from estimators.off_tracking.hitch_path import crossing, tangent
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.foundation.polyline import arc_length
from vehicle.frames import FloatArray, Pose2, limited_angle, wrap

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
    def of(cls, trailer: TrailerGeometry) -> AxleGroup:
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

        Solves the moment balance for the yaw rate: the inverse of `mean_slip`.
        """
        lead = self.first_moment * (math.tan(limited_direction(hitch_direction)) - mean_slip)
        return math.cos(hitch_direction) * (lead - steer_moment) / self.second_moment

    def steer_moment(self, angles: FloatArray) -> FloatArray:
        """``sum(x_i tan(delta_i))`` [m] of angles (..., n_steered) [rad]."""
        moment: FloatArray = np.tan(angles) @ self.steered
        return moment

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
        raise ValueError(f"{law}: the trailer has no steered axle")


def reachable(trailer: TrailerGeometry, last: FloatArray, wanted: FloatArray, elapsed: float) -> FloatArray:
    """The wanted angles (n_steered,) [rad], limited to those within reach of the last ones in ``elapsed`` [s]."""
    ratios = np.abs(trailer.steer_ratios)  # the limits are those of the actuators
    reach, limit = trailer.max_steer_rate * elapsed * ratios, trailer.max_steer * ratios
    return np.clip(np.clip(wanted, last - reach, last + reach), -limit, limit)


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
    read_at = np.array([reading.tick for reading in history], dtype=np.float64)
    read = np.array([reading.angles for reading in history])
    return np.stack([np.interp(ticks, read_at, axle) for axle in read.T], axis=1)


def slip_between(before: OffTracking, estimate: OffTracking, axles: AxleGroup, history: SteerHistory) -> float:
    """Mean slip of the axles [-] between two estimates."""
    # The velocities are means over the last frame interval; the angles at its middle belong to them.
    angles = angles_at(history, np.array([0.5 * (before.tick + estimate.tick)]))[0]
    return axles.mean_slip(max(estimate.v_x, MEASURABLE), estimate.v_y, estimate.yaw_rate, angles)


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
        self, estimate: OffTracking, mean_slip: float, history: SteerHistory, demand: FloatArray, until: int
    ) -> Ahead:
        """The trailer at the tick ``until``, with its steering on the way to ``demand`` (n_steered,) [rad]."""
        speed = math.hypot(estimate.v_x, estimate.v_y)
        course_rate = estimate.hitch_direction_rate + estimate.yaw_rate
        steps = max(1, math.ceil((until - estimate.tick) * TICK / _STEP))
        dt = (until - estimate.tick) * TICK / steps
        middles: FloatArray = estimate.tick + (np.arange(steps, dtype=np.float64) + 0.5) * (dt / TICK)
        moments = self._axles.steer_moment(self._angles(history, demand, middles)).tolist()
        x = y = psi = 0.0
        for k, moment in enumerate(moments):
            course = estimate.hitch_direction + course_rate * (k + 0.5) * dt
            half = 0.5 * dt * speed * self._axles.yaw_per_metre(wrap(course - psi), moment, mean_slip)
            psi += dt * speed * self._axles.yaw_per_metre(wrap(course - psi - half), moment, mean_slip)
            x += dt * speed * math.cos(course)
            y += dt * speed * math.sin(course)
        return Ahead(
            Pose2(x, y, psi), limited_direction(wrap(estimate.hitch_direction + course_rate * steps * dt - psi))
        )

    def _angles(self, history: SteerHistory, demand: FloatArray, ticks: FloatArray) -> FloatArray:
        """Steer angles (n, n_steered) [rad] at past and future ticks."""
        newest = history[-1]
        angles = angles_at(history, ticks)
        t = self._trailer
        coming = ticks > newest.tick
        waits = (ticks[coming, None] - newest.tick) * TICK
        angles[coming] = settle(newest.angles, demand, waits, lag=t.actuator_lag, max_rate=t.max_steer_rate)
        return angles


_REACH = 0.75  # half window of the fit to the path at the follow point [m]


class Target(NamedTuple):
    """The path at the follow point, in the trailer's frame."""

    offset: float  # + when it lies left [m]
    direction: float  # + left [rad]
    curvature: float  # + left [1/m]


def target_on(path: FloatArray, follow_distance: float) -> Target | None:
    """The point of a path (n, 2), newest first, at the follow point; None if it does not reach back that far."""
    s = arc_length(path)
    passed = crossing(path, s, -follow_distance)
    if passed is None:
        return None
    tangent_there = tangent(path, s, passed.s, _REACH)
    return Target(passed.y, limited_direction(tangent_there.direction), tangent_there.curvature)
