"""Self-consistency of an odometry: how well halves of its features agree, in stated standard deviations.

Residuals of neighbouring features are alike: an error of the calibration or of the exposure, the slope of patches, a
moving shadow. A covariance that counts features as independent is then too small, and no residual of a single feature
shows it. Two halves of the features show it: left and right in the image, near and far. Their estimates differ by more
than stated, and so is the estimate from all of them wrong by more than stated. The ratio is averaged over frames. If
the difference persists from frame to frame, errors of motions add up linearly, and a variance that counts motions as
independent has to be larger by their number.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.estimates import Health, Motion
from vehicle.frames import FloatArray

_HALVES = 2  # left and right, near and far
_MEMORY = 30.0  # frames that are averaged over: three seconds at 10 Hz
_PRIOR, _AT_FIRST = 4.0, 2.0  # frames' worth of belief at the start in differences of this mean square: twice as large
INDEPENDENT = 0.5  # mean squared difference of independent errors: the variance has a factor for neighbours of about 2
_OVER = 14.0  # distance over which a persistent error adds up linearly: a trailer's length [m]
_LEAST_STEP = 0.5  # shortest motion for that [m]; slower ones are fewer over that distance than 14 m would mean
_ANCHORED = 2.0  # distance between keyframes: that of the errors that add up [m]
_COMMON = 0.015  # error of all features alike, by interpolation between pixels; measured on rendered frames [px]
_TOGETHER = np.array([[0, 1], [4, 3]])  # pitch with vertical, yaw with lateral translation: they look alike in images
_FEWEST = 6  # features that a motion needs
_DAMPING = 1e-9  # share of the trace; keeps the solution finite for degenerate halves
_ALIKE = 4.0  # frames that share a keyframe or most of their features, so that their differences are alike


class SelfConsistency(NamedTuple):
    """Averages over frames of the normalised differences between halves, by kind of halves and component."""

    frames: float = 0.0  # averaged over
    mean: FloatArray = np.zeros((_HALVES, 6))
    square: FloatArray = np.full((_HALVES, 6), _AT_FIRST)


def halves_differences(
    J: FloatArray, weighted: FloatArray, r: FloatArray, z: FloatArray, variance: float
) -> FloatArray:
    """Differences (2, 6) of the motions from halves of the features, in standard deviations.

    Args:
        J: derivative (6, 3, n) of the images with respect to the motion.
        weighted: the same times the inverse covariances of the residuals.
        r: residuals (3, n) at the motion from all features, made robust [px].
        z: images (3, n) of the features; they are divided at the medians of column and disparity.
        variance: factor from the inverse normal matrix to the covariance.
    """
    normal, gradient = _normal_equations(J, weighted, r)
    differences = np.zeros((_HALVES, 6))
    for k, value in enumerate((z[0], z[0] - z[2])):
        half = np.flatnonzero(value < np.median(value))
        if len(half) < _FEWEST:  # all in one place
            continue
        one, along = _normal_equations(J.take(half, axis=2), weighted.take(half, axis=2), r.take(half, axis=1))
        motions, variances = _solved(np.stack([one, normal - one]), np.stack([along, gradient - along]))
        differences[k] = (motions[0] - motions[1]) / np.sqrt(variance * variances.sum(axis=0))
    return differences


def _normal_equations(J: FloatArray, weighted: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Matrix (6, 6) and right-hand side (6,)."""
    A = weighted.reshape(6, -1)
    return A @ J.reshape(6, -1).T, A @ r.ravel()


def _solved(normal: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solutions (m, 6) and the diagonals (m, 6) of the inverse matrices (m, 6, 6)."""
    trace = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    inverse = np.asarray(np.linalg.inv(normal + _DAMPING * trace * np.eye(6)), dtype=np.float64)
    return np.einsum("mij,mj->mi", inverse, gradient), np.diagonal(inverse, axis1=1, axis2=2)


def updated(consistency: SelfConsistency, differences: FloatArray) -> SelfConsistency:
    """Averages with the differences (2, 6) of one more frame."""
    frames = min(consistency.frames + 1.0, _MEMORY)
    new = 1.0 / (frames + _PRIOR)
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
    anchor = motion.anchor
    by = factors(consistency, _ANCHORED if anchor else float(np.linalg.norm(motion.X_PC[:3, 3])))
    common = np.diag([(_COMMON / focal_length) ** 2] * 2 + [0.0] * 4)
    if anchor is not None:
        anchor = replace(anchor, covariance=_scaled(anchor.covariance, by) + common)
    return consistency, replace(motion, covariance=_scaled(motion.covariance, by) + 2.0 * common, anchor=anchor)


def factors(consistency: SelfConsistency, distance: float) -> FloatArray:
    """Factors (6,) on the standard deviations of motions over ``distance`` [m] that count as independent."""
    chance = consistency.square * _ALIKE / (consistency.frames + _PRIOR)  # of a squared mean
    persistent = np.maximum(0.0, consistency.mean**2 - chance)
    motions = _OVER / np.clip(distance, _LEAST_STEP, _OVER)
    variance = np.maximum(1.0, (consistency.square + (motions - 1.0) * persistent) / INDEPENDENT)
    largest = variance.max(axis=0)
    largest[_TOGETHER] = largest[_TOGETHER].max(axis=0)
    by: FloatArray = np.sqrt(largest)
    return by


def _scaled(covariance: FloatArray, by: FloatArray) -> FloatArray:
    """Covariance (6, 6) with its standard deviations multiplied by factors (6,)."""
    larger: FloatArray = covariance * np.outer(by, by)
    return larger
