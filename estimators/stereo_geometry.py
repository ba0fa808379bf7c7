"""Points and their images in a rectified stereo pair: z = (u left, v, u right) [px], p = (x, y, z) in Cl [m]."""

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
