"""Covariance of motions: from the features' residuals, and by the agreement of halves of the features.

The inverse normal matrix is the covariance only if residuals are as large as their weights say, for all features alike.
They are not: patches that promise most are further off than they promise, and these are the ones that decide yaw and
pitch. On rendered drives such covariances were 2.5 times too small for yaw and pitch and 3 times too large along the
optical axis. The sandwich estimator A^-1 B A^-1 does not rely on the weights: B is the scatter of the features' own
contributions to the gradient, A the derivative of the gradient with the slope of the robust weights.

Huber: P. J. Huber, "The behavior of maximum likelihood estimates under nonstandard conditions", 1967.

Residuals of neighbouring features are alike: an error of the calibration or of the exposure, the slope of patches, a
moving shadow. A covariance that counts features as independent is then too small, and no residual of a single feature
shows it. Halves of the features show it: left and right in the image, near and far,
and, where a frame is measured against keyframes, those of the newest one and of older ones, which are as wrong as the
poses of their keyframes. Estimates from them differ by more than stated, and so is the estimate from all features wrong
by more than stated. Squared differences are averaged over frames. Averages of few independent frames scatter: that of a
component is drawn towards the average over all components, and this towards a larger value at the start, until frames
show what is so. A difference that persists from frame to frame is an error that all motions have in common.
"""

import math
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from estimators.estimates import Anchor, Health, Motion
from estimators.rigid_motion import lasting
from vehicle.frames import FloatArray

_PRIOR_FEATURES = 20.0  # features' worth of belief that all residuals are as large as their weights say
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
    """Sums over the features of m sets."""

    normal: FloatArray  # (m, 6, 6)
    bend: FloatArray  # (m, 6, 6)
    scatter: FloatArray  # (m, 6, 6) of the scores
    gradient: FloatArray  # (m, 6)
    number: FloatArray  # (m,) of features


class Estimate(NamedTuple):
    """Motions by m sets of features, relative to that by all, their covariances, and the parts these are made of."""

    step: FloatArray  # (m, 6)
    covariance: FloatArray  # (m, 6, 6), for independent residuals
    inverse: FloatArray  # (m, 6, 6) of the gradient's derivative
    scale: FloatArray  # (m,) variance of the residuals, in the units of their weights


def summed(contributions: Contributions, sets: NDArray[np.bool_]) -> Sums:
    """Sums over all features, over all by their ``share``, and over each of the ``sets`` (m, n): 2 + m in all."""
    J, weighted, score, bend, share, _ = contributions
    n = len(share)
    within = np.concatenate([[np.ones(n), share], sets])
    scores = within[:, None] * score
    return Sums(
        ((within[:, None, None] * weighted).reshape(-1, 3 * n) @ J.reshape(6, -1).T).reshape(-1, 6, 6),
        ((within[:, None] * bend).reshape(-1, n) @ bend.T).reshape(-1, 6, 6),
        (scores.reshape(-1, n) @ score.T).reshape(-1, 6, 6),
        scores.sum(axis=2),
        within.sum(axis=1),
    )


def estimated(sums: Sums, least: float) -> Estimate:
    """Estimates by m sets of features from their sums."""
    trace = np.trace(sums.normal, axis1=-2, axis2=-1)[..., None, None]
    normal, of_scores = sums.normal + _DAMPING * trace * np.eye(6), _corrected(sums.scatter, sums.number)
    solved = np.linalg.solve(normal, np.concatenate([sums.bend, of_scores], axis=-1))
    scale = np.asarray(np.trace(solved[..., 6:], axis1=-2, axis2=-1) / 6.0, dtype=np.float64)
    inverse = np.asarray(np.linalg.inv(_slope(normal, sums.bend, solved[..., :6])), dtype=np.float64)
    covariance = inverse @ _mixed(of_scores, normal, scale, sums.number, least) @ inverse
    return Estimate(np.einsum("mij,mj->mi", inverse, sums.gradient), covariance, inverse, scale)


def own_part(sums: Sums, whole: Estimate, least: float) -> FloatArray:
    """Part (6, 6) of the covariance by all features that comes from the images in C alone.

    ``whole`` has the estimate by all features first.
    """
    number, inverse = sums.number[0], whole.inverse[0]
    of_scores = _corrected(sums.scatter[1], number)
    covariance: FloatArray = inverse @ _mixed(of_scores, sums.normal[1], whole.scale[0], number, least) @ inverse
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
    mixed: FloatArray = (n * of_scores + _PRIOR_FEATURES * scale[..., None, None] * normal) / (
        n + _PRIOR_FEATURES
    ) + least * normal
    return mixed


def _corrected(scatter: FloatArray, count: FloatArray) -> FloatArray:
    """Scatter without the bias by six degrees of freedom of 3 n."""
    return scatter * (count / (count - 2.0))[..., None, None]


_HALVES = 3  # left and right, near and far, newest keyframe and older ones
_MEMORY = 30.0  # frames that are averaged over: three seconds at 10 Hz
_PRIOR, _AT_FIRST = 4.0, 2.0  # independent frames' worth of belief at the start in differences of this mean square
_ALIKE_PARTS = 12.0  # independent frames' worth of belief that components and kinds of halves are alike
_CHANCE = 2.0  # times as large as chance makes it on average a squared mean must be to count as persistent
INDEPENDENT = 0.7  # mean squared difference of independent errors: variances have a factor for neighbours of 1.44
_LASTING = 0.04, 0.01  # least share of the variance that lasts, between frames and from keyframes; measured likewise
_COMMON = 0.01  # error of all features alike, by interpolation between pixels; measured on rendered frames [px]
_TOGETHER = np.array([[0, 1], [4, 3]])  # pitch with vertical, yaw with lateral translation: they look alike in images
_FEWEST = 12  # features of a half: twice as many as a motion needs
_ALIKE = 8.0  # frames that share a keyframe or most of their features, so that their differences are alike


