"""Points and their images in a rectified stereo pair: z = (u left, v, u right) [px], p = (x, y, z) in Cl [m].

Points known in the previous camera P are reprojected into the current camera C, linearised in the motion X_PC. The
motion is perturbed as in the covariance of ``estimates.Motion``: R = exp(skew(d_theta)) R_PC, p = p_PC + d_p, both
along the axes of P. Leading axes are several motions at once: R (..., 3, 3) and p (..., 3) with points (..., 3, n).
Components come before points, as NumPy is faster on a few long rows than on many short ones.
"""

from __future__ import annotations

import numpy as np

from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray

NEAREST = 0.5  # least depth of a point [m]; nothing in view is nearer


def triangulate(calibration: StereoCalibration, z: FloatArray) -> FloatArray:
    """Points (..., 3) in the left camera from their images (..., 3) with positive disparity."""
    depth = calibration.focal_length * calibration.baseline / (z[..., 0] - z[..., 2])
    scale = depth / calibration.focal_length
    return np.stack([(z[..., 0] - calibration.cx) * scale, (z[..., 1] - calibration.cy) * scale, depth], axis=-1)


def triangulation_jacobian(calibration: StereoCalibration, p: FloatArray) -> FloatArray:
    """dp/dz (..., 3, 3) of points (..., 3); all coordinates are proportional to 1 / disparity."""
    scale = p[..., 2] / calibration.focal_length
    J = np.zeros((*p.shape, 3))
    J[..., 2] = p * (scale / calibration.baseline)[..., None]
    J[..., 0] = -J[..., 2]
    J[..., 0, 0] += scale
    J[..., 1, 1] = scale
    return J


def project(calibration: StereoCalibration, p: FloatArray) -> FloatArray:
    """Images (..., 3) of points (..., 3) in front of the cameras."""
    scale = calibration.focal_length / p[..., 2]
    z = np.empty_like(p)
    z[..., 0] = p[..., 0] * scale + calibration.cx
    z[..., 1] = p[..., 1] * scale + calibration.cy
    z[..., 2] = z[..., 0] - calibration.baseline * scale
    return z


def _points_in_camera(R: FloatArray, p: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., 3, n), given in P, in the axes of the camera C at R, p in P."""
    points_C: FloatArray = np.swapaxes(R, -1, -2) @ (points - p[..., None])
    points_C[..., 2, :] = np.maximum(points_C[..., 2, :], NEAREST)
    return points_C


def residuals(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray, z: FloatArray
) -> FloatArray:
    """Measured minus predicted images (..., 3, n) [px] of the points after the motion."""
    return z - _images(calibration, _points_in_camera(R, p, points))


def motion_jacobian(calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray) -> FloatArray:
    """Derivative (..., 6, 3, n) of the predicted images with respect to (d_theta, d_p)."""
    return _jacobian(calibration, R, _points_in_camera(R, p, points))


def linearised(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Both ``residuals`` and ``motion_jacobian``."""
    points_C = _points_in_camera(R, p, points)
    return z - _images(calibration, points_C), _jacobian(calibration, R, points_C)


def _images(calibration: StereoCalibration, points_C: FloatArray) -> FloatArray:
    return np.swapaxes(project(calibration, np.swapaxes(points_C, -1, -2)), -1, -2)


def _jacobian(calibration: StereoCalibration, R: FloatArray, points_C: FloatArray) -> FloatArray:
    """Derivative (..., 6, 3, n) of the images of points in C with respect to the motion.

    p_C = R' exp(-skew(d_theta)) (p_P - p - d_p), so d p_C = p_C x R' d_theta - R' d_p.
    """
    x, y, depth = points_C[..., 0, :], points_C[..., 1, :], points_C[..., 2, :]
    f, scale = calibration.focal_length, calibration.focal_length / depth
    # change of the images with depth
    per_depth = points_C.copy()
    per_depth[..., 2, :] = x - calibration.baseline
    per_depth *= (scale / depth)[..., None, :]
    J = np.zeros((*points_C.shape[:-2], 2, 3, 3, points_C.shape[-1]))  # rotation, translation; axis of C; image; point
    turned, shifted = J[..., 0, :, :, :], J[..., 1, :, :, :]
    shifted[..., 0, ::2, :] = shifted[..., 1, 1:2, :] = -scale[..., None, :]
    shifted[..., 2, :, :] = per_depth
    turned[..., 0, :, :] = per_depth * y[..., None, :]  # rows of -shifted x p_C
    turned[..., 0, 1, :] += f
    turned[..., 1, :, :] = -per_depth * x[..., None, :]
    turned[..., 1, ::2, :] -= f
    turned[..., 2, ::2, :] = (scale * y)[..., None, :]
    turned[..., 2, 1, :] = -scale * x
    along_P: FloatArray = R[..., None, :, :] @ J.reshape(*J.shape[:-2], -1)
    return along_P.reshape(*J.shape[:-4], 6, *J.shape[-2:])
