"""Self-consistency of an odometry: how well halves of its features agree, in stated standard deviations.

Residuals of neighbouring features are alike: an error of the calibration or of the exposure, the slope of patches, a
moving shadow. A covariance that counts features as independent is then too small, and no residual of a single feature
shows it (``estimators.odometry.sandwich``). Halves of the features show it: left and right in the image, near and far,
and, where a frame is measured against keyframes, those of the newest one and of older ones, which are as wrong as the
poses of their keyframes. Estimates from them differ by more than stated, and so is the estimate from all features wrong
by more than stated. Squared differences are averaged over frames. Averages of few independent frames scatter: that of a
component is drawn towards the average over all components, and this towards a larger value at the start, until frames
show what is so. If a difference persists from frame to frame, errors of motions add up linearly, and a variance that
counts motions as independent has to be larger by their number.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.estimates import Health, Motion
from estimators.odometry.sandwich import Contributions, Sums, estimated, stacked, summed
from vehicle.frames import FloatArray

_HALVES = 3  # left and right, near and far, newest keyframe and older ones
_MEMORY = 30.0  # frames that are averaged over: three seconds at 10 Hz
_PRIOR, _AT_FIRST = 4.0, 2.0  # independent frames' worth of belief at the start in differences of this mean square
_CHANCE = 2.0  # times as large as chance makes it on average a squared mean must be to count as persistent
INDEPENDENT = 0.7  # mean squared difference of independent errors: variances have a factor for neighbours of 1.44
_OVER = 14.0  # distance over which a persistent error adds up linearly: a trailer's length [m]
_LEAST_STEP = 0.5  # shortest motion for that [m]; slower ones are fewer over that distance than 14 m would mean
_ANCHORED = 2.0  # distance between keyframes: that of the errors that add up [m]
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
    return np.stack([*(value < np.median(value) for value in (z[0], z[0] - z[2])), newest])


def halves_differences(contributions: Contributions, whole: Sums, halves: NDArray[np.bool_]) -> FloatArray:
    """Differences (3, 6) of the motions from halves of the features and from the others, in standard deviations.

    They are NaN where one of the two has too few features. ``whole`` has the sums over all features; ``halves`` (3, n)
    is as of :func:`halves`.
    """
    differences = np.full((_HALVES, 6), np.nan)
    known = [k for k, half in enumerate(halves) if _FEWEST <= half.sum() <= len(half) - _FEWEST]
    if known:
        one = stacked([summed(contributions, np.flatnonzero(halves[k])) for k in known])
        other = Sums(*(all_of - part for all_of, part in zip(whole, one, strict=True)))
        first, second = estimated(one, contributions.least), estimated(other, contributions.least)
        variance = np.diagonal(first.covariance + second.covariance, axis1=1, axis2=2)
        differences[known] = (first.step - second.step) / np.sqrt(variance)
    return differences


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
    anchor = motion.anchor
    by = factors(consistency, _ANCHORED if anchor else float(np.linalg.norm(motion.X_PC[:3, 3])))
    common = np.diag([(_COMMON / focal_length) ** 2] * 2 + [0.0] * 4)
    if anchor is not None:
        anchor = replace(anchor, covariance=_scaled(anchor.covariance, by) + common)
    return consistency, replace(motion, covariance=_scaled(motion.covariance, by) + 2.0 * common, anchor=anchor)


def factors(consistency: SelfConsistency, distance: float) -> FloatArray:
    """Factors (6,) on the standard deviations of motions over ``distance`` [m] that count as independent."""
    n = (np.minimum(consistency.frames, 2.0 * _MEMORY) / _ALIKE)[:, None]  # independent frames in the averages
    square = consistency.square
    typical = (_PRIOR * _AT_FIRST + np.sum(n * square)) / (_PRIOR + 6.0 * n.sum())
    likely = (_PRIOR * typical + n * square) / (_PRIOR + n)
    chance = _CHANCE * square / np.maximum(n, 1.0)  # of a squared mean
    persistent = np.maximum(0.0, consistency.mean**2 - chance)
    motions = _OVER / np.clip(distance, _LEAST_STEP, _OVER)
    variance = np.maximum(1.0, likely + (motions - 1.0) * persistent)
    largest = variance.max(axis=0)
    largest[_TOGETHER] = largest[_TOGETHER].max(axis=0)
    by: FloatArray = np.sqrt(largest)
    return by


def _scaled(covariance: FloatArray, by: FloatArray) -> FloatArray:
    """Covariance (6, 6) with its standard deviations multiplied by factors (6,)."""
    larger: FloatArray = covariance * np.outer(by, by)
    return larger
