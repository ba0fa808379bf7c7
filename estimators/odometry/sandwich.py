"""Covariance of a robust least-squares motion from the features' own residuals: the sandwich estimator.

The inverse normal matrix is the covariance only if residuals are as large as their weights say, for all features alike.
They are not: patches that promise most are further off than they promise, and these are the ones that decide yaw and
pitch. On rendered drives such covariances were 2.5 times too small for yaw and pitch and 3 times too large along the
optical axis. The sandwich estimator A^-1 B A^-1 does not rely on the weights: B is the scatter of the features' own
contributions to the gradient, A the derivative of the gradient with the slope of the robust weights.

Huber: P. J. Huber, "The behavior of maximum likelihood estimates under nonstandard conditions", 1967.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

_PRIOR = 20.0  # features' worth of belief that all residuals are as large as their weights say
_STEEPEST = 0.75  # largest part of the normal matrix that the slope of the weights may take away
_DAMPING = 1e-12  # share of the trace; keeps the solution finite for degenerate features


class Contributions(NamedTuple):
    """Contributions of n features to the robust normal equations, at the motion that was found."""

    J: FloatArray  # (6, 3, n) derivative of the images with respect to the motion
    weighted: FloatArray  # (6, 3, n) the same times inverse covariances of the residuals and robust weights
    score: FloatArray  # (6, n) ``weighted`` times the residuals
    bend: FloatArray  # (6, n) its square, summed, is what the slope of the weights takes away from the normal matrix
    share: NDArray[np.float64]  # (n,) of the residual's variance that comes from the images in C alone
    least: float  # least variance of the residuals, in the units of ``weighted``


class Sums(NamedTuple):
    """Sums over features; of m sets of features with one more axis ahead."""

    normal: FloatArray  # (6, 6)
    bend: FloatArray  # (6, 6)
    scatter: FloatArray  # (6, 6) of the scores
    gradient: FloatArray  # (6,)
    number: FloatArray  # () of features


class Estimate(NamedTuple):
    """Motions by m sets of features, relative to that by all, their covariances, and the parts these are made of."""

    step: FloatArray  # (m, 6)
    covariance: FloatArray  # (m, 6, 6), for independent residuals
    inverse: FloatArray  # (m, 6, 6) of the gradient's derivative
    scale: FloatArray  # (m,) variance of the residuals, in the units of their weights


def summed(contributions: Contributions, features: NDArray[np.intp] | None = None) -> Sums:
    """Sums over some features; over all by default."""
    J, weighted, score, bend, _, _ = contributions
    if features is not None:
        J, weighted = J.take(features, axis=2), weighted.take(features, axis=2)
        score, bend = score.take(features, axis=1), bend.take(features, axis=1)
    normal = weighted.reshape(6, -1) @ J.reshape(6, -1).T
    return Sums(normal, bend @ bend.T, score @ score.T, score.sum(axis=1), np.asarray(float(score.shape[1])))


def stacked(sums: list[Sums]) -> Sums:
    """Sums of several sets of features."""
    return Sums(*(np.stack(parts) for parts in zip(*sums, strict=True)))


def estimated(sums: Sums, least: float) -> Estimate:
    """Estimates by m sets of features from their sums."""
    trace = np.trace(sums.normal, axis1=-2, axis2=-1)[..., None, None]
    normal, of_scores = sums.normal + _DAMPING * trace * np.eye(6), _corrected(sums.scatter, sums.number)
    solved = np.linalg.solve(normal, np.concatenate([sums.bend, of_scores], axis=-1))
    scale = np.asarray(np.trace(solved[..., 6:], axis1=-2, axis2=-1) / 6.0, dtype=np.float64)
    inverse = np.asarray(np.linalg.inv(_slope(normal, sums.bend, solved[..., :6])), dtype=np.float64)
    covariance = inverse @ _mixed(of_scores, normal, scale, sums.number, least) @ inverse
    return Estimate(np.einsum("mij,mj->mi", inverse, sums.gradient), covariance, inverse, scale)


def own_part(contributions: Contributions, number: FloatArray, whole: Estimate) -> FloatArray:
    """Part (6, 6) of the covariance of the ``whole`` estimate, by all features, that comes from the images in C alone.

    ``number`` is that of the features.
    """
    share, score = contributions.share, contributions.score
    own = (contributions.weighted * share).reshape(6, -1) @ contributions.J.reshape(6, -1).T
    of_scores = _corrected((share * score) @ score.T, number)
    inverse = whole.inverse[0]
    covariance: FloatArray = inverse @ _mixed(of_scores, own, whole.scale[0], number, contributions.least) @ inverse
    return covariance


def _slope(normal: FloatArray, bend: FloatArray, relative: FloatArray) -> FloatArray:
    """Derivative (..., 6, 6) of the gradient by the motion; it stays positive definite.

    ``relative`` is the ``bend`` in terms of the normal matrix.
    """
    taken = np.linalg.eigvals(relative).real.max(axis=-1)
    slope: FloatArray = normal - np.minimum(1.0, _STEEPEST / np.maximum(taken, 1e-12))[..., None, None] * bend
    return slope


def _mixed(of_scores: FloatArray, normal: FloatArray, scale: FloatArray, count: FloatArray, least: float) -> FloatArray:
    """Scatter (..., 6, 6) of the scores; that of few features in part as large as the weights say."""
    n = count[..., None, None]
    mixed: FloatArray = (n * of_scores + _PRIOR * scale[..., None, None] * normal) / (n + _PRIOR) + least * normal
    return mixed


def _corrected(scatter: FloatArray, count: FloatArray) -> FloatArray:
    """Scatter without the bias by six degrees of freedom of 3 n."""
    corrected: FloatArray = scatter * (count / (count - 2.0))[..., None, None]
    return corrected
