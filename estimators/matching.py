"""Circular matching: corners followed through left and right, previous and current image, and back to themselves.

After VISO2-S as de Saxe 2018, section 2.1, steps 1 to 3 describe it, with sub-pixel tracks (pyramidal Lucas-Kanade)
in place of descriptors.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.features import Points
from estimators.stereo_geometry import project, triangulate
from sensors.messages import GreyImage, StereoFrame
from sensors.rig import StereoCalibration
from vehicle.frames import FloatArray, inverse

_WINDOW = 11  # [px]; larger ones shear more on the ground, smaller ones see more noise
_LEVELS = 3  # pyramid levels above the image: some 40 px of wrong guess are still found
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
_WEAKEST = 1e-4  # least eigenvalue of a window that still says where it is
_CLOSURE = 0.6  # the way around must end where it began [px]
_EPIPOLAR = 1.2  # rows in left and right may differ by this [px]
_LEAST_DISPARITY = 0.5  # beyond some 600 m with a 0.5 m baseline, depth is no more than a guess [px]
_FARTHEST_GUESS = 30.0  # depth of the scenery, where the ground would be farther [m]


class Matches(NamedTuple):
    """Images z = (u left, v, u right) [px] of the same n points in the previous and the current pair."""

    previous: FloatArray  # (n, 3)
    current: FloatArray  # (n, 3)


def match(
    calibration: StereoCalibration, previous: StereoFrame, corners: Points, current: StereoFrame, X_PC: FloatArray
) -> Matches:
    """Corners of the previous left image found in all four, with the predicted motion ``X_PC`` as the first guess."""
    right, seen = _track(previous.left, previous.right, corners, corners - _disparity_guess(calibration, corners))
    seen &= _consistent(corners, right)
    left_P, right_P = corners[seen], right[seen]
    z_P = _stereo(left_P, right_P)
    guess = project(calibration, (triangulate(calibration, z_P) - X_PC[:3, 3]) @ X_PC[:3, :3]).astype(np.float32)
    left_C, a = _track(previous.left, current.left, left_P, guess[:, :2])
    guess_r = left_C - (guess[:, :1]-guess[:, 2:])*np.array([1,0],np.float32)
    right_C, b = _track(current.left, current.right, left_C, guess_r)
    back, c = _track(current.right, previous.right, right_C, right_P)
    ok = a & b & c & (np.abs(back-right_P).max(1)<_CLOSURE) & _consistent(left_C,right_C)
    return Matches(z_P[ok], _stereo(left_C, right_C)[ok])
