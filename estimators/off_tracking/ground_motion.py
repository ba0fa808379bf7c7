"""Planar motion of a trailer from ground features in two frames, with the common small tilt of its cameras.

A camera tilted against the ground distorts it by perspective: a point at r from the centre of the view appears at
r + r (k . r), with k the tilt over the height. Between two views at a distance d this acts as the shear d k^T. A fit
without k takes half of it for a rotation: 0.07 deg of roll at 1 m of height cause 1 deg over 14 m. So k [1/m] is
estimated with every motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimators.off_tracking.planar_fit import FINEST, UPRIGHT, Pairs, planar_motion, pooled
from estimators.rigid_motion import UncertainMotion
from vehicle.frames import FloatArray, so3_exp

_ITERATIONS = 2  # from the rigid fit, which has an error of 0.1 %
_TILT = 0.03  # k at a roll of 2 deg with cameras 1 m above the ground, 1 sigma [1/m]
_NOISE = 1e-3  # error of a point on the ground, half a pixel; weight of that prior [m]
_CORRELATION = 2.0  # factor for correlated errors of neighbours: the normalised error of motions is then about 1
_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # rotation by +90 deg


class GroundMotion(NamedTuple):
    """Motion X_PC of the body, and the disagreement of the cameras about it."""

    motion: UncertainMotion
    disagreement: float  # between the mean residuals of the cameras; 0 with one camera [m]


def ground_motion(views: Sequence[tuple[Pairs, FloatArray]]) -> GroundMotion:
    """Least-squares motion for the pairs of each camera, given with the centre (2,) of its view in S [m]."""
    together = pooled(*(pairs for pairs, _ in views))
    middles = np.concatenate([np.broadcast_to(middle, pairs.first.shape) for pairs, middle in views])
    p, q = together.first, together.second
    X = planar_motion(together).X
    R, t, k = X[:2, :2], X[:2, 3], np.zeros(2)
    for _ in range(_ITERATIONS):
        turned = q @ R.T
        from_middle, then = p - middles, (q - middles) @ R.T
        slant = _outer(from_middle, from_middle) - _outer(then, q - middles)  # times k: shift by the tilt
        residual = p - turned - t - slant @ k
        J = np.concatenate([(turned @ _TURN.T)[:, :, None], np.broadcast_to(np.eye(2), slant.shape), slant], axis=2)
        A = J.reshape(-1, 5)
        normal = A.T @ A + np.diag([0.0, 0.0, 0.0, 1.0, 1.0]) * (_NOISE / _TILT) ** 2
        prior = np.concatenate([np.zeros(3), k]) * (_NOISE / _TILT) ** 2
        step = np.linalg.solve(normal, A.T @ residual.ravel() - prior)
        R, t, k = so3_exp(np.array([0.0, 0.0, step[0]]))[:2, :2] @ R, t + step[1:3], k + step[3:]
    means = [residual[start:end].mean(axis=0) for start, end in _stretches(views)]
    disagreement = float(np.linalg.norm(means[0] - means[-1]))
    X = X.copy()
    X[:2, :2], X[:2, 3] = R, t
    return GroundMotion(UncertainMotion(X, _covariance(residual, normal, disagreement)), disagreement)


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, :, None] * b[:, None, :])


def _stretches(views: Sequence[tuple[Pairs, FloatArray]]) -> list[tuple[int, int]]:
    """First row of each camera's pairs and the row after its last."""
    ends = np.cumsum([0, *(len(pairs.first) for pairs, _ in views)]).tolist()
    return list(pairwise(ends))


def _covariance(residual: FloatArray, normal: FloatArray, disagreement: float) -> FloatArray:
    """Covariance (6, 6) of the fit, plus the disagreement of the cameras."""
    variance = _CORRELATION**2 * (FINEST**2 + float(np.square(residual).sum()) / (2 * len(residual) - 5))
    covariance = UPRIGHT * np.eye(6)
    covariance[2:5, 2:5] = variance * np.linalg.inv(normal)[:3, :3]
    covariance[3:5, 3:5] += disagreement**2 * np.eye(2)
    return covariance
