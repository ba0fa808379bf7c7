"""Constant-acceleration Kalman filter of a camera's velocity: step 6 of VISO2-S."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.rigid_motion import UncertainMotion, rotation_vector
from vehicle.clock import TICK
from vehicle.frames import FloatArray, so3_exp, transform

# Density of white jerk: 6 m/s3 and 3 rad/s3 for a tenth of a second, as in braking and as a trailer's body rolls and
# pitches over bumps.
_JERK = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # [rad/s3/sqrt(Hz)], [m/s3/sqrt(Hz)]
_START = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])  # initial standard deviation of the acceleration [rad/s2], [m/s2]


class Velocity(NamedTuple):
    """Velocity and acceleration of six components (rotation, then translation) at a tick, each with its covariance."""

    tick: int
    state: FloatArray  # (6, 2) velocity [rad/s, m/s], acceleration [rad/s2, m/s2]
    covariance: FloatArray  # (6, 2, 2)


def started(tick: int, span: int, measured: UncertainMotion) -> Velocity:
    """Initial velocity from the first motion, which took ``span`` ticks."""
    velocity, variance = _velocity(span, measured)
    covariance = np.zeros((6, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = variance, _START**2
    return Velocity(tick, np.column_stack([velocity, np.zeros(6)]), covariance)


def updated(last: Velocity, tick: int, span: int, measured: UncertainMotion) -> Velocity:
    """Velocity updated with a motion of ``span`` ticks that ended at ``tick``."""
    predicted = _predicted(last, tick)
    velocity, variance = _velocity(span, measured)
    gain = predicted.covariance[:, :, 0] / (predicted.covariance[:, 0, 0] + variance)[:, None]
    state = predicted.state + gain * (velocity - predicted.state[:, 0])[:, None]
    covariance = predicted.covariance - gain[:, :, None] * predicted.covariance[:, None, 0, :]
    return Velocity(tick, state, covariance)


def expected_motion(last: Velocity, tick: int, span: int) -> FloatArray:
    """Motion X (4, 4) over the ``span`` ticks before ``tick`` at the velocity predicted for ``tick``."""
    twist = _predicted(last, tick).state[:, 0] * (span * TICK)
    return transform(so3_exp(twist[:3]), twist[3:])


def _velocity(span: int, measured: UncertainMotion) -> tuple[FloatArray, FloatArray]:
    """Mean velocity (6,) over a motion, and its variance."""
    seconds = span * TICK
    velocity = np.concatenate([rotation_vector(measured.X[:3, :3]), measured.X[:3, 3]]) / seconds
    return velocity, np.diag(measured.covariance) / seconds**2


def _predicted(last: Velocity, tick: int) -> Velocity:
    """Velocity predicted for a later tick at constant acceleration, with white jerk as process noise."""
    t = (tick - last.tick) * TICK
    F = np.array([[1.0, t], [0.0, 1.0]])
    Q = np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
    return Velocity(tick, last.state @ F.T, F @ last.covariance @ F.T + (_JERK**2)[:, None, None] * Q)
