"""Linear-quadratic design of the preview driver, on the tractor's own lateral motion (`tractor_model`).

The driver minimises the sum over the coming path of

    (g e)^2 + eta^2 + (T d(steer)/dt)^2

with the offset e of the guided point, the angle eta between its direction of travel and the path, and the rate of the
steer angle. On a tractor that answers at once this is the law "turn towards the path by g per metre of offset"; lags
of steering, tyres and yaw are in the model, so that the loop is damped at any speed without another number. In a steady
turn the cost is zero: no offset remains.

The path ahead is known. Its optimal use is a weighted sum of the curvatures ahead (linear optimal preview, as MacAdam
1981 and Sharp & Valtetsiotis 2001 have it): with the Riccati solution P and the closed loop A - B K, the weight of the
curvature j periods ahead is -(R + B'P B)^-1 B' ((A - B K)')^j P E.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from controllers.tractor import TractorGeometry
from controllers.tractor_model import STATES, path_matrices, rolling_matrices, tractor_model
from vehicle.frames import FloatArray

PERIOD: Final = 0.02  # the driver's step [s]
CREEP: Final = 0.2  # below this speed a direction of travel is not a measurement [m/s]
FASTEST: Final = 45.0  # of the designs [m/s]

# Stretches of the path ahead, as times of travel; a stretch counts with its mean curvature [s].
EDGES: Final = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.26, 0.32, 0.4, 0.5, 0.64, 0.8, 1.0, 1.24, 1.5, 1.8, 2.2, 2.6, 3.0)

_SMOOTHING: Final = 0.02  # T: short against the lags, which bound the loop; it only evens out kinks of the path [s]
# Lag of the side force at the axles up to which the tractor rolls, and from which on it has slip and inertia [s].
_ROLLING_UP_TO: Final = 0.05
_DYNAMIC_FROM: Final = 0.1
_ROLLING: Final = [0, 1, 6]  # its states
_SPEEDS: Final = 24  # of the designs, each 1.24 times the one before


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Gains over speed: those of the states, then the weights of the stretches ahead."""

    table: FloatArray  # (speeds, STATES + stretches), or (designs, speeds, STATES + stretches)

    def at(self, speed: FloatArray, design: NDArray[np.intp] | None = None) -> FloatArray:
        """Gains (n, STATES + stretches) at speeds (n,) [m/s], constant beyond the designs; of one design each."""
        position = np.log(np.fmin(np.fmax(speed, CREEP), FASTEST) / CREEP) * ((_SPEEDS - 1) / math.log(FASTEST / CREEP))
        low = np.minimum(position.astype(np.intp), _SPEEDS - 2)
        share = (position - low)[:, None]
        below, above = (low, low + 1) if design is None else ((design, low), (design, low + 1))
        gains: FloatArray = (1.0 - share) * self.table[below] + share * self.table[above]
        return gains

    def row(self, speed: float) -> list[float]:
        """Gains as of ``at`` for one design at one speed [m/s]."""
        ratio = min(FASTEST, max(CREEP, speed)) / CREEP
        position = float(np.log(ratio)) * ((_SPEEDS - 1) / math.log(FASTEST / CREEP))
        low = min(int(position), _SPEEDS - 2)
        share = position - low
        gains: list[float] = ((1.0 - share) * self.table[low] + share * self.table[low + 1]).tolist()
        return gains


@lru_cache(maxsize=64)
def gains(tractor: TractorGeometry, gain: float) -> Gains:
    """Gains over speed for a turn towards the path of ``gain`` [rad/m] per offset."""
    speeds = np.geomspace(CREEP, FASTEST, _SPEEDS)
    return Gains(np.array([_at_speed(tractor, gain, float(speed)) for speed in speeds]))


def _at_speed(tractor: TractorGeometry, gain: float, speed: float) -> FloatArray:
    """Gains at a speed [m/s]: of a rolling tractor when slow, of one with slip and inertia when fast, else between."""
    model, lag = tractor_model(tractor), max(tractor.actuator_lag, PERIOD)
    yaw_lag = speed / (model.front.stiffness + model.rear.stiffness)  # of the side force at the axles [s]
    share = min(1.0, max(0.0, (yaw_lag - _ROLLING_UP_TO) / (_DYNAMIC_FROM - _ROLLING_UP_TO)))
    gains = np.zeros(STATES + len(EDGES) - 1)
    if share > 0.0:
        direction = np.array([0.0, 1.0, 1.0 / speed, tractor.x_ref / speed, 0.0, 0.0, 0.0])
        gains += share * _optimal(path_matrices(model, tractor, lag, speed), direction, gain)
    if share < 1.0:
        direction = np.array([0.0, 1.0, tractor.x_ref / tractor.wheelbase])
        rolling = _optimal(rolling_matrices(tractor, lag + yaw_lag, speed), direction, gain)
        gains[_ROLLING] += (1.0 - share) * rolling[:3]
        gains[STATES:] += (1.0 - share) * rolling[3:]
    return gains


def _optimal(matrices: tuple[FloatArray, FloatArray, FloatArray], direction: FloatArray, gain: float) -> FloatArray:
    """Gains of the states, and weights of the stretches ahead.

    The first state is the offset, the last one the steer angle; ``direction`` is the output row of eta.
    """
    A, B, _ = matrices
    A_d, B_d, E_d = _sampled(*matrices)
    offset = gain * np.eye(len(B))[0]
    rate, rate_by_demand = _SMOOTHING * A[-1], _SMOOTHING * B[-1]
    Q = np.outer(offset, offset) + np.outer(direction, direction) + np.outer(rate, rate)
    cross, R = rate * rate_by_demand, rate_by_demand**2
    P = solve_discrete_are(A_d, B_d[:, None], Q, np.array([[R]]), s=cross[:, None])
    scale = 1.0 / (R + B_d @ P @ B_d)
    K = scale * (B_d @ P @ A_d + cross)
    return np.concatenate([K, _weights(A_d - np.outer(B_d, K), scale * B_d, P @ E_d)])


def _sampled(A: FloatArray, B: FloatArray, E: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matrices over a period in which demand and curvature are constant."""
    n = len(B)
    held = np.zeros((n + 2, n + 2))
    held[:n] = np.column_stack([A, B, E])
    exact = expm(PERIOD * held)
    return exact[:n, :n], exact[:n, n], exact[:n, n + 1]


def _weights(closed: FloatArray, row: FloatArray, costate: FloatArray) -> FloatArray:
    """Weight of the mean curvature of each stretch ahead [rad m]."""
    ends = np.round(np.array(EDGES) / PERIOD).astype(np.intp)
    weights = np.zeros(int(ends[-1]))
    for j in range(len(weights)):
        weights[j] = -row @ costate
        costate = closed.T @ costate
    return np.array([weights[start:end].sum() for start, end in pairwise(ends.tolist())])
