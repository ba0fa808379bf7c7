"""Views that the rotation of the right camera is measured from: points in both raw images, and the same points later.

Images are matched as they come from the cameras; only the points found are straightened, so that a better estimate of
the rotation applies to older views as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.calibration.right_rotation import RightRotation, homography, moved
from estimators.odometry.corners import Points, detect_corners
from estimators.odometry.local_planes import local_planes, rays_through, warps
from estimators.odometry.point_tracking import LEVELS, LEVELS_NEAR, track
from estimators.odometry.warped_matching import (
    MARGIN,
    Float32Array,
    PatchMatches,
    match_patches,
    templates,
    warped_patches,
)
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, inverse

FEWEST = 25  # points; fewer may agree by chance
_PER_BUCKET = 2  # corners; 250 to 350 points on an ordinary road
_CLOSURE = 0.6  # from left to right and back must end where it began, within this [px]
_LEAST_CORRELATION = 0.8  # least normalised correlation of two patches
_MOVED = 2.5  # that the warped match may go from where Lucas-Kanade ended [px]
_FINEST = 0.03  # no patch is located better: sampling and interpolation, measured on rendered frames [px]
_SAME_ROW = 1.5  # rows in left and right may differ by this beyond the doubt about the rotation [px]
_FARTHEST = -1.0  # disparities of points far away scatter about 0 [px]
_AHEAD = 0.1  # disparity that a point's plane goes through at least, so that it lies ahead of the camera [px]
_SCENERY_DEPTH = 30.0  # first guess for what is not ground [m]
_NEAREST = 1.0  # [m]
_GATE = 12.0  # a match may lie so far from where it was predicted [px]


class View(NamedTuple):
    """A stereo pair with n points that both raw images show."""

    image: Float32Array  # left
    left: Points  # (n, 2) [px]
    right: Points  # (n, 2) in the raw right image [px]
    variance: FloatArray  # (n, 2) of u and v from left to right [px2]
    planes: FloatArray  # (n, 3) around the points: n . X = 1 [1/m]


class Images(NamedTuple):
    """Where a stereo pair shows n points."""

    left: Points  # (n, 2) [px]
    right: Points  # (n, 2) in the raw right image [px]
    variance: FloatArray  # (n, 3) of u left, mean v, u right [px2]


def new_view(
    calibration: StereoCalibration, frame: StereoFrame, rotation: RightRotation, doubt: float, rng: np.random.Generator
) -> View:
    """What both images of the frame show; the rotation may be wrong by some ``doubt`` [rad]."""
    left, right = _pairs(calibration, frame, rotation, doubt)
    straight = moved(homography(calibration, rotation), right)
    disparity = np.maximum(left[:, 0] - straight[:, 0], _AHEAD)
    planes = local_planes(calibration, left, disparity, rng)
    image = frame.left.astype(np.float32)
    beside = np.array([-calibration.baseline, 0.0, 0.0])
    patches = warped_patches(image, left, warps(np.eye(3), beside, planes, rays_through(calibration, left)))
    found = _found(patches, frame.right, right)
    kept = (found.correlation > _LEAST_CORRELATION) & (_longest(found.points - right) < _MOVED)
    variance = found.variance[kept].astype(np.float64) + _FINEST**2
    return View(image, left[kept], found.points[kept], variance, planes[kept])


def seen_again(
    calibration: StereoCalibration, view: View, frame: StereoFrame, X_PC: FloatArray, rotation: RightRotation
) -> tuple[Images, Images]:
    """The view's points that a later frame shows, at about ``X_PC`` from it: in the view, and in the frame."""
    H = homography(calibration, rotation)
    X_CP = inverse(X_PC)
    R, t = X_CP[:3, :3], X_CP[:3, 3]
    rays, inverse_depth = bearings(calibration, view.left, moved(H, view.right))
    heads = rays @ R.T + inverse_depth[:, None] * t
    z = images(calibration, heads, inverse_depth)
    shown = np.flatnonzero(_inside(calibration, z) & (heads[:, 2] > _NEAREST * inverse_depth) & (heads[:, 2] > 0.0))
    predicted = z[shown].astype(np.float32)
    centres, planes, rays = view.left[shown], view.planes[shown], rays[shown]
    beside = np.array([calibration.baseline, 0.0, 0.0])
    patches = [warped_patches(view.image, centres, warps(R, p, planes, rays)) for p in (t, t - beside)]
    left = _found(patches[0], frame.left, predicted[:, :2])
    shift = left.points - predicted[:, :2]
    guess = moved(_back(H), predicted[:, [2, 1]] + shift).astype(np.float32)
    right = _found(patches[1], frame.right, guess)
    kept = (left.correlation > _LEAST_CORRELATION) & (right.correlation > _LEAST_CORRELATION)
    kept &= (_longest(shift) < _GATE) & (_longest(right.points - guess) < _MOVED)
    of = shown[kept]
    # the view's left image defines where its points are, but for its sampling; the mean of two rows has half the error
    own, across = np.full(len(of), _FINEST**2), view.variance[of]
    a, b = left.variance[kept] + _FINEST**2, right.variance[kept] + _FINEST**2
    first = Images(view.left[of], view.right[of], np.column_stack([own, 0.25 * across[:, 1], across[:, 0]]))
    variance = np.column_stack([a[:, 0], 0.25 * (a[:, 1] + b[:, 1]), b[:, 0]]).astype(np.float64)
    return first, Images(left.points[kept], right.points[kept], variance)


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
    calibration: StereoCalibration, frame: StereoFrame, rotation: RightRotation, doubt: float
) -> tuple[Points, Points]:
    """Corners of the left image and where the raw right one shows them, found both ways."""
    corners = detect_corners(frame.left, per_bucket=_PER_BUCKET)
    H = homography(calibration, rotation)
    guess = moved(_back(H), corners - _disparity_guess(calibration, corners)).astype(np.float32)
    right, found = track(frame.left, frame.right, corners, guess, LEVELS)
    back, found_again = track(frame.right, frame.left, right, corners, LEVELS_NEAR)
    apart = corners - moved(H, right)
    doubtful = 3.0 * doubt * calibration.focal_length
    kept = found & found_again & (_longest(back - corners) < _CLOSURE)
    kept &= (np.abs(apart[:, 1]) < _SAME_ROW + doubtful) & (apart[:, 0] > _FARTHEST - doubtful)
    return corners[kept], right[kept]


