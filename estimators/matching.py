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
from estimators.stereo_geometry import NEAREST, project, triangulate
from sensors.messages import GreyImage, StereoFrame
from sensors.rig import StereoCalibration
from vehicle.frames import FloatArray

_WINDOW = 11  # [px]; 15 shears more on the ground and doubles the off-tracking error, 9 is not better
_LEVELS = 3  # pyramid levels above the image where the guess may be wrong by some 40 px
_LEVELS_NEAR = 1  # where only the noise of the tracks before is left
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
_FLATTEST = 1e-4  # least eigenvalue of a window that still says where it is
_CLOSURE = 0.6  # the way around must end where it began, within this; 0.3 costs matches in fast turns [px]
_EPIPOLAR = 1.2  # rows in left and right may differ by this: tracking error and 0.1 deg of mis-rotation [px]
_LEAST_DISPARITY = 0.5  # farther points say nothing of the translation, and their depth is skewed [px]
_SCENERY_DEPTH = 30.0  # first guess for what is not ground [m]


class Matches(NamedTuple):
    """Images z = (u left, v, u right) [px] of the same n points in the previous and the current pair."""

    previous: FloatArray  # (n, 3)
    current: FloatArray  # (n, 3)


def match(
    calibration: StereoCalibration, previous: StereoFrame, corners: Points, current: StereoFrame, X_PC: FloatArray
) -> Matches:
    """Corners of the previous left image found in all four images, looked for where the motion ``X_PC`` takes them.

    The way around is previous left, current left, current right, previous right; it must end where the direct way
    from left to right leads.
    """
    left_P, right_P = _stereo_pairs(previous, corners, corners - _disparity_guess(calibration, corners))
    z_P = _images(left_P, right_P)
    guess = _moved(calibration, z_P, X_PC)
    left_C, found = _track(previous.left, current.left, left_P, guess[:, :2], _LEVELS)
    disparity = np.stack([guess[:, 0] - guess[:, 2], np.zeros(len(guess), np.float32)], axis=1)
    right_C, found_right = _track(current.left, current.right, left_C, left_C - disparity, _LEVELS_NEAR)
    closed, found_again = _track(current.right, previous.right, right_C, right_P, _LEVELS_NEAR)
    kept = found & found_right & found_again & _same_row(left_C, right_C)
    kept &= np.linalg.norm(closed - right_P, axis=1) < _CLOSURE
    return Matches(z_P[kept], _images(left_C, right_C)[kept])


def _stereo_pairs(frame: StereoFrame, corners: Points, guess: Points) -> tuple[Points, Points]:
    """The corners of the left image that the right one shows, in both."""
    right, found = _track(frame.left, frame.right, corners, guess, _LEVELS)
    kept = found & _same_row(corners, right)
    return corners[kept], right[kept]


def _disparity_guess(calibration: StereoCalibration, corners: Points) -> Points:
    """Shift (n, 2) [px] between left and right of corners on level ground, or on scenery where that is farther."""
    rays = np.column_stack(
        [(corners - [calibration.cx, calibration.cy]) / calibration.focal_length, np.ones(len(corners))]
    )
    fall = -rays @ calibration.X_SC[2, :3]  # towards the ground, per depth
    inverse_depth = np.maximum(fall / calibration.X_SC[2, 3], 1.0 / _SCENERY_DEPTH)
    shift = calibration.focal_length * calibration.baseline * inverse_depth
    return np.column_stack([shift, np.zeros(len(shift))]).astype(np.float32)


def _moved(calibration: StereoCalibration, z_P: FloatArray, X_PC: FloatArray) -> NDArray[np.float32]:
    """Images (n, 3) after the motion of the points whose images before it were z_P (n, 3)."""
    p_C = (triangulate(calibration, z_P) - X_PC[:3, 3]) @ X_PC[:3, :3]
    p_C[:, 2] = np.maximum(p_C[:, 2], NEAREST)
    return project(calibration, p_C).astype(np.float32)


def _track(
    source: GreyImage, target: GreyImage, points: Points, guess: Points, levels: int
) -> tuple[Points, NDArray[np.bool_]]:
    """Where points of the source appear in the target, near the guess, and whether they were found."""
    if len(points) == 0:
        return points, np.zeros(0, dtype=np.bool_)
    tracked, found, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points,
        guess.copy(),  # overwritten
        winSize=(_WINDOW, _WINDOW),
        maxLevel=levels,
        criteria=_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=_FLATTEST,
    )
    return np.asarray(tracked, dtype=np.float32), np.asarray(found).ravel() > 0


def _same_row(left: Points, right: Points) -> NDArray[np.bool_]:
    """Whether the pairs lie on one epipolar line, with a disparity that places them in front of the cameras."""
    apart = left - right
    one_row: NDArray[np.bool_] = (np.abs(apart[:, 1]) < _EPIPOLAR) & (apart[:, 0] > _LEAST_DISPARITY)
    return one_row


def _images(left: Points, right: Points) -> FloatArray:
    """z (n, 3) of pairs; the row is the mean of the two."""
    return np.column_stack([left[:, 0], 0.5 * (left[:, 1] + right[:, 1]), right[:, 0]]).astype(np.float64)
