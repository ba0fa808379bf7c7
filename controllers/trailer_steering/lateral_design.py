"""Linear-quadratic design of trailer steering at speed, on the combination's own linearised lateral motion.

The cost is that of Cheng and Cebon's high-speed mode as it is told of, ``integral of q_y e^2 + q_a a_y^2 + delta^2``:
off-tracking e of the follow point, lateral acceleration a_y of the trailer's centre of gravity, and the one angle
demanded of all its steered axles; only the ratios of the weights matter. What is not published is derived here:

- e looks back to where the hitch was L_f/U ago. So the path between hitch and follow point is part of the state: its
  lateral places y(x) in the trailer's frame obey ``dy/dt = U dy/dx - v_y - x r`` with y(0) = 0 and the hitch's lateral
  speed v_y and yaw rate r, which Chebyshev collocation on a few points keeps exactly for any smooth path;
- the driver's steer is taken as a second-order process, so that the law answers to it before the trailer moves;
- the lateral speed, which no sensor shows, is estimated by the Kalman filter of the same model.

Longitudinal speed, load and friction are the nominal ones; ground is level.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import expm

from controllers.driver import PERIOD
from controllers.trailer import Combination, TrailerGeometry
from vehicle.combination.linear import LateralModel, lateral_model
from vehicle.frames import FloatArray

KMH: Final = 1.0 / 3.6  # [m/s]
SPEEDS: Final = tuple(KMH * kmh for kmh in range(20, 131, 10))  # gains are designed at, straight between [m/s]

_NODES = 8  # of the path: a wave as short as the trailer is kept to 1e-3
_STEER_FREQUENCY = 2.0 * math.pi * 0.5  # assumed: quick changes of lane, 0.4 Hz in ISO 14791 and up [rad/s]
_STEER_DAMPING = 0.5  # assumed: of that process, whose band is so as wide as its frequency
_STEER_SIZE = math.radians(1.0)  # assumed: rms of road-wheel steer at speed [rad]
_SWAY = 0.3  # assumed: lateral acceleration the model does not explain, per root Hz: gusts, cross-fall [m/s2]
_TWIST = 0.05  # assumed: the same of yaw accelerations [rad/s2]
_ACTUATOR = 0.1  # assumed: the same of actuators' rates: what they do is read rather than believed [rad/s]
_GYRO, _HITCH, _ENCODER = (math.radians(d) for d in (0.15, 0.2, 0.1))  # noise of a sample, as of vehicle MEMS [rad(/s)]
_DEAD_TIME = 0.02  # lag of the actuators at least: the control period [s]


class Weights(NamedTuple):
    """Of the cost, against one square radian of demanded angle."""

    off_tracking: float  # q_y [rad2/m2]
    acceleration: float  # q_a [rad2 s4/m2]


class Gains(NamedTuple):
    """Law and filter at one speed; the motion is lateral speed, yaw rates, articulations, trailer and driver steer."""

    feedback: FloatArray  # (n_motion + nodes,) angle per motion and path
    propagation: FloatArray  # (n_motion, n_motion) of the filter over a control period
    driven: FloatArray  # (n_motion,) by the demanded angle [1/rad]
    innovation: FloatArray  # (n_motion, n_read) by what is read


class Plant(NamedTuple):
    """Motion without the path, in the states of the filter: dx/dt = A x + B delta."""

    A: FloatArray
    B: FloatArray
    sideways: FloatArray  # row: lateral speed of the hitch [m/s]
    turning: FloatArray  # row: yaw rate of the trailer [rad/s]
    thrown: FloatArray  # row: lateral acceleration of its centre of gravity [m/s2]
    units: int


def path_nodes(follow_distance: float) -> FloatArray:
    """Where behind the hitch the path is part of the state, (nodes,) x in S from front to rear [m]."""
    points: FloatArray = np.cos(np.pi * np.arange(1, _NODES + 1) / _NODES)
    places: FloatArray = 0.5 * follow_distance * (points - 1.0)
    return places


@lru_cache(maxsize=16)
def schedule(combination: Combination, trailer: TrailerGeometry, weights: Weights) -> tuple[Gains, ...]:
    """Gains at each of ``SPEEDS``."""
    return tuple(_gains(combination, trailer, weights, speed) for speed in SPEEDS)


def closed_loop(combination: Combination, trailer: TrailerGeometry, weights: Weights, speed: float) -> FloatArray:
    """Matrix of the motion under full state feedback at ``speed`` [m/s], without the driver's steer."""
    p = plant(combination, trailer, speed)
    A, B, _, _ = _with_path(p, trailer.follow_distance, speed)
    A = A - np.outer(B, _feedback(p, trailer.follow_distance, weights, speed))
    steer = [2 * p.units + 1, 2 * p.units + 2]  # after lateral speed, yaw rates, articulations, trailer steer
    keep = np.setdiff1d(np.arange(len(A)), steer)
    closed: FloatArray = A[np.ix_(keep, keep)]
    return closed


