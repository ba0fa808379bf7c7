"""Steering a combination backwards so that its last axle keeps to a path.

State feedback on the tractor's front wheels, as Rimmer & Cebon 2015, "Theory and practice of reversing control on
multiply-articulated vehicles", J. Automobile Engineering (abstract read), whose last unit tracks a path too; theirs
kept within 0.4 m. The gains here are ours: those of a linear-quadratic regulator about the steady turn of each path
curvature, in the arc length of the last axle, so that speed has no part in them. What the articulations and the
steer angle would be without any error is fed forward.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import solve_continuous_are

from controllers.reversing.chain import RollingChain
from controllers.reversing.reference import ReferencePoint
from vehicle.frames import FloatArray, Pose2

_BESIDE: Final = 0.7  # error that is worth ... [m]
_BENDING: Final = 0.1  # ... this much of the tractor's curvature [1/m]
_STEEPEST: Final = 0.6  # against the path at most, however far beside it the axle is [rad]
_MOST_FOLDED: Final = math.radians(65.0)  # articulation beyond which no gain is designed
_DESIGNS: Final = 9  # curvatures from straight to the tightest turn, to either side
_DIFFERENCE: Final = 1e-6  # [rad], [m], [1/m]


class ReversingLaw:
    """Steer angle for going backwards; the same for any number of hitches."""

    def __init__(self, chain: RollingChain) -> None:
        """Designs the gains."""
        self._chain = chain
        tightest = _tightest(chain)
        self._curvatures = np.linspace(-tightest, tightest, 2 * _DESIGNS - 1)
        self._gains = np.array([_gain(chain, curvature) for curvature in self._curvatures])

    def steer(self, last: Pose2, articulation: FloatArray, on: ReferencePoint) -> float:
        """Demanded angle of the tractor's front wheels [rad], within their limit.

        ``last`` is where the last axle is and its unit points, ``articulation`` (N,) [rad]; ``on`` the nearest point.
        """
        gain = self.gain(on.curvature)
        x, y, psi = on.pose
        beside = math.cos(psi) * (last.y - y) - math.sin(psi) * (last.x - x)
        farthest = _STEEPEST * abs(gain[1] / gain[0])  # from where the demand is for the steepest approach
        heading = math.remainder(last.psi - psi, math.tau)
        error = np.concatenate([[min(max(beside, -farthest), farthest), heading], articulation - on.articulation])
        curvature = on.tractor_curvature - float(gain @ error)
        limit = self._chain.max_steer
        return min(max(math.atan(self._chain.wheelbase * curvature), -limit), limit)

    def gain(self, curvature: float) -> FloatArray:
        """Tractor's curvature against errors beside, of heading and of each articulation, on a path's curvature."""
        return np.array([np.interp(curvature, self._curvatures, column) for column in self._gains.T])


def _tightest(chain: RollingChain) -> float:
    """The last axle's curvature [1/m] up to which the steering and the hitches hold a steady turn with some room."""
    for curvature in np.linspace(0.5, 0.01, 50).tolist():
        articulation, of_tractor = chain.steady(curvature)
        steer = math.atan(chain.wheelbase * of_tractor)
        if steer < 0.9 * chain.max_steer and np.abs(articulation).max() < _MOST_FOLDED:
            return float(curvature)
    return 0.01


def _gain(chain: RollingChain, curvature: float) -> FloatArray:
    """Gain about the steady turn of this curvature, (2 + N,)."""
    articulation, of_tractor = chain.steady(curvature)
    rest = np.concatenate([[0.0, 0.0], articulation])

    def rate(errors: FloatArray, steering: float) -> FloatArray:
        return _backward_rate(chain, rest + errors, of_tractor + steering, curvature)

    n, h = len(rest), _DIFFERENCE
    A = np.column_stack([(rate(h * e, 0.0) - rate(-h * e, 0.0)) / (2.0 * h) for e in np.eye(n)])
    B = (rate(np.zeros(n), h) - rate(np.zeros(n), -h))[:, None] / (2.0 * h)
    Q, R = np.zeros((n, n)), np.array([[1.0 / _BENDING**2]])
    Q[0, 0] = 1.0 / _BESIDE**2
    P = solve_continuous_are(A, B, Q, R)
    gain: FloatArray = np.linalg.solve(R, B.T @ P)[0]
    return gain


def _backward_rate(chain: RollingChain, state: FloatArray, of_tractor: float, curvature: float) -> FloatArray:
    """Rates of distance beside, heading error and articulations per metre that the last axle goes back."""
    beside, heading, articulation = state[0], state[1], state[2:]
    speeds, yaw_rates = chain.rates(articulation, of_tractor)
    on_path = speeds[-1] * math.cos(heading) / (1.0 - curvature * beside)
    forward = [speeds[-1] * math.sin(heading), yaw_rates[-1] - curvature * on_path, *-np.diff(yaw_rates)]
    rates: FloatArray = -np.array(forward) / speeds[-1]
    return rates
