"""Keyframes: stereo views whose points have depth and a local plane, for matching later frames against them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.displaced_right import as_calibrated, right_position, right_shift
from estimators.odometry.corners import Points, detect_corners
from estimators.odometry.exposure import clipped_share
from estimators.odometry.local_planes import local_planes, rays_through, warps
from estimators.odometry.point_tracking import LEVELS_NEAR, stereo_pairs, track
from estimators.odometry.pose import point_covariance
from estimators.odometry.warped_matching import Float32Array, match_patches, templates, warped_patches
from estimators.stereo_geometry import triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

_PER_BUCKET = 4  # corners; bare ground fills at most half of the buckets
_CLOSURE = 0.6  # largest distance between start and end of the track from left to right and back [px]
_LEAST_CORRELATION = 0.8  # least normalised correlation of left and right patch
_MOVED = 2.5  # largest distance of the warped match from the Lucas-Kanade result [px]
_SAME_ROW = 1.0  # largest difference of the rows in left and right [px]
FINEST = 0.03  # least error of a patch in a later frame: sampling and interpolation, on rendered frames [px]
_FINEST_STEREO = 0.06  # the same in the right image: a patch is not exactly a plane; measured likewise [px]
_OWN = 0.02  # error in the keyframe's left image, which defines its points: sampling alone [px]


class Keyframe(NamedTuple):
    """A view with n points in random order, so that the first few are a fair and repeatable sample."""

    tick: int
    X_OK: FloatArray  # (4, 4) pose of the left camera in O, the frame in which the odometry started
    image: Float32Array  # left
    clipped: float  # share of its pixels
    centres: Points  # (n, 2) of the points' patches [px]
    points: FloatArray  # (n, 3) in K [m]
    covariance: FloatArray  # (n, 3, 3) of the points [m2]
    planes: FloatArray  # (n, 3) around the points: n . X = 1 [1/m]
    misses: NDArray[np.int64]  # (n,) consecutive frames in which the point was not found where predicted


def new_keyframe(
    calibration: StereoCalibration, frame: StereoFrame, X_OK: FloatArray, rng: np.random.Generator
) -> Keyframe:
    """Keyframe from a frame at pose ``X_OK``."""
    left, right = _stereo_pairs(calibration, frame)
    shift = right_shift(frame)
    disparity = left[:, 0] - as_calibrated(calibration, left, right, shift)[:, 0]
    planes = local_planes(calibration, left, disparity.astype(np.float64), rng)
    image = frame.left.astype(np.float32)
    bent = warps(np.eye(3), -right_position(calibration, shift), planes, rays_through(calibration, left))
    matched = match_patches(templates(warped_patches(image, left, bent)), frame.right.astype(np.float32), right)
    straight = as_calibrated(calibration, left, matched.points, shift)
    apart = left - straight
    kept = (matched.correlation > _LEAST_CORRELATION) & (np.abs(apart[:, 1]) < _SAME_ROW) & (apart[:, 0] > 0.0)
    kept &= np.abs(matched.points - right).max(axis=1, initial=0.0) < _MOVED
    chosen = rng.permutation(np.flatnonzero(kept))
    z = np.column_stack([left[:, 0], 0.5 * (left[:, 1] + straight[:, 1]), straight[:, 0]]).astype(np.float64)
    u, v = (matched.variance + _FINEST_STEREO**2).T
    points = triangulate(calibration, z[chosen])
    variance = np.column_stack([np.full(len(u), _OWN**2), 0.5 * v, u])[chosen]
    return Keyframe(
        tick=frame.tick,
        X_OK=X_OK,
        image=image,
        clipped=clipped_share(frame.left),
        centres=left[chosen],
        points=points,
        covariance=point_covariance(calibration, points, variance),
        planes=planes[chosen],
        misses=np.zeros(len(chosen), np.int64),
    )


def _stereo_pairs(calibration: StereoCalibration, frame: StereoFrame) -> tuple[Points, Points]:
    """Corners in the left and right image that track there and back."""
    left, right = stereo_pairs(calibration, frame, detect_corners(frame.left, per_bucket=_PER_BUCKET))
    back, found = track(frame.right, frame.left, right, left, LEVELS_NEAR)
    closed = found & (np.abs(back - left).max(axis=1, initial=0.0) < _CLOSURE)
    return left[closed], right[closed]
