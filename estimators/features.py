"""Corners, spread over the image by buckets."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.messages import GreyImage

Points = NDArray[np.float32]  # (n, 2) u, v [px]

_BLOCK = 5  # window of the structure tensor [px]
_APART = 7  # a corner is the strongest within this window [px]
_WEAKEST = 1e-4  # least eigenvalue; noise of 2 grey levels alone gives about half of it
_BORDER = 12  # no corners nearer to the edge: the tracker's window must fit [px]


def detect_corners(image: GreyImage, *, bucket: int, per_bucket: int) -> Points:
    """The strongest corners of every ``bucket`` x ``bucket`` [px] square, at most ``per_bucket`` each."""
    strength = cv2.cornerMinEigenVal(image, _BLOCK)
    summit = (strength >= cv2.dilate(strength, np.ones((_APART, _APART), np.uint8))) & (strength > _WEAKEST)
    inside = np.zeros_like(summit)
    inside[_BORDER:-_BORDER, _BORDER:-_BORDER] = True
    v, u = np.nonzero(summit & inside)
    chosen = _strongest_per_bucket(u // bucket, v // bucket, strength[v, u], per_bucket)
    return np.stack([u[chosen], v[chosen]], axis=1).astype(np.float32)


def _strongest_per_bucket(
    column: NDArray[np.intp], row: NDArray[np.intp], strength: NDArray[np.float32], count: int
) -> NDArray[np.intp]:
    """Indices of the ``count`` strongest in each (row, column)."""
    order = np.lexsort((-strength, column, row))
    same = (np.diff(row[order], prepend=-1) == 0) & (np.diff(column[order], prepend=-1) == 0)
    start = np.maximum.accumulate(np.where(same, 0, np.arange(len(order))))  # first of one's own bucket
    return order[np.arange(len(order)) - start < count]
