"""Estimation of the right camera's rotation from two stereo views some metres apart.

Between two views a yaw error makes all disparities too large or too small: depth from the parallax between the views
and depth from stereo agree for one yaw only.

Raw images are matched and only the matched points are corrected, so that a better estimate of the rotation applies to
older views as well.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.calibration.epipolar import RightRotation, homography, moved, sensitivity
from estimators.calibration.mount_state import PairGeometry
from estimators.odometry.image_points import (
    LEVELS,
    LEVELS_NEAR,
    detect_corners,
    disparity_guess,
    local_planes,
    rays_through,
    track_halved,
    warps,
)
from estimators.odometry.warped_matching import MARGIN, match_patches
from estimators.stereo_pair import Points, as_calibrated, displaced, right_position
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, inverse, orthonormalised, so3_exp, transform

FEWEST = 25  # points; fewer may agree by chance
_PER_BUCKET = 2  # corners; 250 to 350 points on an ordinary road
_PER_BUCKET_CLIPPED = 8  # the same in clipped images: without clouds, which tell yaw at once, it takes more points
_CLOSURE = 0.6  # largest distance between start and end of the track from left to right and back [px]
_LEAST_CORRELATION = 0.8  # of two patches, normalised
_MOVED = 2.5  # largest distance of the warped match from the tracked point [px]
_FINEST_PATCH = 0.03  # least error of a patch: sampling and interpolation, measured on rendered frames [px]
_SAME_ROW = 1.5  # largest difference of the rows, beyond the uncertainty of the rotation [px]
_FARTHEST = -1.0  # least disparity: those of distant points scatter about 0 [px]
_AHEAD = 0.1  # least disparity for a point's plane, so that it lies ahead of the camera [px]
_NEAREST = 1.0  # [m]


class View(NamedTuple):
    """Stereo pair with n points visible in both raw images."""

    image: GreyImage  # left
    left: Points  # (n, 2) [px]
    right: Points  # (n, 2) in the raw right image [px]
    variance: FloatArray  # (n, 2) of u and v from left to right [px2]
    planes: FloatArray  # (n, 3) around the points: n . X = 1 [1/m]
    geometry: PairGeometry


class Images(NamedTuple):
    """Images of n points in a stereo pair."""

    left: Points  # (n, 2) [px]
    right: Points  # (n, 2) in the raw right image [px]
    variance: FloatArray  # (n, 3) of u left, mean v, u right [px2]
    geometry: PairGeometry

    def straight(self, calibration: StereoCalibration, rotation: RightRotation) -> FloatArray:
        """Right images (n, 2) of a camera as calibrated."""
        return straight(calibration, self.left, self.right, self.geometry, rotation)


def straight(
    calibration: StereoCalibration, left: Points, right: Points, geometry: PairGeometry, rotation: RightRotation
) -> FloatArray:
    """Images (n, 2) in a camera as calibrated of points with these left and raw right images."""
    turned = moved(homography(calibration, geometry.attitude(rotation)), right)
    return as_calibrated(calibration, left, turned, geometry.shift)


def raw(
    calibration: StereoCalibration, left: Points, right: FloatArray, geometry: PairGeometry, rotation: RightRotation
) -> Points:
    """Raw right images (n, 2) of points with these left and straight right images."""
    seen = displaced(calibration, left, right, geometry.shift)
    return moved(homography(calibration, geometry.attitude(rotation).T), seen).astype(np.float32)


def new_view(
    calibration: StereoCalibration,
    frame: StereoFrame,
    geometry: PairGeometry,
    rotation: RightRotation,
    doubt: float,
    rng: np.random.Generator,
    *,
    clipped: bool = False,
) -> View:
    """View of a frame; ``doubt`` is the standard deviation of the rotation [rad].

    A view for ``clipped`` images has more points.
    """
    left, right = _pairs(calibration, frame, geometry, rotation, doubt, _PER_BUCKET_CLIPPED if clipped else _PER_BUCKET)
    as_straight = straight(calibration, left, right, geometry, rotation)
    disparity = np.maximum(left[:, 0] - as_straight[:, 0], _AHEAD)
    planes = local_planes(calibration, left, disparity, rng)
    bent = warps(np.eye(3), -right_position(calibration, geometry.shift), planes, rays_through(calibration, left))
    matched = match_patches([(frame.left, len(left))], left, bent, frame.right, right)
    kept = (matched.correlation > _LEAST_CORRELATION) & (_longest(matched.points - right) < _MOVED)
    variance = matched.variance[kept].astype(np.float64) + _FINEST_PATCH**2
    return View(frame.left, left[kept], matched.points[kept], variance, planes[kept], geometry)


def rematched(
    calibration: StereoCalibration,
    view: View,
    frame: StereoFrame,
    geometry: PairGeometry,
    X_PC: FloatArray,
    rotation: RightRotation,
) -> tuple[Images, Images]:
    """Images of common points in the view and in a later frame, with its geometry, at about ``X_PC`` from it."""
    X_CP = inverse(X_PC)
    R, t = X_CP[:3, :3], X_CP[:3, 3]
    rays, inverse_depth = bearings(
        calibration, view.left, straight(calibration, view.left, view.right, view.geometry, rotation)
    )
    heads = rays @ R.T + inverse_depth[:, None] * t
    z = images(calibration, heads, inverse_depth)
    shown = np.flatnonzero(_inside(calibration, z) & (heads[:, 2] > _NEAREST * inverse_depth) & (heads[:, 2] > 0.0))
    predicted = z[shown].astype(np.float32)
    centres, planes, rays = view.left[shown], view.planes[shown], rays[shown]
    t_sides = np.stack([t, t - right_position(calibration, geometry.shift)])[:, None]
    to_left, to_right = warps(R, t_sides, planes, rays)
    source = [(view.image, len(shown))]
    left = match_patches(source, centres, to_left, frame.left, predicted[:, :2])
    shift = left.points - predicted[:, :2]
    guess = raw(calibration, predicted[:, :2] + shift, predicted[:, [2, 1]] + shift, geometry, rotation)
    right = match_patches(source, centres, to_right, frame.right, guess)
    kept = (left.correlation > _LEAST_CORRELATION) & (right.correlation > _LEAST_CORRELATION)
    kept &= _longest(right.points - guess) < _MOVED
    kept &= np.isfinite(straight(calibration, left.points, right.points, geometry, rotation)).all(axis=1)
    index = shown[kept]
    # the view's left image defines its points, up to sampling; the mean of two rows has half the variance
    own, across = np.full(len(index), _FINEST_PATCH**2), view.variance[index]
    a, b = left.variance[kept] + _FINEST_PATCH**2, right.variance[kept] + _FINEST_PATCH**2
    stereo = np.column_stack([own, 0.25 * across[:, 1], across[:, 0]])
    first = Images(view.left[index], view.right[index], stereo, view.geometry)
    variance = np.column_stack([a[:, 0], 0.25 * (a[:, 1] + b[:, 1]), b[:, 0]]).astype(np.float64)
    return first, Images(left.points[kept], right.points[kept], variance, geometry)


def bearings(calibration: StereoCalibration, left: Points, straight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rays (n, 3) of depth 1 and inverse depths (n,) [1/m] of points from their left and straightened right images."""
    f = calibration.focal_length
    x, y = (left[:, 0] - calibration.cx) / f, (0.5 * (left[:, 1] + straight[:, 1]) - calibration.cy) / f
    return np.column_stack([x, y, np.ones(len(x))]), (left[:, 0] - straight[:, 0]) / (f * calibration.baseline)


