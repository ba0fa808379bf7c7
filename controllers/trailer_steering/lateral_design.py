"""Linear-quadratic design of trailer steering at speed, on the combination's own linearised lateral motion.

The cost is that of Cheng and Cebon's high-speed mode as cited by others, ``integral of q_y e^2 + q_a a_y^2 + delta^2``:
off-tracking e of the follow point, lateral acceleration a_y of the trailer's centre of gravity, and one angle demanded
of all its steered axles; only the ratios of the weights matter. Derived here, since it is not published:

- e refers to the position of the hitch a time L_f/U ago. So the path between hitch and follow point is part of the
  state: its lateral positions y(x) in the trailer's frame obey ``dy/dt = U dy/dx - v_y - x r`` with y(0) = 0 and the
  hitch's lateral speed v_y and yaw rate r. Chebyshev collocation on a few points is exact for any smooth path;
- the driver's steer is a second-order process, so that the law responds to it before the trailer moves;
- the lateral speed, which no sensor measures, is estimated by the Kalman filter of the same model.

Longitudinal speed, load and friction are nominal; the ground is level.
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
SPEEDS: Final = tuple(KMH * kmh for kmh in range(20, 131, 10))  # of the designs; gains are linear in between [m/s]

_NODES = 8  # of the path: a wave of the trailer's length is represented to 1e-3
_STEER_FREQUENCY = 2.0 * math.pi * 0.5  # assumed: quick changes of lane, 0.4 Hz in ISO 14791 and up [rad/s]
_STEER_DAMPING = 0.5  # assumed: the bandwidth of that process equals its frequency
_STEER_SIZE = math.radians(1.0)  # assumed: rms of road-wheel steer at speed [rad]
_SWAY = 0.3  # assumed: lateral acceleration not in the model, per root Hz: gusts, cross-fall [m/s2]
_TWIST = 0.05  # assumed: the same for yaw accelerations [rad/s2]
_ACTUATOR = 0.1  # assumed: the same for the actuators' rates; their angles are measured [rad/s]
_GYRO, _HITCH, _ENCODER = (math.radians(d) for d in (0.15, 0.2, 0.1))  # noise of a sample, as of vehicle MEMS [rad(/s)]
_DEAD_TIME = 0.02  # least lag of the actuators: the control period [s]


class Weights(NamedTuple):
    """Weights of the cost against one square radian of demanded angle."""

    off_tracking: float  # q_y [rad2/m2]
    acceleration: float  # q_a [rad2 s4/m2]


class Gains(NamedTuple):
    """Law and filter at one speed.

    The motion is lateral speed, yaw rates, articulations, trailer steer, driver's steer and its rate.
    """

    feedback: FloatArray  # (n_motion + nodes,) angle per motion and path
    propagation: FloatArray  # (n_motion, n_motion) of the filter over a control period
    input: FloatArray  # (n_motion,) per demanded angle [1/rad]
    innovation: FloatArray  # (n_motion, n_read) per reading


class Plant(NamedTuple):
    """Motion without the path, in the filter's states: dx/dt = A x + B delta."""

    A: FloatArray
    B: FloatArray
    lateral_speed: FloatArray  # output row: of the hitch [m/s]
    yaw_rate: FloatArray  # output row: of the trailer [rad/s]
    lateral_acceleration: FloatArray  # output row: of the trailer's centre of gravity [m/s2]
    units: int


def path_nodes(follow_distance: float) -> FloatArray:
    """Positions of the path nodes behind the hitch, (nodes,) x in S from front to rear [m]."""
    points: FloatArray = np.cos(np.pi * np.arange(1, _NODES + 1) / _NODES)
    nodes: FloatArray = 0.5 * follow_distance * (points - 1.0)
    return nodes


@lru_cache(maxsize=16)
def schedule(combination: Combination, trailer: TrailerGeometry, weights: Weights) -> tuple[Gains, ...]:
    """Gains at each of ``SPEEDS``."""
    return tuple(_gains(combination, trailer, weights, speed) for speed in SPEEDS)


