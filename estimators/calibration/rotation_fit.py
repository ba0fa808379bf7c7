"""Estimation of the right camera's rotation from two views some metres apart.

Between two views a yaw error makes all disparities too large or too small: depth from the parallax between the views
and depth from stereo agree for one yaw only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.calibration.right_rotation import RightRotation, sensitivity
from estimators.calibration.rotation_views import FEWEST, Images, bearings, images
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray, inverse, orthonormalised, so3_exp, transform

_ROUNDS = 8  # of Gauss-Newton with new weights, at most
_CONVERGED = 0.05  # last step [standard deviations]
_TUNING = (3.0, 3.0, 3.0, 2.0)  # residual with weight 1/4 [sigma], by round; the last one repeats
_MEDIAN = 0.888  # median of the root mean square of three standard normal numbers: sqrt(2.366 / 3)
_CORRELATION = 2.0  # factor on the variance for correlated errors of neighbours: measured
_SHARED = 1.5  # factor on the variance for errors that views share with the reference view: measured
# Error of a lens model, times the cube of the angle from the axis: 0.6 px at 40 deg. With it, yaw on KITTI's images is
# the same from views 1.5 to 9 m apart; without, points near the edges bias it by 0.01 deg at 1.5 m.
_LENS = 1.5e-3
_FINEST = np.radians(0.001)  # least error of a pair of views [rad]


class RotationFit(NamedTuple):
    """Information on the angles from two views, and the motion between them."""

    information: FloatArray  # (3, 3) on roll, yaw and pitch [1/rad2]
    gradient: FloatArray  # (3,) the information times (measured angles minus those of the prior) [1/rad]
    X_PC: FloatArray  # (4, 4)


def from_motion(
    calibration: StereoCalibration,
    first: Images,
    second: Images,
    X_PC: FloatArray,
    prior: FloatArray,
    covariance: FloatArray,
) -> RotationFit | None:
    """Angles (3,) for which both views fit one rigid motion near ``X_PC``; None if too few points agree.

    ``prior`` (3,) with its ``covariance`` (3, 3) are roll, yaw and pitch before [rad].
    """
    if len(first.left) < FEWEST:
        return None
    X_CP, angles = inverse(X_PC), prior
    R, t = X_CP[:3, :3], X_CP[:3, 3]
    prior_information = np.zeros((9, 9))
    prior_information[6:, 6:] = _inverse(covariance)
    for k in range(_ROUNDS):
        r, J, precision = _residuals(calibration, first, second, R, t, RightRotation(*angles))
        error = np.sqrt(np.einsum("ni,nij,nj->n", r, precision, r) / 3.0)
        scale = max(1.0, float(np.median(error)) / _MEDIAN)
        weight = _weight(error, scale, _TUNING[min(k, len(_TUNING) - 1)]) / (_CORRELATION * scale**2)
        weighted = weight[:, None, None] * (precision @ J)
        normal = np.einsum("nik,nil->kl", J, weighted) + prior_information
        gradient = np.einsum("nik,ni->k", weighted, r)
        gradient[6:] += prior_information[6:, 6:] @ (prior - angles)
        step = np.linalg.solve(normal, gradient)
        R, t, angles = so3_exp(step[:3]) @ R, t + step[3:6], angles + step[6:]
        if k >= len(_TUNING) - 1 and step @ normal @ step < _CONVERGED**2:
            break
    if np.count_nonzero(error < 2.0 * scale) < FEWEST:
        return None
    # the motion eliminated: what is left is information on the angles
    slope = -np.asarray(np.linalg.solve(normal[:6, :6], normal[:6, 6:]), dtype=np.float64)
    information = (normal - prior_information)[6:, 6:] + normal[6:, :6] @ slope
    gradient = (information + prior_information[6:, 6:]) @ (angles - prior)
    less = np.linalg.inv(_SHARED * np.eye(3) + information * _FINEST**2)
    return RotationFit(less @ information, less @ gradient, inverse(transform(orthonormalised(R), t)))


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
    right_P, right_C = first.straight(calibration, rotation), second.straight(calibration, rotation)
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
    covariance = (carried * _with_lens(calibration, first)[:, None, :]) @ carried.transpose(0, 2, 1)
    covariance += np.eye(3) * _with_lens(calibration, second)[:, None, :]
    return z - images(calibration, heads, inverse_depth), J, _inverse(covariance)


def _with_lens(calibration: StereoCalibration, images: Images) -> FloatArray:
    """Variance (n, 3) of images, with the error of the lens model [px2]."""
    c = np.array([calibration.cx, calibration.cy])
    angle = np.hypot(*((images.left - c) / calibration.focal_length).T)
    error = calibration.focal_length * _LENS * angle**3
    variance: FloatArray = images.variance + np.square(error)[:, None] * np.array([1.0, 0.5, 1.0])
    return variance


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
