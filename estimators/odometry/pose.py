"""Motion of a stereo pair from matches: RANSAC, and robust Gauss-Newton on the reprojection error.

Residuals are taken in both current images. Their weights include the errors of these images and the errors of the
points, propagated into the images. This propagation is linear to within 1e-4 px of noise. So the result is the joint
maximum likelihood of motion and points, with the points eliminated by the Schur complement.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.covariance import (
    Contributions,
    halves,
    own_part,
    summed,
    with_differences,
)
from estimators.stereo_pair import NEAREST, linearised, residuals, triangulation_jacobian
from sensors.camera.rig import StereoCalibration
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray, orthonormalised, skew, so3_exp, transform

_ITERATIONS = 40  # at most, in each round; usually four are enough, but many features near the cut make it slow
_CONVERGED = 0.1  # step at which a round ends [standard deviations]
_NEARLY = 0.5  # largest last step of a motion that counts as converged [standard deviations]
_FAR = 10.0  # step beyond which the Jacobian is computed anew within a round: 1 cm at 5 m [standard deviations]
_TUNING = (2.0, 1.0)  # residual with weight 1/4, in sigma, for the wide and the narrow round
_CUT = 4.0  # inliers have smaller residuals [sigma]
CORRELATION = 1.2  # factor for correlated errors of neighbours and of the four images of a point: measured
_MEDIAN = 0.888  # median of the root mean square of three standard normal numbers: sqrt(2.366 / 3)
_FINEST = 0.02  # least tracking error [px]
_FEWEST = 6  # matches that leave residuals to estimate the variance from
_DAMPING = 1e-12  # share of the trace; keeps the solution finite for degenerate matches
_LANES = 8  # columns are padded to a multiple of it
_COMPILED = (
    *("estimators.odometry", "pose.c", "refine"),
    (
        *(f"NEAREST={NEAREST}", f"ITERATIONS={_ITERATIONS}", f"CONVERGED={_CONVERGED}", f"FAR={_FAR}", f"CUT={_CUT}"),
        *(f"WIDE={_TUNING[0]}", f"NARROW={_TUNING[1]}", f"FINEST={_FINEST}", f"MEDIAN={_MEDIAN}"),
        *(f"FEWEST={_FEWEST}", f"DAMPING={_DAMPING}", f"LANES={_LANES}"),
    ),
)
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]  # rows and columns of cofactors


class Observations(NamedTuple):
    """Points known in P and their images z = (u left, v, u right) [px] in C."""

    points: FloatArray  # (n, 3) [m]
    covariance: FloatArray  # (n, 3, 3) of the points [m2]
    z: FloatArray  # (n, 3)
    variance: FloatArray  # (n, 3) of z; this and ``covariance`` may have any common scale [px2]


class Solution(NamedTuple):
    """Motion, its covariance (as in ``estimates.Motion``) and its inliers."""

    X_PC: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6)
    own: FloatArray  # (6, 6) part of it from the images in C alone: independent between frames that see the same points
    inliers: NDArray[np.bool_]  # (n,)
    converged: bool
    differences: FloatArray  # (3, 6) between halves of the features, as in ``self_consistency``


def refined(
    calibration: StereoCalibration,
    observations: Observations,
    X_PC: FloatArray,
    inliers: NDArray[np.bool_],
    newest: NDArray[np.bool_] | None = None,
) -> Solution:
    """Robust least-squares motion for the observations, starting from ``X_PC`` and its ``inliers`` (n,), at least 6.

    ``newest`` (n,) tells which points are of the newest keyframe, for the differences.
    """
    rounds = _rounds_compiled if kernel(*_COMPILED) else _rounds
    found = rounds(calibration, observations, X_PC, inliers)
    index = np.flatnonzero(found.inliers)
    variance, z = observations.variance[index], observations.z[index]
    contributions = _contributions(_of(found.columns.take(index, axis=1)), variance, found.sigma)
    sets = halves(z.T, None if newest is None else newest[index])
    sums = summed(contributions, sets)
    whole, differences = with_differences(sums, contributions.least)
    return Solution(
        transform(orthonormalised(found.R), found.p),
        CORRELATION**2 * whole.covariance[0],
        CORRELATION**2 * own_part(sums, whole, contributions.least),
        found.inliers,
        0.0 <= found.length < _NEARLY**2,
        differences / CORRELATION,
    )


class _Rounds(NamedTuple):
    """Result of the two rounds of Gauss-Newton."""

    R: FloatArray  # (3, 3)
    p: FloatArray  # (3,)
    inliers: NDArray[np.bool_]  # (n,)
    sigma: float  # scatter of their normalised errors
    length: float  # squared, of the last step [variances]; below 0 if no step could be computed
    columns: FloatArray  # (49, n) of ``Residuals``


class Residuals(NamedTuple):
    """Residuals of n features at a motion, as views of their ``columns`` (49, n)."""

    information: FloatArray  # (3, 3, n) inverse covariance up to a scale
    r: FloatArray  # (3, n) measured minus predicted images [px]
    error: FloatArray  # (n,) normalised root mean square
    J: FloatArray  # (6, 3, n) derivative of the predicted images by the motion
    weighted: FloatArray  # (6, 3, n) the same times the inverse covariances of the residuals


def _of(columns: FloatArray) -> Residuals:
    matrices = columns[:9].reshape(3, 3, -1), columns[13:].reshape(2, 6, 3, -1)
    return Residuals(matrices[0], columns[9:12], columns[12], *matrices[1])


def _rounds_compiled(
    calibration: StereoCalibration, observations: Observations, X_PC: FloatArray, inliers: NDArray[np.bool_]
) -> _Rounds:
    """The same as ``_rounds``, by compiled C (``pose.c``)."""
    compiled, n, inliers = kernel(*_COMPILED), len(inliers), inliers.copy()
    assert compiled is not None
    wide = -(-n // _LANES) * _LANES
    camera = np.array([calibration.focal_length, calibration.cx, calibration.cy, calibration.baseline])
    motion, work, result = np.concatenate([X_PC[:3, :3].ravel(), X_PC[:3, 3]]), np.zeros((57, wide)), np.empty(2)
    given = [np.ascontiguousarray(values, np.float64) for values in observations]
    compiled(n, *given, camera, motion, inliers, work, result)
    length, sigma = result.tolist()
    return _Rounds(motion[:9].reshape(3, 3), motion[9:], inliers, sigma, length, work[6:55])


def _rounds(
    calibration: StereoCalibration, observations: Observations, X_PC: FloatArray, inliers: NDArray[np.bool_]
) -> _Rounds:
    """Two rounds of Gauss-Newton, with wide and with narrow robust weights."""
    R, p = X_PC[:3, :3], X_PC[:3, 3]
    points, z = np.ascontiguousarray(observations.points.T), observations.z.T
    information = _information(calibration, R, p, observations)  # hardly depends on the motion
    for tuning in _TUNING:
        length = math.inf
        for _ in range(_ITERATIONS):
            r, jacobian = linearised(calibration, R, p, points, z)
            error = np.sqrt((np.einsum("in,ijn->jn", r, information) * r).sum(axis=0) / 3.0)
            if length > _FAR**2:
                J, weighted = jacobian, np.einsum("kin,ijn->kjn", jacobian, information)
            sigma = max(_FINEST, float(np.median(error[inliers])) / _MEDIAN)
            weight = inliers / (1.0 + (error / (tuning * sigma)) ** 2) ** 2  # Geman-McClure
            A = (weight * weighted).reshape(6, -1)
            normal, gradient = A @ J.reshape(6, -1).T, A @ r.ravel()
            normal += _DAMPING * normal.trace() * np.eye(6)
            step = np.asarray(np.linalg.solve(normal, gradient), dtype=np.float64)
            R, p = so3_exp(step[:3]) @ R, p + step[3:]
            length = float(step @ gradient) / sigma**2
            if length < _CONVERGED**2:
                break
        inliers = error < _CUT * sigma
        if np.count_nonzero(inliers) < _FEWEST:
            break
    flat = (part.reshape(-1, len(error)) for part in (information, r, error, J, weighted))
    return _Rounds(R, p, inliers, sigma, length, np.concatenate([*flat]))


def _contributions(residuals: Residuals, variance: FloatArray, sigma: float) -> Contributions:
    """Contributions of features whose errors scatter by ``sigma``; ``variance`` (n, 3) is that of the images in C.

    With u = error / c, the robust weight is w = (1 + u^2)^-2. The derivative of w r with respect to r is w I less
    4 / (3 c^2) (1 + u^2)^-3 r r'W.
    """
    J, weighted, tuned = residuals.J, residuals.weighted, _TUNING[-1] * sigma
    u = residuals.error / tuned
    weight = 1.0 / (1.0 + u**2) ** 2
    score = np.einsum("kjn,jn->kn", weighted, residuals.r)
    return Contributions(
        J=J,
        weighted=weight * weighted,
        score=weight * score,
        bend=math.sqrt(4.0 / 3.0) / tuned * (1.0 + u**2) ** -1.5 * score,
        share=np.einsum("iin,ni->n", residuals.information, variance) / 3.0,
        least=_FINEST**2,
    )


def point_covariance(calibration: StereoCalibration, points: FloatArray, variance: FloatArray) -> FloatArray:
    """Covariance (n, 3, 3) of points triangulated from images with ``variance`` (n, 3) or (3,)."""
    to_point = triangulation_jacobian(calibration, points)
    return (to_point * variance[..., None, :]) @ to_point.transpose(0, 2, 1)


def _information(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, observations: Observations
) -> FloatArray:
    """Inverse covariance (3, 3, n) of the residuals."""
    # as the derivative by the points, but for the sign
    J = linearised(calibration, R, p, np.ascontiguousarray(observations.points.T), observations.z.T)[1][3:]
    covariance = np.ascontiguousarray(observations.covariance.transpose(1, 2, 0))
    carried = np.einsum("lin,ljn->ijn", np.einsum("kin,kln->lin", J, covariance), J)
    return _inverse(np.eye(3)[:, :, None] * observations.variance.T + carried)


def _inverse(S: FloatArray) -> FloatArray:
    """Inverses of symmetric matrices (3, 3, n) by their cofactors."""
    one, two = S[_NEXT], S[_AFTER]
    cofactors = one[:, _NEXT] * two[:, _AFTER] - one[:, _AFTER] * two[:, _NEXT]
    inverse: FloatArray = cofactors / (S[0] * cofactors[0]).sum(axis=0)
    return inverse


_HYPOTHESES = 50  # de Saxe 2018, section 3.1; one in a thousand runs fails when half the matches are wrong
_TRIPLE_ITERATIONS = 4  # of Gauss-Newton from the prediction, for three points
_GATE = 1.5  # largest reprojection error of an inlier with sub-pixel tracks [px]
_MAJORITY = 0.7  # share that agrees with the prediction: no other motion can have half as many
_SCORED = 250  # matches that score the hypotheses; more do not change the result
_TRIPLE_DAMPING = 1e-9  # share of the trace; keeps three collinear points from being singular
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
    return _squared(residuals(calibration, R, p, points, z)) < gate**2


def _from_triples(
    calibration: StereoCalibration, points: FloatArray, z: FloatArray, X_PC: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rotations (m, 3, 3) and positions (m, 3) that fit triples (m, 3, 3) of columns; Gauss-Newton from ``X_PC``."""
    m = len(points)
    R, p = np.broadcast_to(X_PC[:3, :3], (m, 3, 3)), np.broadcast_to(X_PC[:3, 3], (m, 3))
    for _ in range(_TRIPLE_ITERATIONS):
        r, J = linearised(calibration, R, p, points, z)
        J = J.reshape(m, 6, 9)
        normal = J @ J.transpose(0, 2, 1)
        normal += _TRIPLE_DAMPING * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(6)
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