def _found(patches: Float32Array, image: GreyImage, guess: Points) -> PatchMatches:
    """Where the image shows the patches, each near its guess."""
    if len(guess) == 0:
        return PatchMatches(guess, np.empty(0, np.float32), np.empty((0, 2), np.float32))
    return match_patches(templates(patches), image.astype(np.float32), guess)


def _disparity_guess(calibration: StereoCalibration, corners: Points) -> FloatArray:
    """Shift (n, 2) [px] between left and right of corners on level ground, or on scenery where that is farther."""
    fall = -rays_through(calibration, corners) @ calibration.X_SC[2, :3]  # towards the ground, per depth
    inverse_depth = np.maximum(fall / calibration.X_SC[2, 3], 1.0 / _SCENERY_DEPTH)
    shift = calibration.focal_length * calibration.baseline * inverse_depth
    return np.column_stack([shift, np.zeros(len(shift))])


def _inside(calibration: StereoCalibration, z: FloatArray) -> NDArray[np.bool_]:
    """Whether whole patches around the images z (n, 3) lie in both pictures."""
    high = np.array([calibration.width, calibration.height, calibration.width]) - 1 - MARGIN
    return np.asarray(((z > MARGIN) & (z < high)).all(axis=1), dtype=np.bool_)


def _back(H: FloatArray) -> FloatArray:
    """The way back of a homography (3, 3)."""
    return np.asarray(np.linalg.inv(H), dtype=np.float64)


def _longest(shift: NDArray[np.floating]) -> NDArray[np.floating]:
    """The greater component (n,) of shifts (n, 2)."""
    longest: NDArray[np.floating] = np.abs(shift).max(axis=1, initial=0.0)
    return longest