def images(calibration: StereoCalibration, heads: FloatArray, inverse_depth: FloatArray) -> FloatArray:
    """Images (u left, v, u right) (n, 3) of points at heads / inverse_depth in the left camera, infinity included."""
    scale = calibration.focal_length / heads[:, 2]
    x_right = heads[:, 0] - calibration.baseline * inverse_depth
    u, u_right = heads[:, 0] * scale + calibration.cx, x_right * scale + calibration.cx
    return np.column_stack([u, heads[:, 1] * scale + calibration.cy, u_right])


def _pairs(
    calibration: StereoCalibration,
    frame: StereoFrame,
    geometry: PairGeometry,
    rotation: RightRotation,
    doubt: float,
    per_bucket: int,
) -> tuple[Points, Points]:
    """Corners in the left and the raw right image that track there and back."""
    corners = detect_corners(frame.left, per_bucket=per_bucket)
    guess = raw(calibration, corners, corners - disparity_guess(calibration, corners), geometry, rotation)
    right, found = track_halved(frame.left, frame.right, corners, guess, LEVELS)
    back, found_again = track_halved(frame.right, frame.left, right, corners, LEVELS_NEAR)
    apart = corners - straight(calibration, corners, right, geometry, rotation)
    doubtful = 3.0 * doubt * calibration.focal_length
    kept = found & found_again & (_longest(back - corners) < _CLOSURE)
    # not a number near the epipole of a displaced camera: neither comparison holds
    kept &= (np.abs(apart[:, 1]) < _SAME_ROW + doubtful) & (apart[:, 0] > _FARTHEST - doubtful)
    return corners[kept], right[kept]


