"""Circular matching of whole-pixel features through four images, and buckets: steps 2 and 3 of VISO2-S.

de Saxe 2018, sections 2.1 and 3.1: a feature is accepted if the way around previous and current, left and right image
ends where it began; flow and disparity must be within 5 px of those around it; buckets of 50 x 50 px hold two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from estimators.odometry.circular_matching import Matches, moved
from estimators.odometry.corners import strongest_in_buckets
from estimators.odometry.nearest_descriptors import Indices, Placed, Window, most_similar
from estimators.odometry.viso2_features import Features, detect_features
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

_ROWS = 1.0  # left and right may differ by this [px]
_NEAREST = 0.6  # times the camera's height: the nearest point that is looked for
# Largest disparity that is looked for at all: the default search range of VISO2-S ("match_radius" of its ROS package).
# With a wide baseline it is this that near things are lost by.
_RANGE = 200.0  # [px]
_LEAST = 0.05  # disparity of what seems to have none; its rounding hides ten times that [px]
_ALIKE = 5.0  # flow and disparity of neighbours: de Saxe 2018, section 3.1 [px]
_SUPPORT = 2  # neighbours that must agree; one may be wrong in the same way by chance
_NEIGHBOURS = 10  # in a bucket, the strongest: as many more change nothing but the time it takes
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
    """Matches through all four images, at most two a bucket.

    They are looked for within ``reach`` [px] of where the motion ``X_PC`` takes them.
    """
    nearest = _NEAREST * float(calibration.X_SC[2, 3])
    widest = min(calibration.focal_length * calibration.baseline / nearest, _RANGE)  # disparity [px]
    to_right, to_left, around = Window(widest, 0.0, _ROWS), Window(0.0, widest, _ROWS), Window(reach, reach, reach)
    in_right = most_similar(_placed(previous.left), _placed(previous.right), to_right)
    paired = np.flatnonzero(_apart(previous, np.arange(len(in_right)), in_right) >= 0)
    left_P, right_P = _taken(previous.left, paired), _taken(previous.right, in_right[paired])
    z_P = _images(left_P.points, right_P.points)
    expected = moved(calibration, z_P, X_PC).astype(np.float64)
    right_C = most_similar(Placed(right_P, expected[:, [2, 1]]), _placed(current.right), around)
    left_C = _on(right_C, _in_left(current, right_C, to_left))
    there = np.flatnonzero(_apart(current, left_C, right_C) >= 0)
    off = np.take(current.left.points, left_C[there], axis=0) - expected[there, :2]
    near = there[np.all(np.abs(off) <= reach, axis=1)]
    back = most_similar(_placed(_taken(current.left, left_C[near])), Placed(left_P, expected[:, :2]), around)
    closed = near[back == near]
    strength = left_P.strength[closed]
    in_left_C, in_right_C = current.left.points[left_C[closed]], current.right.points[right_C[closed]]
    found = Matches(z_P[closed], _images(in_left_C, in_right_C))
    found, strength = _strongest(found, strength, _NEIGHBOURS)
    supported = _supported(found)
    found, strength = Matches(found.previous[supported], found.current[supported]), strength[supported]
    return _strongest(found, strength, _PER_BUCKET)[0]


def _in_left(pair: PairFeatures, right: Indices, to_left: Window) -> Indices:
    """For all features of the right image, the left one; -1 without, or if they are not among the numbers ``right``."""
    wanted = np.flatnonzero(np.bincount(right[right >= 0], minlength=len(pair.right.points)))
    in_left = np.full(len(pair.right.points), -1, np.int64)
    in_left[wanted] = most_similar(_placed(_taken(pair.right, wanted)), _placed(pair.left), to_left)
    return in_left


def _strongest(matches: Matches, strength: NDArray[np.float32], count: int) -> tuple[Matches, NDArray[np.float32]]:
    """The ``count`` strongest in each bucket."""
    chosen = strongest_in_buckets(matches.current[:, :2], strength, count)
    return Matches(matches.previous[chosen], matches.current[chosen]), strength[chosen]


def _placed(features: Features) -> Placed:
    return Placed(features, features.points.astype(np.float64))


def _taken(features: Features, index: Indices) -> Features:
    return Features(
        points=np.take(features.points, index, axis=0),
        kind=np.take(features.kind, index),
        strength=np.take(features.strength, index),
        descriptors=np.take(features.descriptors, index, axis=0),
    )


def _on(first: Indices, second: Indices) -> Indices:
    """``second`` after ``first``; -1 where either found nothing."""
    if len(second) == 0:
        return np.full_like(first, -1)
    return np.where(first < 0, -1, second[first])


def _apart(pair: PairFeatures, left: Indices, right: Indices) -> Indices:
    """Disparities (n,) [px] of features by their numbers; -1 where one is missing."""
    if len(pair.left.points) == 0 or len(pair.right.points) == 0:
        return np.full(len(left), -1, np.int64)
    return np.where((left < 0) | (right < 0), -1, pair.left.points[left, 0] - pair.right.points[right, 0])


def _images(left: NDArray[np.int64], right: NDArray[np.int64]) -> FloatArray:
    """z (n, 3) of pairs; the row is the mean of the two. What has no disparity is far away: it shows how one turns."""
    rows = 0.5 * (left[:, 1] + right[:, 1])
    return np.column_stack([left[:, 0], rows, np.minimum(right[:, 0], left[:, 0] - _LEAST)]).astype(np.float64)


def _supported(matches: Matches) -> NDArray[np.bool_]:
    """Whether enough of a match's neighbours (in a Delaunay triangulation) move alike and are as far away."""
    try:
        triangles = Delaunay(matches.current[:, :2])
    except (QhullError, ValueError):  # fewer than three matches, or all in a line
        return np.zeros(len(matches.current), np.bool_)
    once = triangles.neighbors < np.arange(len(triangles.simplices))[:, None]  # of the two triangles of an edge
    corners = triangles.simplices[:, [[1, 2], [2, 0], [0, 1]]]  # the edges opposite to the corners
    one, other = corners[once].T
    compared = np.column_stack([matches.current - matches.previous, matches.current[:, 0] - matches.current[:, 2]]).T
    alike = (np.abs(compared.take(one, axis=1) - compared.take(other, axis=1)) < _ALIKE).all(axis=0)
    agreeing = np.concatenate([one[alike], other[alike]])
    return np.bincount(agreeing, minlength=len(matches.current)) >= _SUPPORT
