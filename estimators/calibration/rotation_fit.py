"""Estimation of the right camera's rotation: roll and pitch from the rows of one view, yaw from two views.

Yaw also shifts the rows, by x y, but so does an error of the lens distortion; the rows are therefore not used for yaw.
Between two views a yaw error makes all disparities too large or too small: depth from the parallax between the views
and depth from stereo agree for one yaw only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.calibration.right_rotation import RightRotation, homography, moved, sensitivity
from estimators.calibration.rotation_views import FEWEST, Images, View, bearings, images
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray, inverse, so3_exp

_ROUNDS = 8  # of Gauss-Newton with new weights; the last ones change the result no more
_TUNING = (3.0, 3.0, 3.0, 2.0)  # residual with weight 1/4 [sigma], by round; the last one repeats
_MEDIAN_1, _MEDIAN_3 = 0.6745, 0.888  # median of |N(0, 1)|, and of the root mean square of three: sqrt(2.366 / 3)
_CORRELATION = 2.0  # factor on the variance for correlated errors of neighbours: measured
_SURPRISE = 9.0  # squared normalised deviation beyond which a measurement loses weight
_TIES = 1e-9 * np.eye(3)  # share of the trace; keeps unobservable components finite


class Estimate(NamedTuple):
    """Estimated roll, yaw and pitch of the right camera."""

    angles: FloatArray  # (3,) [rad]
    covariance: FloatArray  # (3, 3) [rad2]

    @property
    def rotation(self) -> RightRotation:
        """Angles by name."""
        return RightRotation(*self.angles.tolist())


def from_rows(calibration: StereoCalibration, view: View, prior: Estimate) -> Estimate:
    """Estimate updated with roll and pitch from the rows of the view."""
    if len(view.left) < FEWEST:
        return prior
    angles, sigma = prior.angles, np.sqrt(view.variance[:, 1])
    for _ in range(_ROUNDS):
        straight = moved(homography(calibration, RightRotation(*angles)), view.right)
        J = sensitivity(calibration, straight)[:, 1]
        r = view.left[:, 1] - straight[:, 1]
        error = np.abs(r) / sigma
        scale = max(1.0, float(np.median(error)) / _MEDIAN_1)
        weighted = J * (_weight(error, scale, _TUNING[-1]) / sigma**2)[:, None]
        normal = weighted.T @ J
        angles = angles + np.linalg.solve(normal + np.trace(normal) * _TIES, weighted.T @ r)
    information = normal / (_CORRELATION * scale**2)
    by_yaw = information[:, 1]
    return _updated(prior, angles, information - np.outer(by_yaw, by_yaw) / by_yaw[1])


def from_motion(
    calibration: StereoCalibration, first: Images, second: Images, X_PC: FloatArray, prior: Estimate
) -> Estimate | None:
    """Estimate for which both views fit one rigid motion near ``X_PC``; None if too few points agree."""
    if len(first.left) < FEWEST:
        return None
    X_CP, angles = inverse(X_PC), prior.angles
    R, t = X_CP[:3, :3], X_CP[:3, 3]
    prior_information = np.zeros((9, 9))
    prior_information[6:, 6:] = _inverse(prior.covariance)
    for k in range(_ROUNDS):
        r, J, precision = _residuals(calibration, first, second, R, t, RightRotation(*angles))
        error = np.sqrt(np.einsum("ni,nij,nj->n", r, precision, r) / 3.0)
        scale = max(1.0, float(np.median(error)) / _MEDIAN_3)
        weight = _weight(error, scale, _TUNING[min(k, len(_TUNING) - 1)]) / (_CORRELATION * scale**2)
        weighted = weight[:, None, None] * (precision @ J)
        normal = np.einsum("nik,nil->kl", J, weighted) + prior_information
        gradient = np.einsum("nik,ni->k", weighted, r)
        gradient[6:] += prior_information[6:, 6:] @ (prior.angles - angles)
        step = np.linalg.solve(normal, gradient)
        R, t, angles = so3_exp(step[:3]) @ R, t + step[3:6], angles + step[6:]
    if np.count_nonzero(error < 2.0 * scale) < FEWEST:
        return None
    slope = -np.asarray(np.linalg.solve(normal[:6, :6], normal[:6, 6:]), dtype=np.float64)
    information = (normal - prior_information)[6:, 6:] + normal[6:, :6] @ slope
    return _limited(prior, angles, information)


def _limited(prior: Estimate, angles: FloatArray, information: FloatArray) -> Estimate:
    """Estimate from angles fitted with the prior; a surprising one is reached only in part."""
    covariance = _inverse(_inverse(prior.covariance) + information)
    step = angles - prior.angles
    # if the prior is right, the step's covariance is the reduction of the covariance
    surprise = float(step @ np.linalg.pinv(prior.covariance - covariance) @ step) / 3.0
    if surprise <= _SURPRISE:
        return Estimate(angles, covariance)
    less = information * (_SURPRISE / surprise)
    covariance_less = _inverse(_inverse(prior.covariance) + less)
    return Estimate(prior.angles + step * (_SURPRISE / surprise), covariance_less)


def _updated(prior: Estimate, angles: FloatArray, information: FloatArray) -> Estimate:
    """Prior updated with an independent measurement."""
    covariance = _inverse(_inverse(prior.covariance) + information)
    return Estimate(prior.angles + covariance @ information @ (angles - prior.angles), covariance)


def _residuals(
    calibration: StereoCalibration,
    first: Images,
    second: Images,
    R: FloatArray,
    t: FloatArray,
    rotation: RightRotation,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals of the second view: measured images minus those predicted from the first view by the motion R, t.

    Returns the residuals (n, 3) [px], the derivative (n, 3, 9) of predicted minus measured images with respect to the
    motion and the angles, and the inverse covariance (n, 3, 3) of the residuals. The errors of the first images
    propagate through the triangulated point, as in ``estimators.odometry.pose``.
    """
    H = homography(calibration, rotation)
    right_P, right_C = moved(H, first.right), moved(H, second.right)
    rays, inverse_depth = bearings(calibration, first.left, right_P)
    turned = rays @ R.T
    heads = turned + inverse_depth[:, None] * t
    z = np.column_stack([second.left[:, 0], 0.5 * (second.left[:, 1] + right_C[:, 1]), right_C[:, 0]])
    J_h, J_rho = _image_jacobians(calibration, heads, inverse_depth)
    f, along_disparity = calibration.focal_length, (J_h @ t + J_rho) / calibration.baseline
    along_ray = J_h @ R[:, :2]
    carried = np.stack([along_ray[..., 0] + along_disparity, along_ray[..., 1], -along_disparity], axis=2) / f
    by_angles = carried @ _angle_jacobian(calibration, right_P) - _angle_jacobian(calibration, right_C)
    J = np.concatenate([np.cross(turned[:, None, :], J_h), inverse_depth[:, None, None] * J_h, by_angles], axis=2)
    covariance = (carried * first.variance[:, None, :]) @ carried.transpose(0, 2, 1)
    covariance += np.eye(3) * second.variance[:, None, :]
    return z - images(calibration, heads, inverse_depth), J, _inverse(covariance)


