"""Motion of a stereo pair from matches: robust Gauss-Newton on the reprojection error, with its covariance.

The residual is taken in both current images and weighted with their errors and with those of the points, which go
through into the images. A point and the three image coordinates that it was triangulated from determine each other,
and the way from there to the current images is straight within 1e-4 px of noise, so this is the joint maximum
likelihood of motion and points with the points eliminated (their Schur complement).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.reprojection import linearised, motion_jacobian
from estimators.stereo_geometry import triangulation_jacobian
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray, orthonormalised, so3_exp, transform

_ITERATIONS = 20  # a round, at most; four will mostly do
_CONVERGED = 0.1  # standard deviations that the last step may have been long
_TUNING = (2.0, 1.0)  # a match at so many sigma weighs a quarter; first a wide round, then a narrow one
_CUT = 4.0  # matches beyond so many sigma are no inliers
_CORRELATION = 1.4  # tracking errors of neighbours and of the four images of a point are not independent: measured
_MEDIAN = 0.888  # of the root mean square of three standard normal numbers: sqrt(2.366 / 3)
_FINEST = 0.02  # no tracker is better [px]
_FEWEST = 6  # matches for a solution with something left over to judge it by
_DAMPING = 1e-12  # share of the trace; keeps the solution finite where all matches are alike
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]  # rows and columns of cofactors


class Sightings(NamedTuple):
    """Points known from before, given in P, and their images z = (u left, v, u right) [px] in C."""

    points: FloatArray  # (n, 3) [m]
    covariance: FloatArray  # (n, 3, 3) of the points [m2]
    z: FloatArray  # (n, 3)
    variance: FloatArray  # (n, 3) of z; this and ``covariance`` may have any common scale [px2]


class Solution(NamedTuple):
    """A motion, its covariance (as ``estimates.Motion`` has it) and the matches it rests on."""

    X_PC: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6)
    inliers: NDArray[np.bool_]  # (n,)
    converged: bool


def refined(calibration: StereoCalibration, seen: Sightings, X_PC: FloatArray, inliers: NDArray[np.bool_]) -> Solution:
    """The motion that fits the sightings best, starting from ``X_PC`` and those (n,) that agree with it.

    At least six must agree.
    """
    points, z = np.ascontiguousarray(seen.points.T), np.ascontiguousarray(seen.z.T)
    R, p = X_PC[:3, :3], X_PC[:3, 3]
    information = _information(calibration, R, p, seen)  # hardly depends on the motion
    for tuning in _TUNING:
        for _ in range(_ITERATIONS):
            r, J = linearised(calibration, R, p, points, z)
            error, sigma = _normalised(r, information, inliers)
            weight = inliers / (1.0 + (error / (tuning * sigma)) ** 2) ** 2  # Geman-McClure
            normal, gradient = _normal_equations(J, information, weight, r)
            step = np.asarray(np.linalg.solve(normal, gradient), dtype=np.float64)
            R, p = so3_exp(step[:3]) @ R, p + step[3:]
            converged = bool(step @ normal @ step < (_CONVERGED * sigma) ** 2)
            if converged:
                break
        inliers = error < _CUT * sigma
        if np.count_nonzero(inliers) < _FEWEST:
            break
    normal, _ = _normal_equations(J, information, inliers.astype(np.float64), r)
    covariance = _variance(error[inliers], sigma) * np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return Solution(transform(orthonormalised(R), p), covariance, inliers, converged)


def own_covariance(calibration: StereoCalibration, seen: Sightings, solution: Solution) -> FloatArray:
    """The part (6, 6) of the solution's covariance that comes from the images in C, the points being what they are.

    It is what differs between two frames that see the same points.
    """
    R, p = solution.X_PC[:3, :3], solution.X_PC[:3, 3]
    seen = Sightings(*(of_all[solution.inliers] for of_all in seen))
    J = motion_jacobian(calibration, R, p, np.ascontiguousarray(seen.points.T))
    A = _weighted(J, _information(calibration, R, p, seen))
    normal = A.reshape(6, -1) @ J.reshape(6, -1).T
    own = (A * seen.variance.T).reshape(6, -1) @ A.reshape(6, -1).T
    # covariance = scale inverse(normal); the images' part of inverse(normal) is inverse(normal) own inverse(normal)
    share = np.asarray(np.linalg.solve(normal, own), dtype=np.float64) @ solution.covariance
    symmetric: FloatArray = 0.5 * (share + share.T)
    return symmetric


def _normal_equations(
    J: FloatArray, information: FloatArray, weight: FloatArray, r: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Matrix (6, 6) and right-hand side (6,) of a weighted Gauss-Newton step."""
    A = _weighted(J, weight * information).reshape(6, -1)
    normal = A @ J.reshape(6, -1).T
    return normal + _DAMPING * np.trace(normal) * np.eye(6), A @ r.ravel()


