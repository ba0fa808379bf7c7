"""Point tracking by pyramidal Lucas-Kanade, from image to image and from the left to the right image of a pair."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.corners import Points
from estimators.odometry.local_planes import rays_through
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray

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


def exposed_like(image: GreyImage, other: GreyImage) -> GreyImage:
    """Image adapted to the mean and contrast of another, as Lucas-Kanade assumes constant brightness."""
    (mean, spread), (other_mean, other_spread) = (
        tuple(float(value[0, 0]) for value in cv2.meanStdDev(one)) for one in (image, other)
    )
    gain = other_spread / spread if spread > 0.0 else 1.0
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain, beta=other_mean - gain * mean), dtype=np.uint8)


def stereo_pairs(calibration: StereoCalibration, frame: StereoFrame, corners: Points) -> tuple[Points, Points]:
    """Corners of the left image that are also found in the right one, with their positions in both."""
    guess = corners - disparity_guess(calibration, corners).astype(np.float32)
    right, found = track(frame.left, frame.right, corners, guess, LEVELS)
    kept = found & same_row(corners, right)
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
