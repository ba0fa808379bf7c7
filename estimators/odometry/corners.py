"""Corner detection with buckets that spread the corners over the image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.messages import GreyImage

Points = NDArray[np.float32]  # (n, 2) u, v [px]

_BUCKET = 50  # de Saxe 2018, section 3.1 [px]
_BLOCK = 3  # window of the structure tensor, in pixels of the halved image
_APART = 5  # non-maximum suppression window, in pixels of the halved image
_WEAKEST = 1e-4  # smallest accepted least eigenvalue; sensor noise of 2 grey levels gives about a tenth of it
_BORDER = 6  # no corners nearer to the edge: the tracker's window must fit, in pixels of the halved image


def detect_corners(image: GreyImage, *, per_bucket: int) -> Points:
    """Detect the strongest corners (least eigenvalue of the structure tensor), at most ``per_bucket`` per bucket.

    Detection works on the image at half size, in a fifth of the time: the tracker's windows of 11 px do not need
    corners located to a pixel.
    """
    halved = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    strength = np.asarray(cv2.cornerMinEigenVal(halved, _BLOCK), dtype=np.float32)
    neighbours = np.ones((_APART, _APART), np.uint8)
    is_maximum = (strength >= cv2.dilate(strength, neighbours)) & (strength > _WEAKEST)
    u, v = _true_pixels(is_maximum[_BORDER:-_BORDER, _BORDER:-_BORDER]) + _BORDER
    points = np.stack([2 * u + 0.5, 2 * v + 0.5], axis=1)  # centre of 2 x 2 pixels
    return points[strongest_in_buckets(points, strength[v, u], per_bucket)].astype(np.float32)


def _true_pixels(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Columns and rows (2, n) of the true pixels, row by row; in a fifth of the time of ``np.nonzero``."""
    if not mask.any():
        return np.empty((2, 0), np.int32)
    return np.asarray(cv2.findNonZero(mask.astype(np.uint8)), dtype=np.int32).reshape(-1, 2).T


def strongest_in_buckets(points: NDArray[np.float64], strength: NDArray[np.float32], count: int) -> NDArray[np.intp]:
    """Indices of the ``count`` strongest of the points (n, 2) in each bucket of 50 x 50 px."""
    column, row = (points.T / _BUCKET).astype(np.int64)
    bucket = row * (column.max(initial=0) + 1) + column
    order = np.lexsort((-strength, bucket))
    position = np.arange(len(order))
    new = np.diff(bucket[order], prepend=-1) > 0
    rank = position - np.maximum.accumulate(np.where(new, position, 0))
    chosen: NDArray[np.intp] = order[rank < count]
    return chosen