def plant(combination: Combination, trailer: TrailerGeometry, speed: float) -> Plant:
    """The combination's motion with its steering at ``speed`` [m/s]."""
    vehicle, unit = combination.vehicle, combination.unit
    model = lateral_model(vehicle, speed, outputs=("lateral_velocity", "yaw_rate", "lateral_acceleration"))
    first = 1 + sum(len(towed.actuators) for towed in vehicle.units[1:unit])
    own = slice(first, first + len(vehicle.units[unit].actuators))
    n, lag = len(model.states), max(trailer.actuator_lag, _DEAD_TIME)
    A, B = np.zeros((n + 3, n + 3)), np.zeros(n + 3)
    A[:n, :n], A[:n, n], A[:n, n + 1] = model.A, model.B[:, own].sum(axis=1), model.B[:, 0]
    A[n, n], B[n] = -1.0 / lag, 1.0 / lag
    A[n + 1, n + 2] = 1.0
    A[n + 2, n + 1 :] = -(_STEER_FREQUENCY**2), -2.0 * _STEER_DAMPING * _STEER_FREQUENCY
    kinds = ("lateral_velocity", "yaw_rate", "lateral_acceleration")
    sideways, turning, thrown = (_row(model, f"{kind}_{unit}", own) for kind in kinds)
    return Plant(A, B, sideways, turning, thrown, len(vehicle.units))


def _row(model: LateralModel, output: str, own: slice) -> FloatArray:
    k = model.outputs.index(output)
    return np.concatenate([model.C[k], [model.D[k, own].sum(), model.D[k, 0], 0.0]])


def _with_path(p: Plant, follow_distance: float, speed: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A and B with the path, and the rows of off-tracking and lateral acceleration."""
    n = len(p.A)
    A, B = np.zeros((n + _NODES, n + _NODES)), np.concatenate([p.B, np.zeros(_NODES)])
    A[:n, :n] = p.A
    A[n:, :n] = -p.sideways - np.outer(path_nodes(follow_distance), p.turning)
    A[n:, n:] = speed * 2.0 / follow_distance * _differentiation()[1:, 1:]
    off_tracking = np.zeros(n + _NODES)
    off_tracking[-1] = 1.0
    return A, B, off_tracking, np.concatenate([p.thrown, np.zeros(_NODES)])


def _differentiation() -> FloatArray:
    """Derivatives at the Chebyshev points 1 ... -1 of the polynomial through values there."""
    k = np.arange(_NODES + 1)
    x, c = np.cos(np.pi * k / _NODES), np.where((k == 0) | (k == _NODES), 2.0, 1.0) * (-1.0) ** k
    apart = np.outer(c, 1.0 / c) / (x[:, None] - x[None, :] + np.eye(_NODES + 1))
    D: FloatArray = apart - np.diag(apart.sum(axis=1))
    return D


def _feedback(p: Plant, follow_distance: float, weights: Weights, speed: float) -> FloatArray:
    import control  # it takes seconds

    A, B, e, a_y = _with_path(p, follow_distance, speed)
    cost = weights.off_tracking * np.outer(e, e) + weights.acceleration * np.outer(a_y, a_y)
    found: FloatArray = control.lqr(A, B[:, None], cost, np.eye(1))[0][0]
    return found


def _gains(combination: Combination, trailer: TrailerGeometry, weights: Weights, speed: float) -> Gains:
    import control

    p = plant(combination, trailer, speed)
    read = np.eye(len(p.A))[1:-1]  # all but the lateral speed and the rate of the driver's steer
    process, noise = _disturbances(p.units), _noises(p.units) * PERIOD
    L: FloatArray = control.lqe(p.A, np.eye(len(p.A)), read, np.diag(process), np.diag(noise))[0]
    n, m = len(p.A), len(read)
    held = np.zeros((n + 1 + m, n + 1 + m))  # what is read, and the demand, hold over a period
    held[:n] = np.column_stack([p.A - L @ read, p.B, L])
    exact = expm(held * PERIOD)[:n]
    feedback = _feedback(p, trailer.follow_distance, weights, speed)
    return Gains(feedback, exact[:, :n], exact[:, n], exact[:, n + 1 :])


def _disturbances(units: int) -> FloatArray:
    """Intensities of the white noise behind each state."""
    steer = 4.0 * _STEER_DAMPING * _STEER_FREQUENCY**3 * _STEER_SIZE**2  # that of the process with this variance
    idle = 1e-6  # of angles whose rates are states: a filter needs some
    return np.array([_SWAY**2, *[_TWIST**2] * units, *[idle] * (units - 1), _ACTUATOR**2, idle, steer])


def _noises(units: int) -> FloatArray:
    return np.array([*[_GYRO**2] * units, *[_HITCH**2] * (units - 1), _ENCODER**2, _ENCODER**2])


def at_speed(gains: tuple[Gains, ...], speed: float) -> Gains:
    """Gains between those of the neighbouring design speeds; beyond the ends they stay."""
    place = float(np.interp(speed, SPEEDS, np.arange(len(SPEEDS))))
    k = min(int(place), len(SPEEDS) - 2)
    share = place - k
    return Gains(*((1.0 - share) * low + share * high for low, high in zip(gains[k], gains[k + 1], strict=True)))