class SelfConsistency(NamedTuple):
    """Averages over frames of the normalised differences between halves, by kind of halves and component."""

    frames: FloatArray = np.zeros(_HALVES)  # averaged over
    mean: FloatArray = np.zeros((_HALVES, 6))
    square: FloatArray = np.zeros((_HALVES, 6))


def halves(z: FloatArray, newest: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Features (3, n) of one half each: left ones, far ones, and those of the ``newest`` keyframe if there are any.

    Images ``z`` (3, n) are divided at the medians of column and disparity.
    """
    newest = np.zeros(z.shape[1], np.bool_) if newest is None else newest
    middle = z.shape[1] // 2  # the same features are less than this one and less than the median
    return np.stack([*(value < np.partition(value, middle)[middle] for value in (z[0], z[0] - z[2])), newest])


def with_differences(sums: Sums, least: float) -> tuple[Estimate, FloatArray]:
    """Estimates, the first of which is by all features, and differences (3, 6) between those by halves.

    A difference is that of the motions from a half of the features and from the others, in standard deviations; it is
    NaN where one of the two has too few features. The sets of ``sums`` are those of :func:`halves`.
    """
    differences, features = np.full((_HALVES, 6), np.nan), sums.number[2:]
    known = np.flatnonzero((features >= _FEWEST) & (features <= sums.number[0] - _FEWEST))
    parts = ((of_all[:1], of_all[2 + known]) for of_all in sums)
    every = estimated(Sums(*(np.concatenate([whole, half, whole - half]) for whole, half in parts)), least)
    variance = np.diagonal(every.covariance, axis1=1, axis2=2)
    (one, other), (of_one, of_other) = (np.split(of_all[1:], 2) for of_all in (every.step, variance))
    differences[known] = (one - other) / np.sqrt(of_one + of_other)
    return every, differences


def updated(consistency: SelfConsistency, differences: FloatArray) -> SelfConsistency:
    """Averages with the differences (3, 6) of one more frame; NaN says nothing."""
    known = np.asarray(np.isfinite(differences).all(axis=1), dtype=np.bool_)
    frames = consistency.frames + known
    new = (known / np.clip(frames, 1.0, _MEMORY))[:, None]
    differences = np.where(known[:, None], differences, 0.0)
    return SelfConsistency(
        frames,
        consistency.mean + new * (differences - consistency.mean),
        consistency.square + new * (differences**2 - consistency.square),
    )


def stated(consistency: SelfConsistency, motion: Motion, focal_length: float) -> tuple[SelfConsistency, Motion]:
    """Averages with the motion in it, and the motion with the covariances that it should state.

    Args:
        consistency: before the motion.
        motion: its covariances count residuals of features as independent.
        focal_length: of the camera [px].
    """
    if motion.health is Health.LOST:
        return consistency, motion
    if motion.halves is not None:
        consistency = updated(consistency, motion.halves)
    anchor, (by, share) = motion.anchor, factors(consistency)
    share = np.maximum(share, math.sqrt(_LASTING[anchor is not None]) * by)
    turned = np.diag([(_COMMON / focal_length) ** 2] * 2 + [0.0] * 4)
    if anchor is not None:
        anchor = _scaled(anchor, by, share, turned)
    return consistency, replace(_scaled(motion, by, share, 2.0 * turned), anchor=anchor)


def factors(consistency: SelfConsistency) -> tuple[FloatArray, FloatArray]:
    """Factors (6,) on the standard deviations of motions, and those that give the part that lasts.

    The first are below 1 where halves agree as independent features do, which the covariances take for neighbours.
    """
    n = (np.minimum(consistency.frames, 2.0 * _MEMORY) / _ALIKE)[:, None]  # independent frames in the averages
    square = consistency.square
    typical = (_PRIOR * _AT_FIRST + np.sum(n * square)) / (_PRIOR + 6.0 * n.sum())
    likely = (_ALIKE_PARTS * typical + n * square) / (_ALIKE_PARTS + n)
    chance = _CHANCE * square / np.maximum(n, 1.0)  # of a squared mean
    # any kind of halves may show an error of the whole, or miss it; the largest of three means is mostly chance
    lasts = np.maximum(0.0, np.sum(n * (consistency.mean**2 - chance), axis=0) / max(float(n.sum()), 1.0))
    both = np.array([np.maximum(np.maximum(INDEPENDENT, likely.max(axis=0)), lasts), lasts])
    both[:, _TOGETHER] = both[:, _TOGETHER].max(axis=1, keepdims=True)
    by, share = np.sqrt(both)
    return by, share


_Measured = TypeVar("_Measured", Motion, Anchor)


def _scaled(one: _Measured, by: FloatArray, share: FloatArray, more: FloatArray) -> _Measured:
    """A measurement with factors (6,) on its deviations, those of ``common``, and ``more`` (6, 6) in the covariance."""
    covariance = one.covariance * np.outer(by, by) + more
    return replace(one, covariance=covariance, common=lasting(one.covariance, share))