def _image_jacobians(
    calibration: StereoCalibration, heads: FloatArray, inverse_depth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of ``images`` with respect to the heads (n, 3, 3) and to the inverse depth (n, 3)."""
    scale = calibration.focal_length / heads[:, 2]
    x_right = heads[:, 0] - calibration.baseline * inverse_depth
    J_h, J_rho = np.zeros((len(heads), 3, 3)), np.zeros((len(heads), 3))
    J_h[:, 0, 0] = J_h[:, 1, 1] = J_h[:, 2, 0] = scale
    J_h[:, :, 2] = -np.column_stack([heads[:, :2], x_right]) * (scale / heads[:, 2])[:, None]
    J_rho[:, 2] = -calibration.baseline * scale
    return J_h, J_rho


def _angle_jacobian(calibration: StereoCalibration, straight: FloatArray) -> FloatArray:
    """Derivative (n, 3, 3) of (u left, v, u right) with respect to the angles; v is the mean of both rows."""
    G = np.zeros((len(straight), 3, 3))
    shift = sensitivity(calibration, straight)
    G[:, 1], G[:, 2] = 0.5 * shift[:, 1], shift[:, 0]
    return G


def _weight(error: FloatArray, scale: float, tuning: float) -> FloatArray:
    """Geman and McClure's weight (n,) of errors with this robust scale."""
    weight: FloatArray = 1.0 / np.square(1.0 + np.square(error / (tuning * scale)))
    return weight


def _inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of matrices (..., m, m)."""
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
