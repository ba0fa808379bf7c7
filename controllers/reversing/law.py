"""Reversing law: steers a combination backwards so that its last axle follows a path.

State feedback on the tractor's front wheels, as Rimmer & Cebon 2015, "Theory and practice of reversing control on
multiply-articulated vehicles", J. Automobile Engineering (abstract read), whose last unit tracks a path within 0.4 m.
The gains are derived here: a linear-quadratic regulator about the steady turn of each path curvature, over the arc
length of the last axle, so that they do not depend on speed. Articulation and steer angle of the error-free motion are
fed forward.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import solve_continuous_are

from controllers.reversing.chain import RollingChain
from controllers.reversing.reference import ReferencePoint
from vehicle.frames import FloatArray, Pose2

_LATERAL_ERROR: Final = 0.7  # weighs as much as ... [m]
_CURVATURE: Final = 0.1  # ... this change of the tractor's curvature [1/m]
_STEEPEST: Final = 0.6  # approach angle to the path at most, at any distance from it [rad]
_MOST_FOLDED: Final = math.radians(65.0)  # articulation beyond which no gain is designed
_DESIGNS: Final = 9  # curvatures from straight to the tightest turn, to either side
_DIFFERENCE: Final = 1e-6  # [rad], [m], [1/m]


class ReversingLaw:
    """State feedback in reverse, for any number of hitches."""

    def __init__(self, chain: RollingChain) -> None:
        """Design the gains."""
        self._chain = chain
        tightest = _tightest(chain)
        self._curvatures = np.linspace(-tightest, tightest, 2 * _DESIGNS - 1)
        self._gains = np.array([_gain(chain, curvature) for curvature in self._curvatures])

    def steer(self, last: Pose2, articulation: FloatArray, on: ReferencePoint) -> float:
        """Demanded angle of the tractor's front wheels [rad], within their limit.

        ``last`` is the pose of the last axle, ``articulation`` (N,) [rad], ``on`` the nearest point of the reference.
        """
        gain = self.gain(on.curvature)
        x, y, psi = on.pose
        offset = math.cos(psi) * (last.y - y) - math.sin(psi) * (last.x - x)
        farthest = _STEEPEST * abs(gain[1] / gain[0])  # offset that demands the steepest approach [m]
        heading = math.remainder(last.psi - psi, math.tau)
        error = np.concatenate([[min(max(offset, -farthest), farthest), heading], articulation - on.articulation])
        curvature = on.tractor_curvature - float(gain @ error)
        limit = self._chain.max_steer
        return min(max(math.atan(self._chain.wheelbase * curvature), -limit), limit)

    def gain(self, curvature: float) -> FloatArray:
        """Gains (2 + N,) of lateral, heading and articulation errors on the tractor's curvature."""
        return np.array([np.interp(curvature, self._curvatures, column) for column in self._gains.T])


def _tightest(chain: RollingChain) -> float:
    """Largest curvature of the last axle's path [1/m] in a steady turn, with margin in steering and articulation."""
    for curvature in np.linspace(0.5, 0.01, 50).tolist():
        articulation, of_tractor = chain.steady(curvature)
        steer = math.atan(chain.wheelbase * of_tractor)
        if steer < 0.9 * chain.max_steer and np.abs(articulation).max() < _MOST_FOLDED:
            return float(curvature)
    return 0.01


def _gain(chain: RollingChain, curvature: float) -> FloatArray:
    """Gains (2 + N,) about the steady turn of a curvature [1/m]."""
    articulation, of_tractor = chain.steady(curvature)
    rest = np.concatenate([[0.0, 0.0], articulation])

    def rate(errors: FloatArray, steering: float) -> FloatArray:
        return _backward_rate(chain, rest + errors, of_tractor + steering, curvature)

    n, h = len(rest), _DIFFERENCE
    A = np.column_stack([(rate(h * e, 0.0) - rate(-h * e, 0.0)) / (2.0 * h) for e in np.eye(n)])
    B = (rate(np.zeros(n), h) - rate(np.zeros(n), -h))[:, None] / (2.0 * h)
    Q, R = np.zeros((n, n)), np.array([[1.0 / _CURVATURE**2]])
    Q[0, 0] = 1.0 / _LATERAL_ERROR**2
    P = solve_continuous_are(A, B, Q, R)
    gain: FloatArray = np.linalg.solve(R, B.T @ P)[0]
    return gain


def _backward_rate(chain: RollingChain, state: FloatArray, of_tractor: float, curvature: float) -> FloatArray:
    """Rates of lateral error, heading error and articulation per metre that the last axle moves back."""
    offset, heading, articulation = state[0], state[1], state[2:]
    speeds, yaw_rates = chain.rates(articulation, of_tractor)
    on_path = speeds[-1] * math.cos(heading) / (1.0 - curvature * offset)
    forward = [speeds[-1] * math.sin(heading), yaw_rates[-1] - curvature * on_path, *-np.diff(yaw_rates)]
    rates: FloatArray = -np.array(forward) / speeds[-1]
    return rates
