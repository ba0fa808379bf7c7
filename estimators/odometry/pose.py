"""Motion of a stereo pair from matches: robust Gauss-Newton on the reprojection error, with its covariance.

Residuals are taken in both current images. Their weights include the errors of these images and the errors of the
points, propagated into the images. This propagation is linear to within 1e-4 px of noise. So the result is the joint
maximum likelihood of motion and points, with the points eliminated by the Schur complement.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.sandwich import Contributions, estimated, own_part, stacked, summed
from estimators.odometry.self_consistency import halves, halves_differences
from estimators.stereo_geometry import linearised, motion_jacobian, residuals, triangulation_jacobian
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray, orthonormalised, so3_exp, transform

_ITERATIONS = 40  # at most, in each round; usually four are enough, but many features near the cut make it slow
_CONVERGED = 0.1  # step at which a round ends [standard deviations]
_NEARLY = 0.5  # largest last step of a motion that counts as converged [standard deviations]
_FAR = 10.0  # step beyond which the Jacobian is computed anew within a round: 1 cm at 5 m [standard deviations]
_TUNING = (2.0, 1.0)  # residual with weight 1/4, in sigma, for the wide and the narrow round
_CUT = 4.0  # inliers have smaller residuals [sigma]
_CORRELATION = 1.2  # factor for correlated errors of neighbours and of the four images of a point: measured
_MEDIAN = 0.888  # median of the root mean square of three standard normal numbers: sqrt(2.366 / 3)
_FINEST = 0.02  # least tracking error [px]
_FEWEST = 6  # matches that leave residuals to estimate the variance from
_DAMPING = 1e-12  # share of the trace; keeps the solution finite for degenerate matches
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
    points, z = np.ascontiguousarray(observations.points.T), np.ascontiguousarray(observations.z.T)
    R, p = X_PC[:3, :3], X_PC[:3, 3]
    information = _information(calibration, R, p, observations)  # hardly depends on the motion
    for tuning in _TUNING:
        length = math.inf
        for _ in range(_ITERATIONS):
            if length > _FAR**2:
                r, J = linearised(calibration, R, p, points, z)
                weighted = _weighted(J, information)
            else:
                r = residuals(calibration, R, p, points, z)
            error, sigma = _normalised(r, information, inliers)
            weight = inliers / (1.0 + (error / (tuning * sigma)) ** 2) ** 2  # Geman-McClure
            normal, gradient = _normal_equations(J, weight * weighted, r)
            step = np.asarray(np.linalg.solve(normal, gradient), dtype=np.float64)
            R, p = so3_exp(step[:3]) @ R, p + step[3:]
            length = float(step @ normal @ step) / sigma**2
            if length < _CONVERGED**2:
                break
        converged = length < _NEARLY**2
        inliers = error < _CUT * sigma
        if np.count_nonzero(inliers) < _FEWEST:
            break
    of_inliers = Residuals(*(of_all[..., inliers] for of_all in (J, information, r, error)))
    contributions = _contributions(of_inliers, observations.variance[inliers], sigma)
    sums = summed(contributions)
    whole = estimated(stacked([sums]), contributions.least)
    covariance = _CORRELATION**2 * whole.covariance[0]
    own = _CORRELATION**2 * own_part(contributions, sums.number, whole)
    in_halves = halves(z[:, inliers], None if newest is None else newest[inliers])
    differences = halves_differences(contributions, sums, in_halves) / _CORRELATION
    return Solution(transform(orthonormalised(R), p), covariance, own, inliers, converged, differences)


class Residuals(NamedTuple):
    """Residuals of n features at a motion."""

    J: FloatArray  # (6, 3, n) derivative by the motion
    information: FloatArray  # (3, 3, n) inverse covariances, up to a scale
    r: FloatArray  # (3, n) [px]
    error: FloatArray  # (n,) normalised


def _contributions(residuals: Residuals, variance: FloatArray, sigma: float) -> Contributions:
    """Contributions of features whose images have a ``variance`` (n, 3), and whose errors scatter by ``sigma``.

    With u = error / c, the robust weight is w = (1 + u^2)^-2. The derivative of w r with respect to r is w I less
    4 / (3 c^2) (1 + u^2)^-3 r r'W.
    """
    J, information, r, error = residuals
    tuned = _TUNING[-1] * sigma
    u = error / tuned
    weight = 1.0 / (1.0 + u**2) ** 2
    weighted = _weighted(J, information)
    score = np.einsum("kjn,jn->kn", weighted, r)
    return Contributions(
        J=J,
        weighted=weight * weighted,
        score=weight * score,
        bend=math.sqrt(4.0 / 3.0) / tuned * (1.0 + u**2) ** -1.5 * score,
        share=np.einsum("iin,ni->n", information, variance) / 3.0,
        least=_FINEST**2,
    )


def _normal_equations(J: FloatArray, weighted: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Matrix (6, 6) and right-hand side (6,) of a Gauss-Newton step, from the Jacobian and its weighted form."""
    A = weighted.reshape(6, -1)
    normal = A @ J.reshape(6, -1).T
    return normal + _DAMPING * np.trace(normal) * np.eye(6), A @ r.ravel()


def _weighted(J: FloatArray, information: FloatArray) -> FloatArray:
    """Jacobian (6, 3, n) times the inverse covariances (3, 3, n)."""
    weighted: FloatArray = np.einsum("kin,ijn->kjn", J, information)
    return weighted


def point_covariance(calibration: StereoCalibration, points: FloatArray, variance: FloatArray) -> FloatArray:
    """Covariance (n, 3, 3) of points triangulated from images with ``variance`` (n, 3) or (3,)."""
    to_point = triangulation_jacobian(calibration, points)
    covariance: FloatArray = (to_point * variance[..., None, :]) @ to_point.transpose(0, 2, 1)
    return covariance


def _information(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, observations: Observations
) -> FloatArray:
    """Inverse covariance (3, 3, n) of the residuals."""
    J = motion_jacobian(calibration, R, p, np.ascontiguousarray(observations.points.T))[
        3:
    ]  # as the derivative by the points, but for the sign
    covariance = np.ascontiguousarray(observations.covariance.transpose(1, 2, 0))
    carried = np.einsum("lin,ljn->ijn", np.einsum("kin,kln->lin", J, covariance), J)
    return _inverse(np.eye(3)[:, :, None] * observations.variance.T + carried)


def _inverse(S: FloatArray) -> FloatArray:
    """Inverses of symmetric matrices (3, 3, n) by their cofactors."""
    one, two = S[_NEXT], S[_AFTER]
    cofactors = one[:, _NEXT] * two[:, _AFTER] - one[:, _AFTER] * two[:, _NEXT]
    inverse: FloatArray = cofactors / (S[0] * cofactors[0]).sum(axis=0)
    return inverse


def _normalised(r: FloatArray, information: FloatArray, inliers: NDArray[np.bool_]) -> tuple[FloatArray, float]:
    """Normalised RMS error (n,) of each match, and its robust standard deviation over the inliers."""
    error = np.sqrt((np.einsum("in,ijn->jn", r, information) * r).sum(axis=0) / 3.0)
    ordered = np.sort(error[inliers])
    median = 0.5 * float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
    return error, max(_FINEST, median / _MEDIAN)
