"""Rotation of the right camera away from its calibration, and its effect on the images.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 4.4: the camera turns about its optical centre, so its image changes by a homography, for any
scene.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.matched_frame import Turned
from sensors.camera.lens import mount_rotation
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage
from vehicle.frames import FloatArray


class RightRotation(NamedTuple):
    """Angles of R_ClCr, the identity as calibrated: about z of the camera, then y, then x (de Saxe 2018, eq. 9)."""

    roll: float  # about z (forward): + clockwise as the camera sees it [rad]
    yaw: float  # about y (down): + to its right [rad]
    pitch: float  # about x (right): + up [rad]

    def named(self) -> Iterator[tuple[str, float]]:
        """Names and angles [rad]."""
        yield from zip(self._fields, self, strict=True)

    def matrix(self) -> FloatArray:
        """R_ClCr (3, 3)."""
        return mount_rotation(*self)


def homography(calibration: StereoCalibration, R_ClCr: FloatArray) -> FloatArray:
    """Homography (3, 3) from the image of the rotated camera to the calibrated one: de Saxe 2018, eq. 8."""
    f, cx, cy = calibration.focal_length, calibration.cx, calibration.cy
    K = np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
    K_inverse = np.array([[1.0 / f, 0.0, -cx / f], [0.0, 1.0 / f, -cy / f], [0.0, 0.0, 1.0]])
    turned: FloatArray = K @ R_ClCr @ K_inverse
    return turned


def straightened(calibration: StereoCalibration, image: GreyImage, R_ClCr: FloatArray) -> GreyImage:
    """Right image warped to the calibrated attitude; edge pixels are repeated."""
    return Turned(image, homography(calibration, R_ClCr)).resampled()


def moved(H: FloatArray, points: FloatArray | NDArray[np.float32]) -> FloatArray:
    """Map points (n, 2) [px] by a homography (3, 3)."""
    homogeneous = points @ H[:, :2].T + H[:, 2]
    flat: FloatArray = homogeneous[:, :2] / homogeneous[:, 2:]
    return flat


def sensitivity(calibration: StereoCalibration, points: FloatArray) -> FloatArray:
    """Derivative (n, 2, 3) [px/rad] of corrected right points (n, 2) with respect to roll, yaw and pitch.

    A ray r becomes r + w x r, so its image (x, y) shifts by the x and y parts minus x and y times the z part.
    """
    x = (points[:, 0] - calibration.cx) / calibration.focal_length
    y = (points[:, 1] - calibration.cy) / calibration.focal_length
    along_u = np.stack([-y, 1.0 + x * x, -x * y], axis=1)
    along_v = np.stack([x, x * y, -(1.0 + y * y)], axis=1)
    return calibration.focal_length * np.stack([along_u, along_v], axis=1)
