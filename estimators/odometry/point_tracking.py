"""Point tracking by pyramidal Lucas-Kanade, from image to image and from the left to the right image of a pair.

Circular matching tracks corners through the previous and current, left and right image, back to the start. It follows
VISO2-S as in de Saxe 2018, section 2.1, steps 1 to 3, with sub-pixel tracks in place of descriptors.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.displaced_right import as_calibrated, displaced, right_shift
from estimators.odometry.corners import Points
from estimators.odometry.local_planes import rays_through
from estimators.stereo_geometry import NEAREST, project, triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray

_CLOSURE = 0.6  # largest distance between start and end of the circle; 0.3 costs matches in fast turns [px]
LEVELS = 3  # pyramid levels above the image, for guesses wrong by up to some 40 px
LEVELS_NEAR = 1  # the same, for guesses wrong by noise alone
_WINDOW = 11  # [px]; 15 shears more on the ground and doubles the off-tracking error, 9 is not better
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
_FLATTEST = 1e-4  # least eigenvalue of a window that can be tracked
_EPIPOLAR = 1.2  # largest difference of the rows in left and right: tracking error and 0.1 deg of mis-rotation [px]
_LEAST_DISPARITY = 0.5  # farther points carry no information on the translation, and their depth is biased [px]
_SCENERY_DEPTH = 30.0  # initial guess of the depth of points above the ground [m]


def track(
    source: GreyImage, target: GreyImage, points: Points, guess: Points, levels: int
) -> tuple[Points, NDArray[np.bool_]]:
    """Track points from the source to the target image, near the guess; the mask (n,) tells which were found."""
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


def stereo_pairs(calibration: StereoCalibration, frame: StereoFrame, corners: Points) -> tuple[Points, Points]:
    """Corners of the left image that are also found in the right one, with their positions in both."""
    guess, shift = corners - disparity_guess(calibration, corners).astype(np.float32), right_shift(frame)
    right, found = track(frame.left, frame.right, corners, displaced(calibration, corners, guess, shift), LEVELS)
    kept = found & same_row(corners, as_calibrated(calibration, corners, right, shift))
    return corners[kept], right[kept]


def same_row(left: Points, right: Points) -> NDArray[np.bool_]:
    """Mask (n,) of pairs on one epipolar line, with a disparity that places them in front of the cameras."""
    difference = left - right
    one_row: NDArray[np.bool_] = (np.abs(difference[:, 1]) < _EPIPOLAR) & (difference[:, 0] > _LEAST_DISPARITY)
    return one_row


def disparity_guess(calibration: StereoCalibration, corners: Points) -> FloatArray:
    """Predicted shift (n, 2) [px] from left to right of corners, on level ground or on nearer scenery."""
    towards_ground = -rays_through(calibration, corners) @ calibration.X_SC[2, :3]  # per unit of depth
    inverse_depth = np.maximum(towards_ground / calibration.X_SC[2, 3], 1.0 / _SCENERY_DEPTH)
    shift = calibration.focal_length * calibration.baseline * inverse_depth
    return np.column_stack([shift, np.zeros(len(shift))])


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
    z_P = _images(left_P, as_calibrated(calibration, left_P, right_P, right_shift(previous)))
    guess = moved(calibration, z_P, X_PC)
    left_C, found = track(previous.left, current.left, left_P, guess[:, :2], LEVELS)
    disparity = np.stack([guess[:, 0] - guess[:, 2], np.zeros(len(guess), np.float32)], axis=1)
    shift = right_shift(current)
    right_guess = displaced(calibration, left_C, left_C - disparity, shift)
    right_C, found_right = track(current.left, current.right, left_C, right_guess, LEVELS_NEAR)
    closed, found_again = track(current.right, previous.right, right_C, right_P, LEVELS_NEAR)
    straight_C = as_calibrated(calibration, left_C, right_C, shift)
    kept = found & found_right & found_again & same_row(left_C, straight_C)
    kept &= np.linalg.norm(closed - right_P, axis=1) < _CLOSURE
    return Matches(z_P[kept], _images(left_C, straight_C)[kept])


def moved(calibration: StereoCalibration, z_P: FloatArray, X_PC: FloatArray) -> NDArray[np.float32]:
    """Predict the images (n, 3) after the motion of points with images z_P (n, 3) before it."""
    p_C = (triangulate(calibration, z_P) - X_PC[:3, 3]) @ X_PC[:3, :3]
    p_C[:, 2] = np.maximum(p_C[:, 2], NEAREST)
    return project(calibration, p_C).astype(np.float32)


def _images(left: Points, right: Points) -> FloatArray:
    """Stereo images z (n, 3) of left and right points; v is the mean of both rows."""
    return np.column_stack([left[:, 0], 0.5 * (left[:, 1] + right[:, 1]), right[:, 0]]).astype(np.float64)