def _inside(calibration: StereoCalibration, z: FloatArray) -> NDArray[np.bool_]:
    """Mask (n,) of images z (n, 3) whose patches lie inside both pictures."""
    high = np.array([calibration.width, calibration.height, calibration.width]) - 1 - MARGIN
    return np.asarray(((z > MARGIN) & (z < high)).all(axis=1), dtype=np.bool_)


def _longest(shift: NDArray[np.floating]) -> NDArray[np.floating]:
    """Larger component (n,) of shifts (n, 2)."""
    longest: NDArray[np.floating] = np.abs(shift).max(axis=1, initial=0.0)
    return longest


_ROUNDS = 8  # of Gauss-Newton with new weights, at most
_CONVERGED = 0.2  # last step [standard deviations]
_TUNING = (3.0, 3.0, 3.0, 2.0)  # residual with weight 1/4 [sigma], by round; the last one repeats
_MEDIAN = 0.888  # median of the root mean square of three standard normal numbers: sqrt(2.366 / 3)
_CORRELATION = 2.0  # factor on the variance for correlated errors of neighbours: measured
_SHARED = 1.5  # factor on the variance for errors that views share with the reference view: measured
# Error of a lens model, times the cube of the angle from the axis: 0.6 px at 40 deg. With it, yaw on KITTI's images is
# the same from views 1.5 to 9 m apart; without, points near the edges bias it by 0.01 deg at 1.5 m.
_LENS = 1.5e-3
_FINEST = np.radians(0.001)  # least error of a pair of views [rad]


class RotationFit(NamedTuple):
    """Information on the angles from two views, and the motion between them."""

    information: FloatArray  # (3, 3) on roll, yaw and pitch [1/rad2]
    gradient: FloatArray  # (3,) the information times (measured angles minus those of the prior) [1/rad]
    X_PC: FloatArray  # (4, 4)


def from_motion(
    calibration: StereoCalibration,
    first: Images,
    second: Images,
    X_PC: FloatArray,
    prior: FloatArray,
    covariance: FloatArray,
) -> RotationFit | None:
    """Angles (3,) for which both views fit one rigid motion near ``X_PC``; None if too few points agree.

    ``prior`` (3,) with its ``covariance`` (3, 3) are roll, yaw and pitch before [rad].
    """
    if len(first.left) < FEWEST:
        return None
    X_CP, angles = inverse(X_PC), prior
    R, t = X_CP[:3, :3], X_CP[:3, 3]
    prior_information = np.zeros((9, 9))
    prior_information[6:, 6:] = np.linalg.inv(covariance)
    for k in range(_ROUNDS):
        r, J, precision = _residuals(calibration, first, second, R, t, RightRotation(*angles))
        error = np.sqrt(np.vecdot(r, (precision @ r[..., None])[..., 0]) / 3.0)
        scale = max(1.0, float(np.median(error)) / _MEDIAN)
        normalised = error / (_TUNING[min(k, len(_TUNING) - 1)] * scale)
        weight = 1.0 / np.square(1.0 + np.square(normalised)) / (_CORRELATION * scale**2)  # Geman and McClure
        weighted = (weight[:, None, None] * (precision @ J)).reshape(-1, 9)
        normal = weighted.T @ J.reshape(-1, 9) + prior_information
        gradient = weighted.T @ r.ravel()
        gradient[6:] += prior_information[6:, 6:] @ (prior - angles)
        step = np.linalg.solve(normal, gradient)
        R, t, angles = so3_exp(step[:3]) @ R, t + step[3:6], angles + step[6:]
        if k >= len(_TUNING) - 1 and step @ normal @ step < _CONVERGED**2:
            break
    if np.count_nonzero(error < 2.0 * scale) < FEWEST:
        return None
    # the motion eliminated: what is left is information on the angles
    slope = -np.asarray(np.linalg.solve(normal[:6, :6], normal[:6, 6:]), dtype=np.float64)
    information = (normal - prior_information)[6:, 6:] + normal[6:, :6] @ slope
    gradient = (information + prior_information[6:, 6:]) @ (angles - prior)
    less = np.linalg.inv(_SHARED * np.eye(3) + information * _FINEST**2)
    return RotationFit(less @ information, less @ gradient, inverse(transform(orthonormalised(R), t)))


