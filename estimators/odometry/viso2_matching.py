"""Circular matching of whole-pixel features through four images, with buckets: steps 2 and 3 of VISO2-S.

de Saxe 2018, sections 2.1 and 3.1: a match is accepted if the circle through previous and current, left and right image
closes, and if flow and disparity are within 5 px of those of its neighbours. Buckets of 50 x 50 px hold two matches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from estimators.odometry.corners import strongest_in_buckets
from estimators.odometry.nearest_descriptors import Indices, Placed, Window, most_similar
from estimators.odometry.point_tracking import Matches, moved
from estimators.odometry.viso2_features import Features, detect_features
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

_ROWS = 1.0  # largest difference of the rows in left and right [px]
_NEAREST = 0.6  # depth of the nearest point that is searched for, in camera heights
# Largest disparity: default search range of VISO2-S ("match_radius" of its ROS package). With a wide baseline it
# excludes near points.
_RANGE = 200.0  # [px]
_LEAST = 0.05  # disparity assigned to points with none; rounding hides ten times as much [px]
_LARGEST_DIFFERENCE = 5.0  # largest difference of flow and disparity between neighbours: de Saxe 2018, section 3.1 [px]
_SUPPORT = 2  # neighbours that must agree; one may agree by chance
_NEIGHBOURS = 10  # strongest matches per bucket that are checked; more only cost time
_PER_BUCKET = 2  # de Saxe 2018, section 3.1


class PairFeatures(NamedTuple):
    """Features of a stereo pair."""

    left: Features
    right: Features


def pair_features(frame: StereoFrame) -> PairFeatures:
    """Features of both images."""
    return PairFeatures(detect_features(frame.left), detect_features(frame.right))


def circular_matches(
    calibration: StereoCalibration, previous: PairFeatures, current: PairFeatures, X_PC: FloatArray, reach: float
) -> Matches:
    """Matches through all four images, at most two per bucket, within ``reach`` [px] of the prediction by ``X_PC``."""
    nearest = _NEAREST * float(calibration.X_SC[2, 3])
    widest = min(calibration.focal_length * calibration.baseline / nearest, _RANGE)  # disparity [px]
    to_right, to_left = Window(widest, 0.0, _ROWS), Window(0.0, widest, _ROWS)
    near_prediction = Window(reach, reach, reach)
    in_right = most_similar(_placed(previous.left), _placed(previous.right), to_right)
    paired = np.flatnonzero(_disparities(previous, np.arange(len(in_right)), in_right) >= 0)
    left_P, right_P = _subset(previous.left, paired), _subset(previous.right, in_right[paired])
    z_P = _images(left_P.points, right_P.points)
    expected = moved(calibration, z_P, X_PC).astype(np.float64)
    right_C = most_similar(Placed(right_P, expected[:, [2, 1]]), _placed(current.right), near_prediction)
    left_C = _composed(right_C, _in_left(current, right_C, to_left))
    paired_C = np.flatnonzero(_disparities(current, left_C, right_C) >= 0)
    error = np.take(current.left.points, left_C[paired_C], axis=0) - expected[paired_C, :2]
    near = paired_C[np.all(np.abs(error) <= reach, axis=1)]
    back = most_similar(_placed(_subset(current.left, left_C[near])), Placed(left_P, expected[:, :2]), near_prediction)
    closed = near[back == near]
    strength = left_P.strength[closed]
    in_left_C, in_right_C = current.left.points[left_C[closed]], current.right.points[right_C[closed]]
    z_C = _images(in_left_C, in_right_C)
    chosen = strongest_in_buckets(z_C[:, :2], strength, _NEIGHBOURS)
    z_P, z_C, strength = z_P[closed[chosen]], z_C[chosen], strength[chosen]
    supported = np.flatnonzero(_supported(z_C, z_C - expected[closed[chosen]]))
    chosen = supported[strongest_in_buckets(z_C[supported, :2], strength[supported], _PER_BUCKET)]
    return Matches(z_P[chosen], z_C[chosen])


def _in_left(pair: PairFeatures, right: Indices, to_left: Window) -> Indices:
    """Left match of every right feature; -1 without a match, or if the feature is not among the indices ``right``."""
    wanted = np.flatnonzero(np.bincount(right[right >= 0], minlength=len(pair.right.points)))
    in_left = np.full(len(pair.right.points), -1, np.int64)
    in_left[wanted] = most_similar(_placed(_subset(pair.right, wanted)), _placed(pair.left), to_left)
    return in_left


def _placed(features: Features) -> Placed:
    return Placed(features, features.points.astype(np.float64))


def _subset(features: Features, index: Indices) -> Features:
    return Features(
        points=np.take(features.points, index, axis=0),
        kind=np.take(features.kind, index),
        strength=np.take(features.strength, index),
        descriptors=np.take(features.descriptors, index, axis=0),
    )


def _composed(first: Indices, second: Indices) -> Indices:
    """Index map ``second`` after ``first``; -1 where either has no match."""
    if len(second) == 0:
        return np.full_like(first, -1)
    return np.where(first < 0, -1, second[first])


def _disparities(pair: PairFeatures, left: Indices, right: Indices) -> Indices:
    """Disparities (n,) [px] of features by their indices; -1 where one is missing."""
    if len(pair.left.points) == 0 or len(pair.right.points) == 0:
        return np.full(len(left), -1, np.int64)
    return np.where((left < 0) | (right < 0), -1, pair.left.points[left, 0] - pair.right.points[right, 0])


def _images(left: NDArray[np.int64], right: NDArray[np.int64]) -> FloatArray:
    """Images z (n, 3) of pairs; v is the mean of both rows. Points without disparity count as distant."""
    rows = 0.5 * (left[:, 1] + right[:, 1])
    return np.column_stack([left[:, 0], rows, np.minimum(right[:, 0], left[:, 0] - _LEAST)]).astype(np.float64)


def _supported(z: FloatArray, surprise: FloatArray) -> NDArray[np.bool_]:
    """Mask (n,) of matches of which enough Delaunay neighbours have a similar surprise and a similar disparity.

    ``surprise`` (n, 3) is how far the images ``z`` (n, 3) in C are from the prediction. The flow itself differs by more
    than the limit between neighbours near the camera of a fast vehicle.
    """
    try:
        triangles = Delaunay(z[:, :2])
    except (QhullError, ValueError):  # fewer than three matches, or all collinear
        return np.zeros(len(z), np.bool_)
    once = triangles.neighbors < np.arange(len(triangles.simplices))[:, None]  # each edge belongs to two triangles
    corners = triangles.simplices[:, [[1, 2], [2, 0], [0, 1]]]  # edges opposite to the corners
    one, other = corners[once].T
    compared = np.column_stack([surprise, z[:, 0] - z[:, 2]]).T
    similar = (np.abs(compared.take(one, axis=1) - compared.take(other, axis=1)) < _LARGEST_DIFFERENCE).all(axis=0)
    agreeing = np.concatenate([one[similar], other[similar]])
    return np.bincount(agreeing, minlength=len(z)) >= _SUPPORT
