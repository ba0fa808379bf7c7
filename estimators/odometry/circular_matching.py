"""Circular matching: corners tracked through the previous and current, left and right image, back to the start.

After VISO2-S as de Saxe 2018, section 2.1, steps 1 to 3 describe it, with sub-pixel tracks (pyramidal Lucas-Kanade)
in place of descriptors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.corners import Points
from estimators.odometry.point_tracking import LEVELS, LEVELS_NEAR, same_row, stereo_pairs, track
from estimators.stereo_geometry import NEAREST, project, triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

_CLOSURE = 0.6  # largest distance between start and end of the circle; 0.3 costs matches in fast turns [px]


class Matches(NamedTuple):
    """Images z = (u left, v, u right) [px] of the same n points in the previous and the current pair."""

    previous: FloatArray  # (n, 3)
    current: FloatArray  # (n, 3)


def match(
    calibration: StereoCalibration, previous: StereoFrame, corners: Points, current: StereoFrame, X_PC: FloatArray
) -> Matches:
    """Match corners of the previous left image through all four images, starting from the predicted motion ``X_PC``.

    The circle is previous left, current left, current right, previous right. It must end where the direct match from
    previous left to previous right lies.
    """
    left_P, right_P = stereo_pairs(calibration, previous, corners)
    z_P = _images(left_P, right_P)
    guess = moved(calibration, z_P, X_PC)
    left_C, found = track(previous.left, current.left, left_P, guess[:, :2], LEVELS)
    disparity = np.stack([guess[:, 0] - guess[:, 2], np.zeros(len(guess), np.float32)], axis=1)
    right_C, found_right = track(current.left, current.right, left_C, left_C - disparity, LEVELS_NEAR)
    closed, found_again = track(current.right, previous.right, right_C, right_P, LEVELS_NEAR)
    kept = found & found_right & found_again & same_row(left_C, right_C)
    kept &= np.linalg.norm(closed - right_P, axis=1) < _CLOSURE
    return Matches(z_P[kept], _images(left_C, right_C)[kept])


def moved(calibration: StereoCalibration, z_P: FloatArray, X_PC: FloatArray) -> NDArray[np.float32]:
    """Predict the images (n, 3) after the motion of points with images z_P (n, 3) before it."""
    p_C = (triangulate(calibration, z_P) - X_PC[:3, 3]) @ X_PC[:3, :3]
    p_C[:, 2] = np.maximum(p_C[:, 2], NEAREST)
    return project(calibration, p_C).astype(np.float32)


def _images(left: Points, right: Points) -> FloatArray:
    """Stereo images z (n, 3) of left and right points; v is the mean of both rows."""
    return np.column_stack([left[:, 0], 0.5 * (left[:, 1] + right[:, 1]), right[:, 0]]).astype(np.float64)
