"""Features and circular matching of VISO2-S: steps 1 to 3.

de Saxe 2018, sections 2.1 and 3.1: a match is accepted if the circle through previous and current, left and right image
closes, and if flow and disparity are within 5 px of those of its neighbours. Buckets of 50 x 50 px hold two matches.

The maxima and minima of a blob mask and of a corner mask of 5 x 5 px give four kinds of features. Only features of the
same kind are compared. Source of VISO2-S in de Saxe 2018: Geiger, Ziegler, Stiller, "StereoScan: dense 3d
reconstruction in real-time", IV 2011.
"""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree

from estimators.odometry.image_points import Matches, moved, strongest_in_buckets
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray

BLOB = np.array(
    [[-1, -1, -1, -1, -1], [-1, 1, 1, 1, -1], [-1, 1, 8, 1, -1], [-1, 1, 1, 1, -1], [-1, -1, -1, -1, -1]], np.float32
)
CORNER = np.outer([-1, -1, 0, 1, 1], [1, 1, 0, -1, -1]).astype(np.float32)
_WINDOW = 11  # non-maximum suppression; 7000 to 9000 features per image [px]
# Detection threshold in standard deviations of the noise: noise alone then gives less than one feature of a kind in a
# bucket of 50 x 50 px. For normal noise that is 3.35; the noise of the smoothest squares is estimated 10 % too low.
_DETECTION_THRESHOLD = 3.7
# The noise is measured with the masks themselves, as resampling has coloured it, in the smoothest squares of the image,
# as texture responds too. With texture everywhere the result is too high. Then the Laplacian of Immerkaer, "Fast noise
# variance estimation", CVIU 1996, which hardly responds to texture, is the upper limit.
_SECOND = np.array([1, -2, 1], np.float32)
_LAPLACIAN = np.outer(_SECOND, _SECOND)
_RESAMPLED = 4.0 / 9.0  # share of bilinearly interpolated white noise in the Laplacian, mean over fractions of a pixel
_BLOCK = 32  # side of the squares [px]
_EVERY = 2  # sampling step of rows and columns in a square
_SMOOTH = 0.1  # share of the squares that are assumed to show noise alone
_ROUNDING = 1.0 / math.sqrt(12.0)  # standard deviation of rounding to whole grey levels
_MEAN_TO_STD = math.sqrt(math.pi / 2.0)  # standard deviation of normal noise over its mean magnitude
_BORDER = 8  # the descriptor must fit inside [px]
_SAMPLES = np.array([-5, -2, 2, 5])  # columns and rows of a descriptor's 16 samples within 11 x 11 px


class Features(NamedTuple):
    """The n features of one image, in no particular order."""

    points: NDArray[np.int64]  # (n, 2) u, v [px]
    kind: NDArray[np.int64]  # (n,) 0 to 3
    strength: NDArray[np.float32]  # (n,) absolute response
    descriptors: NDArray[np.uint8]  # (n, 32) both image gradients at 16 samples; 128 is zero


def detect_features(image: GreyImage) -> Features:
    """Detect blobs and corners with their descriptors, independent of brightness and contrast."""
    laplacian = np.asarray(cv2.sepFilter2D(image, cv2.CV_16S, _SECOND, _SECOND), dtype=np.int16)
    most_noise = _deviation(laplacian, _LAPLACIAN, 0.5) / _RESAMPLED
    responses = (blob_response(image), BLOB), (corner_response(image), CORNER)
    extrema = [one for response, mask in responses for one in _extrema(response, mask, most_noise)]
    points = np.concatenate([points for points, _ in extrema])
    strength = np.concatenate([strength for _, strength in extrema])
    kind = np.repeat(np.arange(len(extrema)), [len(points) for points, _ in extrema])
    return Features(points, kind, strength, _descriptors(image, points))


def blob_response(image: GreyImage) -> NDArray[np.int16]:
    """Response to ``BLOB`` by box filters: 2 x (3 x 3) - (5 x 5) + 7 x centre."""
    inner, outer = (cv2.boxFilter(image, cv2.CV_16S, (side, side), normalize=False) for side in (3, 5))
    response = np.asarray(cv2.addWeighted(inner, 2.0, outer, -1.0, 0.0), dtype=np.int16)
    response += image * np.int16(7)
    return response


