"""Blob and corner features at whole pixels with descriptors: step 1 of VISO2-S.

The maxima and minima of a blob mask and of a corner mask of 5 x 5 px give four kinds of features. Only features of the
same kind are compared. Source of VISO2-S in de Saxe 2018: Geiger, Ziegler, Stiller, "StereoScan: dense 3d
reconstruction in real-time", IV 2011.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.messages import GreyImage

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