def closed_loop(combination: Combination, trailer: TrailerGeometry, weights: Weights, speed: float) -> FloatArray:
    """System matrix under full state feedback at ``speed`` [m/s], without the driver's steer."""
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
    lateral_speed, yaw_rate, lateral_acceleration = (_row(model, f"{kind}_{unit}", own) for kind in kinds)
    return Plant(A, B, lateral_speed, yaw_rate, lateral_acceleration, len(vehicle.units))


def _row(model: LateralModel, output: str, own: slice) -> FloatArray:
    k = model.outputs.index(output)
    return np.concatenate([model.C[k], [model.D[k, own].sum(), model.D[k, 0], 0.0]])


def _with_path(p: Plant, follow_distance: float, speed: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A and B with the path, and the output rows of off-tracking and lateral acceleration."""
    n = len(p.A)
    A, B = np.zeros((n + _NODES, n + _NODES)), np.concatenate([p.B, np.zeros(_NODES)])
    A[:n, :n] = p.A
    A[n:, :n] = -p.lateral_speed - np.outer(path_nodes(follow_distance), p.yaw_rate)
    A[n:, n:] = speed * 2.0 / follow_distance * _differentiation()[1:, 1:]
    off_tracking = np.zeros(n + _NODES)
    off_tracking[-1] = 1.0
    return A, B, off_tracking, np.concatenate([p.lateral_acceleration, np.zeros(_NODES)])


def _differentiation() -> FloatArray:
    """Differentiation matrix on the Chebyshev points 1 ... -1."""
    k = np.arange(_NODES + 1)
    x, c = np.cos(np.pi * k / _NODES), np.where((k == 0) | (k == _NODES), 2.0, 1.0) * (-1.0) ** k
    D: FloatArray = np.outer(c, 1.0 / c) / (x[:, None] - x[None, :] + np.eye(_NODES + 1))
    return D - np.diag(D.sum(axis=1))


def _feedback(p: Plant, follow_distance: float, weights: Weights, speed: float) -> FloatArray:
    import control  # the import takes seconds

    A, B, e, a_y = _with_path(p, follow_distance, speed)
    cost = weights.off_tracking * np.outer(e, e) + weights.acceleration * np.outer(a_y, a_y)
    gain: FloatArray = control.lqr(A, B[:, None], cost, np.eye(1))[0][0]
    return gain


def _gains(combination: Combination, trailer: TrailerGeometry, weights: Weights, speed: float) -> Gains:
    import control

    p = plant(combination, trailer, speed)
    read = np.eye(len(p.A))[1:-1]  # all states but lateral speed and rate of the driver's steer
    process, noise = _disturbances(p.units), _noises(p.units) * PERIOD
    L: FloatArray = control.lqe(p.A, np.eye(len(p.A)), read, np.diag(process), np.diag(noise))[0]
    n, m = len(p.A), len(read)
    constant_inputs = np.zeros((n + 1 + m, n + 1 + m))  # readings and demand are constant over a period
    constant_inputs[:n] = np.column_stack([p.A - L @ read, p.B, L])
    exact = expm(constant_inputs * PERIOD)[:n]
    feedback = _feedback(p, trailer.follow_distance, weights, speed)
    return Gains(feedback, exact[:, :n], exact[:, n], exact[:, n + 1 :])


def _disturbances(units: int) -> FloatArray:
    """Intensities of the white noise that drives each state."""
    steer = 4.0 * _STEER_DAMPING * _STEER_FREQUENCY**3 * _STEER_SIZE**2  # gives the process that variance
    idle = 1e-6  # of angles whose rates are states; the filter needs a positive value
    return np.array([_SWAY**2, *[_TWIST**2] * units, *[idle] * (units - 1), _ACTUATOR**2, idle, steer])


def _noises(units: int) -> FloatArray:
    return np.array([*[_GYRO**2] * units, *[_HITCH**2] * (units - 1), _ENCODER**2, _ENCODER**2])


def at_speed(gains: tuple[Gains, ...], speed: float) -> Gains:
    """Gains interpolated between the design speeds, constant beyond them."""
    position = float(np.interp(speed, SPEEDS, np.arange(len(SPEEDS))))
    k = min(int(position), len(SPEEDS) - 2)
    share = position - k
    return Gains(*((1.0 - share) * low + share * high for low, high in zip(gains[k], gains[k + 1], strict=True)))
