"""Prediction of the trailer from an old estimate to the time when its steering has answered; slip of its axles."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np

from controllers.actuator import settle
from controllers.trailer import TrailerGeometry
from controllers.trailer_steering.kinematics import AxleGroup, limited_direction
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray, Pose2, wrap

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
