"""Blobs and corners at whole pixels, and what they look like: step 1 of VISO2-S.

Responses to a blob mask and to a corner mask of 5 x 5 px; their maxima and minima over a window make four kinds, and
only features of one kind are ever compared. Geiger, Ziegler, Stiller: "StereoScan: dense 3d reconstruction in
real-time", IV 2011, is where de Saxe 2018 takes VISO2-S from.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.messages import GreyImage

_BLOB = np.array(
    [[-1, -1, -1, -1, -1], [-1, 1, 1, 1, -1], [-1, 1, 8, 1, -1], [-1, 1, 1, 1, -1], [-1, -1, -1, -1, -1]], np.float32
)
_CORNER = np.outer([-1, -1, 0, 1, 1], [1, 1, 0, -1, -1]).astype(np.float32)
_WINDOW = 11  # a feature is the strongest of its kind within this; some 3000 to 4000 an image [px]
_WEAKEST = 200  # response; noise of 2 grey levels has a standard deviation of 18 (blob) and 8 (corner)
_BORDER = 8  # the descriptor must fit inside [px]
_PLACES = np.array([-5, -2, 2, 5])  # columns and rows of a descriptor's 16 places within 11 x 11 px


class Features(NamedTuple):
    """The n features of one image, sorted by nothing."""

    points: NDArray[np.int64]  # (n, 2) u, v [px]
    kind: NDArray[np.int64]  # (n,) 0 to 3
    strength: NDArray[np.float32]  # (n,) absolute response
    descriptors: NDArray[np.uint8]  # (n, 32) both image gradients at 16 places; 128 is none


def detect_features(image: GreyImage) -> Features:
    """Blobs and corners of the image with their descriptors."""
    responses = [np.asarray(cv2.filter2D(image, cv2.CV_16S, mask), dtype=np.int16) for mask in (_BLOB, _CORNER)]
    summits = [_summits(signed) for response in responses for signed in (response, -response)]
    points = np.concatenate([points for points, _ in summits])
    strength = np.concatenate([strength for _, strength in summits])
    kind = np.repeat(np.arange(len(summits)), [len(points) for points, _ in summits])
    return Features(points, kind, strength, _described(image, points))


def _summits(response: NDArray[np.int16]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Where the response is greatest within the window, and how great."""
    summit = response == cv2.dilate(np.maximum(response, _WEAKEST), np.ones((_WINDOW, _WINDOW), np.uint8))
    v, u = np.divmod(np.flatnonzero(summit), response.shape[1])
    low, high = _BORDER, np.array(response.shape) - _BORDER
    inside = (u >= low) & (u < high[1]) & (v >= low) & (v < high[0])
    points = np.column_stack([u, v])[inside]
    return points, response[points[:, 1], points[:, 0]].astype(np.float32)


def _described(image: GreyImage, points: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Descriptors (n, 32): horizontal and vertical gradients around the points, scaled to 8 bits."""
    v, u = (axis.ravel() for axis in np.meshgrid(_PLACES, _PLACES, indexing="ij"))
    rows, columns = points[:, 1:] + v, points[:, :1] + u
    gradients = [cv2.Sobel(image, cv2.CV_8U, *order, scale=0.25, delta=128.0) for order in ((1, 0), (0, 1))]
    return np.concatenate([np.asarray(gradient)[rows, columns] for gradient in gradients], axis=1).astype(np.uint8)
