"""Reprojection of points known in the previous camera P into the current camera C, linearised in the motion X_PC.

The motion is perturbed as ``estimates.Motion`` has its covariance: R = exp(skew(d_theta)) R_PC, p = p_PC + d_p, both
along the axes of P. Leading axes are many motions at once: R (..., 3, 3) and p (..., 3) with points (..., n, 3).
"""

from __future__ import annotations

import numpy as np

from estimators.stereo_geometry import NEAREST, project, projection_jacobian
from sensors.rig import StereoCalibration
from vehicle.frames import FloatArray


def seen_after(R: FloatArray, p: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., n, 3), given in P, from the camera C at R, p in P."""
    points_C: FloatArray = (points - p[..., None, :]) @ R
    points_C[..., 2] = np.maximum(points_C[..., 2], NEAREST)
    return points_C


def residuals(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray, z: FloatArray
) -> FloatArray:
    """Measured minus predicted images (..., n, 3) [px] of the points after the motion."""
    residual: FloatArray = z - project(calibration, seen_after(R, p, points))
    return residual


def motion_jacobian(calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray) -> FloatArray:
    """Derivative (..., n, 3, 6) of the predicted images with respect to (d_theta, d_p).

    p_C = R' exp(-skew(d_theta)) (p_P - p - d_p), so d p_C = R' (skew(p_P - p) d_theta - d_p).
    """
    J_P = projection_jacobian(calibration, seen_after(R, p, points)) @ np.swapaxes(R, -1, -2)[..., None, :, :]
    arm = (points - p[..., None, :])[..., None, :]
    return np.concatenate([np.cross(J_P, arm), -J_P], axis=-1)  # row . (skew(a) w) = (row x a) . w
