"""Points followed from image to image by pyramidal Lucas-Kanade, and from the left image of a pair to the right."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.corners import Points
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame

LEVELS = 3  # pyramid levels above the image where the guess may be wrong by some 40 px
LEVELS_NEAR = 1  # where only the noise of the tracks before is left
_WINDOW = 11  # [px]; 15 shears more on the ground and doubles the off-tracking error, 9 is not better
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
_FLATTEST = 1e-4  # least eigenvalue of a window that still says where it is
_EPIPOLAR = 1.2  # rows in left and right may differ by this: tracking error and 0.1 deg of mis-rotation [px]
_LEAST_DISPARITY = 0.5  # farther points say nothing of the translation, and their depth is skewed [px]
_SCENERY_DEPTH = 30.0  # first guess for what is not ground [m]


def track(
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


def exposed_like(image: GreyImage, other: GreyImage) -> GreyImage:
    """The image with the mean and the contrast of another: Lucas-Kanade takes grey levels for what they are."""
    (mean, spread), (other_mean, other_spread) = (
        tuple(float(value[0, 0]) for value in cv2.meanStdDev(one)) for one in (image, other)
    )
    gain = other_spread / spread if spread > 0.0 else 1.0
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain, beta=other_mean - gain * mean), dtype=np.uint8)


def stereo_pairs(calibration: StereoCalibration, frame: StereoFrame, corners: Points) -> tuple[Points, Points]:
    """The corners of the left image that the right one shows, in both."""
    guess = corners - _disparity_guess(calibration, corners)
    right, found = track(frame.left, frame.right, corners, guess, LEVELS)
    kept = found & same_row(corners, right)
    return corners[kept], right[kept]


def same_row(left: Points, right: Points) -> NDArray[np.bool_]:
    """Whether the pairs lie on one epipolar line, with a disparity that places them in front of the cameras."""
    apart = left - right
    one_row: NDArray[np.bool_] = (np.abs(apart[:, 1]) < _EPIPOLAR) & (apart[:, 0] > _LEAST_DISPARITY)
    return one_row


def _disparity_guess(calibration: StereoCalibration, corners: Points) -> Points:
    """Shift (n, 2) [px] between left and right of corners on level ground, or on scenery where that is farther."""
    rays = np.column_stack(
        [(corners - [calibration.cx, calibration.cy]) / calibration.focal_length, np.ones(len(corners))]
    )
    fall = -rays @ calibration.X_SC[2, :3]  # towards the ground, per depth
    inverse_depth = np.maximum(fall / calibration.X_SC[2, 3], 1.0 / _SCENERY_DEPTH)
    shift = calibration.focal_length * calibration.baseline * inverse_depth
    return np.column_stack([shift, np.zeros(len(shift))]).astype(np.float32)