def _weighted(J: FloatArray, information: FloatArray) -> FloatArray:
    """Jacobian (6, 3, n), its rows times the inverse covariances (3, 3, n)."""
    weighted: FloatArray = np.einsum("kin,ijn->kjn", J, information)
    return weighted


def _variance(error: FloatArray, sigma: float) -> float:
    """Factor to the inverse normal matrix without weights, for the estimate with weights (Huber's asymptotics).

    With residuals of three equal components, psi = w r: E[psi psi'] = E[w^2 error^2] I, and the mean slope of psi is
    E[w + (u / 3) dw/du], u = error / (c sigma).
    """
    u_squared = (error / (_TUNING[-1] * sigma)) ** 2
    weight = 1.0 / (1.0 + u_squared) ** 2
    slope = float(np.mean(weight * (1.0 - 4.0 / 3.0 * u_squared / (1.0 + u_squared))))
    spread = float(np.mean((weight * error) ** 2)) * len(error) / (len(error) - 2.0)  # 6 of 3 n are used up
    return _CORRELATION**2 * (_FINEST**2 + spread / slope**2)


def point_covariance(calibration: StereoCalibration, points: FloatArray, variance: FloatArray) -> FloatArray:
    """Covariance (n, 3, 3) of points triangulated from images with ``variance`` (n, 3) or (3,)."""
    to_point = triangulation_jacobian(calibration, points)
    covariance: FloatArray = (to_point * variance[..., None, :]) @ to_point.transpose(0, 2, 1)
    return covariance


def _information(calibration: StereoCalibration, R: FloatArray, p: FloatArray, seen: Sightings) -> FloatArray:
    """Inverse covariance (3, 3, n) of the residuals."""
    J = motion_jacobian(calibration, R, p, np.ascontiguousarray(seen.points.T))[3:]  # as with points, but for the sign
    covariance = np.ascontiguousarray(seen.covariance.transpose(1, 2, 0))
    carried = np.einsum("lin,ljn->ijn", np.einsum("kin,kln->lin", J, covariance), J)
    return _inverse(np.eye(3)[:, :, None] * seen.variance.T + carried)


def _inverse(S: FloatArray) -> FloatArray:
    """Inverses of symmetric matrices (3, 3, n) by their cofactors."""
    one, two = S[_NEXT], S[_AFTER]
    cofactors = one[:, _NEXT] * two[:, _AFTER] - one[:, _AFTER] * two[:, _NEXT]
    inverse: FloatArray = cofactors / (S[0] * cofactors[0]).sum(axis=0)
    return inverse


def _normalised(r: FloatArray, information: FloatArray, inliers: NDArray[np.bool_]) -> tuple[FloatArray, float]:
    """Root mean square error (n,) of each match, and its robust scale over the inliers, one standard deviation [px]."""
    error = np.sqrt((np.einsum("in,ijn->jn", r, information) * r).sum(axis=0) / 3.0)
    ordered = np.sort(error[inliers])
    median = 0.5 * float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
    return error, max(_FINEST, median / _MEDIAN)
