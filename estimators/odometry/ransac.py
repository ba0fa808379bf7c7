"""RANSAC for the stereo motion: hypotheses from three matches each, scored by the truncated reprojection error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.stereo_geometry import linearised, residuals
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray, skew, transform

_HYPOTHESES = 50  # de Saxe 2018, section 3.1; one in a thousand runs fails when half the matches are wrong
_ITERATIONS = 4  # of Gauss-Newton from the prediction, for three points
_GATE = 1.5  # largest reprojection error of an inlier with sub-pixel tracks [px]
_MAJORITY = 0.7  # share that agrees with the prediction: no other motion can have half as many
_SCORED = 250  # matches that score the hypotheses; more do not change the result
_DAMPING = 1e-9  # share of the trace; keeps three collinear points from being singular
_LONGEST_STEP = 1.0  # of an iteration; triples of wrong matches would diverge [rad, m]
_SKEW = np.array([skew(axis) for axis in np.eye(3)]).reshape(3, 9)  # w @ _SKEW are the rows of skew(w)


class Consensus(NamedTuple):
    """Motion and its inliers."""

    X_PC: FloatArray  # (4, 4)
    inliers: NDArray[np.bool_]  # (n,)


def consensus(
    calibration: StereoCalibration,
    points: FloatArray,
    z: FloatArray,
    X_PC: FloatArray,
    reach: float,
    rng: np.random.Generator,
    gate: float = _GATE,
) -> Consensus:
    """Best of the prediction ``X_PC`` and of the hypotheses within ``reach`` [m] of it.

    A prediction that a clear majority agrees with is the result, as in smooth travel: its remaining error is left to
    the least squares over all inliers. The points (n, 3), n >= 3, are given in P and have images z (n, 3) in C; inliers
    lie within ``gate`` [px].
    """
    columns, z_columns = np.ascontiguousarray(points.T), np.ascontiguousarray(z.T)
    inliers = _agreeing(calibration, X_PC[:3, :3], X_PC[:3, 3], columns, z_columns, gate)
    if np.count_nonzero(inliers) > _MAJORITY * len(points):
        return Consensus(X_PC, inliers)
    triples = rng.integers(0, len(points), (_HYPOTHESES, 3))
    R, p = _from_triples(calibration, points[triples].swapaxes(1, 2), z[triples].swapaxes(1, 2), X_PC)
    R, p = np.concatenate([R, X_PC[None, :3, :3]]), np.concatenate([p, X_PC[None, :3, 3]])
    scored = slice(None, None, max(1, len(points) // _SCORED))
    r = residuals(calibration, R, p, columns[:, scored], z_columns[:, scored])
    cost = np.minimum(_squared(r), gate**2).sum(axis=1)
    cost[np.linalg.norm(p - X_PC[:3, 3], axis=1) > reach] = np.inf
    best = int(np.argmin(cost))
    agreeing = _agreeing(calibration, R[best], p[best], columns, z_columns, gate)
    return Consensus(transform(R[best], p[best]), agreeing)


def _agreeing(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray, z: FloatArray, gate: float
) -> NDArray[np.bool_]:
    """Mask (n,) of the columns of points and images (3, n) that agree with a motion."""
    agreeing: NDArray[np.bool_] = _squared(residuals(calibration, R, p, points, z)) < gate**2
    return agreeing


def _from_triples(
    calibration: StereoCalibration, points: FloatArray, z: FloatArray, X_PC: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rotations (m, 3, 3) and positions (m, 3) that fit triples (m, 3, 3) of columns; Gauss-Newton from ``X_PC``."""
    m = len(points)
    R, p = np.broadcast_to(X_PC[:3, :3], (m, 3, 3)), np.broadcast_to(X_PC[:3, 3], (m, 3))
    for _ in range(_ITERATIONS):
        r, J = linearised(calibration, R, p, points, z)
        J = J.reshape(m, 6, 9)
        normal = J @ J.transpose(0, 2, 1)
        normal += _DAMPING * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        step = np.asarray(np.linalg.solve(normal, J @ r.reshape(m, 9, 1)), dtype=np.float64)[..., 0]
        step = np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        R, p = _rotations(step[:, :3]) @ R, p + step[:, 3:]
    return R, p


def _rotations(w: FloatArray) -> FloatArray:
    """Rotation matrices (m, 3, 3) of rotation vectors (m, 3) [rad] (Rodrigues' formula)."""
    angle = np.maximum(np.linalg.norm(w, axis=1), 1e-12)[:, None, None]
    K = (w @ _SKEW).reshape(-1, 3, 3)
    rotations: FloatArray = np.eye(3) + np.sin(angle) / angle * K + (1.0 - np.cos(angle)) / angle**2 * (K @ K)
    return rotations


def _squared(residual: FloatArray) -> FloatArray:
    """Squared reprojection errors (..., n) [px2] of residuals (..., 3, n)."""
    squared: FloatArray = np.square(residual).sum(axis=-2)
    return squared