def _residuals(
    calibration: StereoCalibration,
    first: Images,
    second: Images,
    R: FloatArray,
    t: FloatArray,
    rotation: RightRotation,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals of the second view: measured images minus those predicted from the first view by the motion R, t.

    Returns the residuals (n, 3) [px], the derivative (n, 3, 9) of predicted minus measured images with respect to the
    motion and the angles, and the inverse covariance (n, 3, 3) of the residuals. The errors of the first images
    propagate through the triangulated point, as in ``estimators.odometry.pose``.
    """
    right_P, right_C = first.straight(calibration, rotation), second.straight(calibration, rotation)
    rays, inverse_depth = bearings(calibration, first.left, right_P)
    turned = rays @ R.T
    heads = turned + inverse_depth[:, None] * t
    z = np.column_stack([second.left[:, 0], 0.5 * (second.left[:, 1] + right_C[:, 1]), right_C[:, 0]])
    J_h, J_rho = _image_jacobians(calibration, heads, inverse_depth)
    f, along_disparity = calibration.focal_length, (J_h @ t + J_rho) / calibration.baseline
    along_ray = J_h @ R[:, :2]
    carried = np.stack([along_ray[..., 0] + along_disparity, along_ray[..., 1], -along_disparity], axis=2) / f
    by_angles = carried @ _angle_jacobian(calibration, right_P) - _angle_jacobian(calibration, right_C)
    J = np.concatenate([np.cross(turned[:, None, :], J_h), inverse_depth[:, None, None] * J_h, by_angles], axis=2)
    covariance = (carried * _with_lens(calibration, first)[:, None, :]) @ carried.transpose(0, 2, 1)
    covariance += np.eye(3) * _with_lens(calibration, second)[:, None, :]
    return z - images(calibration, heads, inverse_depth), J, np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def _with_lens(calibration: StereoCalibration, images: Images) -> FloatArray:
    """Variance (n, 3) of images, with the error of the lens model [px2]."""
    c = np.array([calibration.cx, calibration.cy])
    angle = np.hypot(*((images.left - c) / calibration.focal_length).T)
    error = calibration.focal_length * _LENS * angle**3
    variance: FloatArray = images.variance + np.square(error)[:, None] * np.array([1.0, 0.5, 1.0])
    return variance


def _image_jacobians(
    calibration: StereoCalibration, heads: FloatArray, inverse_depth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of ``images`` with respect to the heads (n, 3, 3) and to the inverse depth (n, 3)."""
    scale = calibration.focal_length / heads[:, 2]
    x_right = heads[:, 0] - calibration.baseline * inverse_depth
    J_h, J_rho = np.zeros((len(heads), 3, 3)), np.zeros((len(heads), 3))
    J_h[:, 0, 0] = J_h[:, 1, 1] = J_h[:, 2, 0] = scale
    J_h[:, :, 2] = -np.column_stack([heads[:, :2], x_right]) * (scale / heads[:, 2])[:, None]
    J_rho[:, 2] = -calibration.baseline * scale
    return J_h, J_rho


def _angle_jacobian(calibration: StereoCalibration, straight: FloatArray) -> FloatArray:
    """Derivative (n, 3, 3) of (u left, v, u right) with respect to the angles; v is the mean of both rows."""
    G = np.zeros((len(straight), 3, 3))
    shift = sensitivity(calibration, straight)
    G[:, 1], G[:, 2] = 0.5 * shift[:, 1], shift[:, 0]
    return G
