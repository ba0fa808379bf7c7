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

from estimators.odometry.self_consistency import halves_differences
from estimators.stereo_geometry import linearised, motion_jacobian, residuals, triangulation_jacobian
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray, orthonormalised, so3_exp, transform

_ITERATIONS = 40  # at most, in each round; usually four are enough, but many features near the cut make it slow
_CONVERGED = 0.1  # step at which a round ends [standard deviations]
_NEARLY = 0.5  # largest last step of a motion that counts as converged [standard deviations]
_FAR = 10.0  # step beyond which the Jacobian is computed anew within a round: 1 cm at 5 m [standard deviations]
_TUNING = (2.0, 1.0)  # residual with weight 1/4, in sigma, for the wide and the narrow round
_CUT = 4.0  # inliers have smaller residuals [sigma]
_CORRELATION = 1.4  # factor for correlated errors of neighbours and of the four images of a point: measured
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
    differences: FloatArray  # (2, 6) between halves of the features, as in ``self_consistency``


def refined(
    calibration: StereoCalibration, observations: Observations, X_PC: FloatArray, inliers: NDArray[np.bool_]
) -> Solution:
    """Robust least-squares motion for the observations, starting from ``X_PC`` and its ``inliers`` (n,), at least 6."""
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
    J, weighted = J[:, :, inliers], weighted[:, :, inliers]
    normal, _ = _normal_equations(J, weighted, r[:, inliers])
    variance, slope = _variance(error[inliers], sigma)
    covariance = variance * np.asarray(np.linalg.inv(normal), dtype=np.float64)
    robust = (weight * r / slope)[:, inliers]
    differences = halves_differences(J, weighted, robust, z[:, inliers], variance)
    own = _own_covariance(weighted, observations.variance[inliers], normal, covariance)
    return Solution(transform(orthonormalised(R), p), covariance, own, inliers, converged, differences)


def _own_covariance(
    weighted: FloatArray, variance: FloatArray, normal: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Part (6, 6) of a solution's covariance by the ``variance`` (n, 3) of the images in C alone.

    covariance = scale inverse(normal); the images' part of inverse(normal) is inverse(normal) own inverse(normal).
    """
    own = (weighted * variance.T).reshape(6, -1) @ weighted.reshape(6, -1).T
    share = np.asarray(np.linalg.solve(normal, own), dtype=np.float64) @ covariance
    symmetric: FloatArray = 0.5 * (share + share.T)
    return symmetric


def _normal_equations(J: FloatArray, weighted: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Matrix (6, 6) and right-hand side (6,) of a Gauss-Newton step, from the Jacobian and its weighted form."""
    A = weighted.reshape(6, -1)
    normal = A @ J.reshape(6, -1).T
    return normal + _DAMPING * np.trace(normal) * np.eye(6), A @ r.ravel()


def _weighted(J: FloatArray, information: FloatArray) -> FloatArray:
    """Jacobian (6, 3, n) times the inverse covariances (3, 3, n)."""
    weighted: FloatArray = np.einsum("kin,ijn->kjn", J, information)
    return weighted


def _variance(error: FloatArray, sigma: float) -> tuple[float, float]:
    """Factor from the inverse of the unweighted normal matrix to the covariance of the robust estimate (Huber).

    Also the mean slope of the robust residual, by which it is smaller than the residual.

    With residuals of three equal components, psi = w r: E[psi psi'] = E[w^2 error^2] I, and the mean slope of psi is
    E[w + (u / 3) dw/du], u = error / (c sigma).
    """
    u_squared = (error / (_TUNING[-1] * sigma)) ** 2
    weight = 1.0 / (1.0 + u_squared) ** 2
    slope = float(np.mean(weight * (1.0 - 4.0 / 3.0 * u_squared / (1.0 + u_squared))))
    spread = float(np.mean((weight * error) ** 2)) * len(error) / (len(error) - 2.0)  # 6 degrees of freedom of 3 n
    return _CORRELATION**2 * (_FINEST**2 + spread / slope**2), slope


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
