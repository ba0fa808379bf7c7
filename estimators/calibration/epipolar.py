"""Rotation of the right camera, and its pose from the epipolar geometry of single pairs.

A point on the rays r in the left and q in the right camera, both along the axes of the left one, has
q . (B x r) = 0 with the right camera at B = (b, 0, s). The rows of a pair thus determine the rotation of the right
camera and its displacement s along the optical axis, whatever the depths. A displacement along the baseline has no such
effect.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 4.4: the camera turns about its optical centre, so its image changes by a homography, for any
scene.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.image_points import (
    detect_corners,
    disparity_guess,
    half_size,
    in_full,
    in_half,
    rays_through,
    track,
)
from estimators.stereo_pair import Points, Turned, displaced
from sensors.camera.rig import StereoCalibration, mount_rotation
from sensors.messages import GreyImage, StereoFrame
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
    return homogeneous[:, :2] / homogeneous[:, 2:]


def sensitivity(calibration: StereoCalibration, points: FloatArray) -> FloatArray:
    """Derivative (n, 2, 3) [px/rad] of corrected right points (n, 2) with respect to roll, yaw and pitch.

    A ray r becomes r + w x r, so its image (x, y) shifts by the x and y parts minus x and y times the z part.
    """
    x = (points[:, 0] - calibration.cx) / calibration.focal_length
    y = (points[:, 1] - calibration.cy) / calibration.focal_length
    along_u = np.stack([-y, 1.0 + x * x, -x * y], axis=1)
    along_v = np.stack([x, x * y, -(1.0 + y * y)], axis=1)
    return calibration.focal_length * np.stack([along_u, along_v], axis=1)


_PER_BUCKET = 4  # corners in the halved image; some 200 on an ordinary road, whose scatter is below the other errors
_LEVELS = 3  # pyramid levels above the halved image, for guesses wrong by up to some 80 px of the full image
_FEWEST = 40  # points; four unknowns, and some points are matched wrongly
_FEWEST_AGREEING = 0.4  # share of the points
_ROUNDS = 12  # of Gauss-Newton with new weights, at most
_LINEAR = 1e-3  # step beyond which the distances are computed anew: its square is a thousandth of a pixel [rad, m]
_DONE = 0.3  # last step [standard deviations of the fit]
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
    left, right_half = half_size(frame.left), half_size(frame.right)
    at_half = _between(detect_corners(left, per_bucket=_PER_BUCKET))
    corners = in_full(at_half)
    if len(corners) < _FEWEST:
        return None
    R = mount_rotation(*guess[:3].tolist())
    expected = displaced(calibration, corners, corners - disparity_guess(calibration, corners), shift)
    raw = moved(homography(calibration, R.T), expected).astype(np.float32)
    right, found = track(left, right_half, at_half, in_half(raw), _LEVELS)
    r, q = (rays_through(calibration, points[found])[:, :2] for points in (corners, in_full(right)))
    return fitted_to_rays(calibration, r, q, guess, shift)


def fitted_to_rays(
    calibration: StereoCalibration, r: FloatArray, q: FloatArray, guess: FloatArray, shift: FloatArray
) -> EpipolarFit | None:
    """Robust least squares over left and right rays (n, 2) of depth 1; the other arguments are as above."""
    if len(r) < _FEWEST:
        return None
    f, baseline, values = calibration.focal_length, calibration.baseline + shift[0], guess.copy()
    (x, y), columns = np.ascontiguousarray(r.T), np.ascontiguousarray(q.T)
    across, middle = shift[1] / baseline, len(r) // 2
    step = np.full(4, np.inf)
    for _ in range(_ROUNDS):
        if np.abs(step).max() > _LINEAR:
            R, s = mount_rotation(*values[:3].tolist()), values[3] / baseline
            turned = R[:, :2] @ columns + R[:, 2:]
            x_q, y_q = turned[:2] / turned[2]
            by_s = x * y_q - y * x_q
            e = y_q - y - s * by_s - across * (x_q - x)
            e_x, e_y = s * y - across, 1.0 - s * x  # derivatives by the turned ray
            # Sampson's distance: the residual over its sensitivity to all four coordinates, as of a row difference
            size = np.sqrt(0.5 * (e_x**2 + e_y**2 + (across - s * y_q) ** 2 + (1.0 - s * x_q) ** 2))
            along = e_x * x_q + e_y * y_q
            J = np.stack([e_y * x_q - e_x * y_q, e_x + along * x_q, -e_y - along * y_q, -by_s / baseline]) / size
            distance = e / size
        else:
            distance = distance - step @ J
        scale = max(_FINEST / f, float(np.partition(np.abs(distance), middle)[middle]) / _MEDIAN)
        weighted = J / np.square(1.0 + np.square(distance / (_TUNING * scale)))
        normal = weighted @ J.T
        normal += _LEAST_INFORMATION * np.trace(normal) * np.eye(4)
        step = np.asarray(np.linalg.solve(normal, weighted @ distance), dtype=np.float64)
        values = values - step
        if step @ normal @ step < (_DONE * scale) ** 2:
            break
    agreeing = np.count_nonzero(np.abs(distance) < _TUNING * scale)
    if not scale * f <= _ROUGHEST or agreeing < max(_FEWEST, _FEWEST_AGREEING * len(r)):
        return None
    return EpipolarFit(values, scale**2 * np.asarray(np.linalg.inv(normal), dtype=np.float64), scale * f)


def _between(corners: Points) -> Points:
    """Corners moved by a quarter pixel, in turn to all four sides.

    Whole pixels of the left image would be compared with interpolated ones of the right. Such matches are drawn towards
    whole pixels: the angles come out 6 % too small. To one side alone, they are drawn to that side.
    """
    sides = np.array([[0.25, 0.25], [-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25]], dtype=np.float32)
    return corners + np.resize(sides, corners.shape)
