"""Pose of the right camera from the epipolar geometry of single pairs, in every frame.

A point on the rays r in the left and q in the right camera, both along the axes of the left one, has
q . (B x r) = 0 with the right camera at B = (b, 0, s). The rows of a pair thus determine the rotation of the right
camera and its displacement s along the optical axis, whatever the depths. A displacement along the baseline has no such
effect.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from estimators.calibration.right_rotation import homography, moved
from estimators.displaced_right import displaced
from estimators.odometry.corners import Points, detect_corners
from estimators.odometry.point_tracking import disparity_guess, track
from sensors.camera.lens import mount_rotation
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray

_PER_BUCKET = 4  # corners in the halved image; some 200 on an ordinary road, whose scatter is below the other errors
_LEVELS = 3  # pyramid levels above the halved image, for guesses wrong by up to some 80 px of the full image
_FEWEST = 40  # points; four unknowns, and some points are matched wrongly
_FEWEST_AGREEING = 0.4  # share of the points
_ROUNDS = 12  # of Gauss-Newton with new weights, at most
_DONE = 1e-5  # largest last step; the next ones would add 4e-5 deg and 5 um
_TUNING = 3.0  # residual with weight 1/4 [robust standard deviations]
_MEDIAN = 0.6745  # median of |N(0, 1)|
_FINEST = 0.05  # least robust standard deviation of a row difference [px]
_ROUGHEST = 1.5  # largest one: beyond it the matches do not belong to one pair of cameras [px]
_LEAST_INFORMATION = 1e-9  # least information of an unknown, as a share of the largest


class EpipolarFit(NamedTuple):
    """Roll, yaw, pitch [rad] of the right camera and its displacement along the optical axis [m], from one pair."""

    values: FloatArray  # (4,)
    covariance: FloatArray  # (4, 4) by the scatter of the rows
    scatter: float  # robust standard deviation of the rows [px]


def epipolar_fit(
    calibration: StereoCalibration, frame: StereoFrame, guess: FloatArray, shift: FloatArray
) -> EpipolarFit | None:
    """Fit to the corners of a pair, from the expected values (4,) and position ``shift`` (3,) [m] of the right camera.

    The images are matched at half size, in 3 ms. None if too few points agree.
    """
    left, right_half = _halved(frame.left), _halved(frame.right)
    at_half = _between(detect_corners(left, per_bucket=_PER_BUCKET))
    corners = _doubled(at_half)
    if len(corners) < _FEWEST:
        return None
    R, f = mount_rotation(*guess[:3].tolist()), calibration.focal_length
    expected = displaced(calibration, corners, corners - disparity_guess(calibration, corners), shift)
    raw = moved(homography(calibration, R.T), expected).astype(np.float32)
    right, found = track(left, right_half, at_half, _half(raw), _LEVELS)
    centre = np.array([calibration.cx, calibration.cy])
    left_rays = (corners[found].astype(np.float64) - centre) / f
    right_rays = (_doubled(right[found]).astype(np.float64) - centre) / f
    return fitted_to_rays(calibration, left_rays, right_rays, guess, shift)


def fitted_to_rays(
    calibration: StereoCalibration, r: FloatArray, q: FloatArray, guess: FloatArray, shift: FloatArray
) -> EpipolarFit | None:
    """Robust least squares over left and right rays (n, 2) of depth 1; the other arguments are as above."""
    if len(r) < _FEWEST:
        return None
    f, baseline, values = calibration.focal_length, calibration.baseline + shift[0], guess.copy()
    (x, y), columns = np.ascontiguousarray(r.T), np.ascontiguousarray(q.T)
    across, middle = shift[1] / baseline, len(r) // 2
    for _ in range(_ROUNDS):
        R, s = mount_rotation(*values[:3].tolist()), values[3] / baseline
        turned = R[:, :2] @ columns + R[:, 2:]
        x_q, y_q = turned[:2] / turned[2]
        by_s = x * y_q - y * x_q
        e = y_q - y - s * by_s - across * (x_q - x)
        e_x, e_y = s * y - across, 1.0 - s * x  # derivatives by the turned ray
        # Sampson's distance: the residual over its sensitivity to all four coordinates, as that of a row difference
        size = np.sqrt(0.5 * (e_x**2 + e_y**2 + (across - s * y_q) ** 2 + (1.0 - s * x_q) ** 2))
        along = e_x * x_q + e_y * y_q
        J = np.stack([e_y * x_q - e_x * y_q, e_x + along * x_q, -e_y - along * y_q, -by_s / baseline]) / size
        distance = e / size
        scale = max(_FINEST / f, float(np.partition(np.abs(distance), middle)[middle]) / _MEDIAN)
        weighted = J / np.square(1.0 + np.square(distance / (_TUNING * scale)))
        normal = weighted @ J.T
        normal += _LEAST_INFORMATION * np.trace(normal) * np.eye(4)
        step = np.asarray(np.linalg.solve(normal, weighted @ distance), dtype=np.float64)
        values = values - step
        if np.abs(step).max() < _DONE:
            break
    agreeing = np.count_nonzero(np.abs(distance) < _TUNING * scale)
    if not scale * f <= _ROUGHEST or agreeing < max(_FEWEST, _FEWEST_AGREEING * len(r)):
        return None
    return EpipolarFit(values, scale**2 * np.asarray(np.linalg.inv(normal), dtype=np.float64), scale * f)


def _halved(image: GreyImage) -> GreyImage:
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _between(corners: Points) -> Points:
    """Corners moved by a quarter pixel, in turn to all four sides.

    Whole pixels of the left image would be compared with interpolated ones of the right. Such matches are drawn towards
    whole pixels: the angles come out 6 % too small. To one side alone, they are drawn to that side.
    """
    sides = np.array([[0.25, 0.25], [-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25]], dtype=np.float32)
    return corners + np.resize(sides, corners.shape)


def _doubled(points: Points) -> Points:
    """Points of the halved image in the full one."""
    return 2.0 * points + np.float32(0.5)


def _half(points: Points) -> Points:
    """Points in the image of half the size."""
    return 0.5 * (points - np.float32(0.5))