def corner_response(image: GreyImage) -> NDArray[np.int16]:
    """Response to ``CORNER`` by box filters: sums over the 2 x 2 squares in its corners."""
    framed = cv2.copyMakeBorder(image, 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
    sums = np.asarray(cv2.boxFilter(framed, cv2.CV_16S, (2, 2), anchor=(0, 0), normalize=False), dtype=np.int16)
    across = cv2.subtract(sums[:-1, 3:-1], sums[:-1, :-4])
    return np.asarray(cv2.subtract(across[:-3], across[3:]), dtype=np.int16)


def _extrema(
    response: NDArray[np.int16], mask: NDArray[np.float32], most_noise: float
) -> list[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    """Maxima and minima of the response to the mask; ``most_noise`` limits the estimated noise [grey levels]."""
    noise = min(_deviation(response, mask, _SMOOTH), most_noise)
    weakest = math.ceil(_DETECTION_THRESHOLD * noise * float(np.linalg.norm(mask)))
    maxima = _maxima(response, weakest)
    return [maxima, _maxima(np.negative(response, out=response), weakest)]


def _deviation(response: NDArray[np.int16], mask: NDArray[np.float32], quantile: float) -> float:
    """Standard deviation of white noise [grey levels], from a quantile of the responses of the image's squares.

    It is at least that of rounding. Squares with less are black or saturated and are ignored.
    """
    sample = np.abs(response[::_EVERY, ::_EVERY]).astype(np.float32)
    step = min(_BLOCK // _EVERY, *sample.shape)
    rows, columns = (size // step for size in sample.shape)
    means = cv2.resize(sample[: rows * step, : columns * step], (columns, rows), interpolation=cv2.INTER_AREA)
    deviations = np.sort(np.asarray(means).ravel()) * (_MEAN_TO_STD / float(np.linalg.norm(mask)))
    deviations = deviations[deviations > _ROUNDING]
    return float(deviations[int(quantile * len(deviations))]) if len(deviations) else _ROUNDING


def _maxima(response: NDArray[np.int16], weakest: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Local maxima (n, 2) of the response above ``weakest``, and their values (n,)."""
    limit: Any = float(weakest)  # OpenCV's type stubs lack the scalar overload
    above = np.asarray(cv2.max(response, limit))
    cv2.dilate(above, np.ones((_WINDOW, _WINDOW), np.uint8), dst=above)
    is_maximum = np.asarray(cv2.compare(response, above, cv2.CMP_EQ)).view(np.bool_)
    inside = is_maximum[_BORDER:-_BORDER, _BORDER:-_BORDER]
    v, u = np.divmod(np.flatnonzero(inside), inside.shape[1])
    points = np.column_stack([u, v]) + _BORDER
    return points, response[points[:, 1], points[:, 0]].astype(np.float32)


def _descriptors(image: GreyImage, points: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Descriptors (n, 32): horizontal and vertical gradients around the points, scaled to 8 bits."""
    gradients = [cv2.Sobel(image, cv2.CV_8U, *order, scale=0.25, delta=128.0) for order in ((1, 0), (0, 1))]
    pairs = np.asarray(cv2.merge(gradients)).view(np.uint16).ravel()  # both gradients of a pixel in one number
    offsets = np.add.outer(_SAMPLES * image.shape[1], _SAMPLES).ravel()
    centres = points[:, 1] * image.shape[1] + points[:, 0]
    descriptors: NDArray[np.uint8] = np.take(pairs, centres[:, None] + offsets).view(np.uint8)
    return descriptors


Indices = NDArray[np.int64]


class Placed(NamedTuple):
    """Features with their measured or predicted positions."""

    features: Features
    position: FloatArray  # (n, 2) [px]


class Window(NamedTuple):
    """Search window around a predicted position."""

    left: float  # [px]
    right: float  # [px]
    rows: float  # above and below [px]


_CELL, _CELLS = 16, 256  # side of the cells that candidates are sorted into [px], and most in a row: the last is open
_NUMBERS = f"CELL={_CELL}.0f", "LENGTH=32"  # of a descriptor


def most_similar(queries: Placed, candidates: Placed, window: Window) -> Indices:
    """Index (n,) of the candidate of the same kind with the most similar descriptor; -1 if the window has none.

    The search is compiled C (``similar.c``); without a C compiler SciPy finds the pairs.
    """
    ours, theirs, best = queries.features, candidates.features, np.full(len(queries.position), -1)
    if len(queries.position) == 0 or len(candidates.position) == 0:
        return best
    compiled = kernel("estimators.odometry", "similar.c", "most_similar", _NUMBERS)
    if compiled is None:
        one, other = _pairs_in_windows(queries, candidates, window)
        cost = np.abs(ours.descriptors[one].astype(np.int16) - theirs.descriptors[other]).sum(axis=1)
        order = np.lexsort([other, cost, one])
        first, at = np.unique(one[order], return_index=True)
        best[first] = other[order[at]]
        return best
    places = np.ascontiguousarray(candidates.position, np.float32)
    column, row = np.clip(places.T * (1.0 / _CELL), 0.0, _CELLS - 1.0).astype(np.int64)
    columns, rows, kinds = column.max() + 1, row.max() + 1, max(ours.kind.max(), theirs.kind.max()) + 1
    cell = (theirs.kind * rows + row) * columns + column
    start = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=kinds * rows * columns))])
    at, order = np.ascontiguousarray(queries.position, np.float32), np.argsort(cell, kind="stable")
    cells, limits = (rows, columns, start, order), np.array(window, np.float32)
    compiled(len(best), at, ours.kind, ours.descriptors, places, theirs.descriptors, *cells, limits, best)
    return best


def _pairs_in_windows(queries: Placed, candidates: Placed, window: Window) -> tuple[Indices, Indices]:
    """All pairs of one kind in which the candidate lies in the window of the query."""
    middle = (0.5 * (window.right - window.left), 0.0)
    half = (0.5 * (window.right + window.left), window.rows)
    one, other = (
        cKDTree(np.column_stack([(placed.position + shift) / half, 3.0 * placed.features.kind]))
        for placed, shift in ((queries, middle), (candidates, 0.0))
    )
    pairs = one.sparse_distance_matrix(other, 1.0 + 1e-9, p=np.inf, output_type="ndarray")
    return pairs["i"], pairs["j"]


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
