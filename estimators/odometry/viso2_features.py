"""Blobs and corners at whole pixels, and what they look like: step 1 of VISO2-S.

Responses to a blob mask and to a corner mask of 5 x 5 px; their maxima and minima over a window make four kinds, and
only features of one kind are ever compared. Geiger, Ziegler, Stiller: "StereoScan: dense 3d reconstruction in
real-time", IV 2011, is where de Saxe 2018 takes VISO2-S from.
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
_WINDOW = 11  # a feature is the strongest of its kind within this; 7000 to 9000 an image [px]
# A feature must stand out of the noise by so many standard deviations of it that noise alone has less than one of a
# kind in a bucket of 50 x 50 px: normal, 3.35; the smoothest squares of a plain image seem 10 % quieter than they are.
_STANDS_OUT = 3.7
# The noise is measured where the image is smoothest, as textures respond too: what the masks themselves respond to,
# since resampling has coloured it. Where there is texture everywhere that is too much, but the Laplacian of Immerkaer,
# "Fast noise variance estimation", CVIU 1996, which hardly sees textures, says how much it is at most.
_SECOND = np.array([1, -2, 1], np.float32)
_LAPLACIAN = np.outer(_SECOND, _SECOND)
_RESAMPLED = 4.0 / 9.0  # it sees of white noise that was interpolated bilinearly, on average over fractions of a pixel
_BLOCK = 32  # side of the squares [px]
_EVERY = 2  # one of so many rows and columns of a square is looked at
_SMOOTH = 0.1  # share of the squares that are taken to show little but noise
_ROUNDING = 1.0 / math.sqrt(12.0)  # standard deviation of rounding to whole grey levels
_MEAN_TO_STD = math.sqrt(math.pi / 2.0)  # of normal noise, from the mean of its magnitude
_BORDER = 8  # the descriptor must fit inside [px]
_PLACES = np.array([-5, -2, 2, 5])  # columns and rows of a descriptor's 16 places within 11 x 11 px


class Features(NamedTuple):
    """The n features of one image, sorted by nothing."""

    points: NDArray[np.int64]  # (n, 2) u, v [px]
    kind: NDArray[np.int64]  # (n,) 0 to 3
    strength: NDArray[np.float32]  # (n,) absolute response
    descriptors: NDArray[np.uint8]  # (n, 32) both image gradients at 16 places; 128 is none


def detect_features(image: GreyImage) -> Features:
    """Blobs and corners of the image with their descriptors, whatever its brightness and contrast."""
    laplacian = np.asarray(cv2.sepFilter2D(image, cv2.CV_16S, _SECOND, _SECOND), dtype=np.int16)
    at_most = _deviation(laplacian, _LAPLACIAN, 0.5) / _RESAMPLED
    responses = (blob_response(image), BLOB), (corner_response(image), CORNER)
    summits = [one for response, mask in responses for one in _both_signs(response, mask, at_most)]
    points = np.concatenate([points for points, _ in summits])
    strength = np.concatenate([strength for _, strength in summits])
    kind = np.repeat(np.arange(len(summits)), [len(points) for points, _ in summits])
    return Features(points, kind, strength, _described(image, points))


def blob_response(image: GreyImage) -> NDArray[np.int16]:
    """Response to ``BLOB``, from sums over squares: twice that of 3 x 3 less that of 5 x 5, and 7 times the middle."""
    inner, outer = (cv2.boxFilter(image, cv2.CV_16S, (side, side), normalize=False) for side in (3, 5))
    response = np.asarray(cv2.addWeighted(inner, 2.0, outer, -1.0, 0.0), dtype=np.int16)
    response += image * np.int16(7)
    return response


def corner_response(image: GreyImage) -> NDArray[np.int16]:
    """Response to ``CORNER``, from sums over the squares of 2 x 2 in its corners."""
    framed = cv2.copyMakeBorder(image, 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
    sums = np.asarray(cv2.boxFilter(framed, cv2.CV_16S, (2, 2), anchor=(0, 0), normalize=False), dtype=np.int16)
    across = cv2.subtract(sums[:-1, 3:-1], sums[:-1, :-4])
    return np.asarray(cv2.subtract(across[:-3], across[3:]), dtype=np.int16)


def _both_signs(
    response: NDArray[np.int16], mask: NDArray[np.float32], at_most: float
) -> list[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    """Maxima and minima of the response to the mask; the noise of the image is ``at_most`` [grey levels]."""
    noise = min(_deviation(response, mask, _SMOOTH), at_most)
    weakest = math.ceil(_STANDS_OUT * noise * float(np.linalg.norm(mask)))
    maxima = _summits(response, weakest)
    return [maxima, _summits(np.negative(response, out=response), weakest)]


def _deviation(response: NDArray[np.int16], mask: NDArray[np.float32], quantile: float) -> float:
    """Standard deviation of the white noise [grey levels] that makes a quantile of the image's squares respond so.

    It is never less than that of rounding. Squares with less are black or saturated and say nothing.
    """
    sample = np.abs(response[::_EVERY, ::_EVERY]).astype(np.float32)
    step = min(_BLOCK // _EVERY, *sample.shape)
    rows, columns = (size // step for size in sample.shape)
    means = cv2.resize(sample[: rows * step, : columns * step], (columns, rows), interpolation=cv2.INTER_AREA)
    deviations = np.sort(np.asarray(means).ravel()) * (_MEAN_TO_STD / float(np.linalg.norm(mask)))
    deviations = deviations[deviations > _ROUNDING]
    return float(deviations[int(quantile * len(deviations))]) if len(deviations) else _ROUNDING


def _summits(response: NDArray[np.int16], weakest: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Where the response is greatest within the window, and how great."""
    limit: Any = float(weakest)  # a number, which OpenCV's types do not know of
    above = np.asarray(cv2.max(response, limit))
    cv2.dilate(above, np.ones((_WINDOW, _WINDOW), np.uint8), dst=above)
    summit = np.asarray(cv2.compare(response, above, cv2.CMP_EQ)).view(np.bool_)
    inside = summit[_BORDER:-_BORDER, _BORDER:-_BORDER]
    v, u = np.divmod(np.flatnonzero(inside), inside.shape[1])
    points = np.column_stack([u, v]) + _BORDER
    return points, response[points[:, 1], points[:, 0]].astype(np.float32)


def _described(image: GreyImage, points: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Descriptors (n, 32): horizontal and vertical gradients around the points, scaled to 8 bits."""
    gradients = [cv2.Sobel(image, cv2.CV_8U, *order, scale=0.25, delta=128.0) for order in ((1, 0), (0, 1))]
    pairs = np.asarray(cv2.merge(gradients)).view(np.uint16).ravel()  # both of a pixel are fetched as one number
    places = np.add.outer(_PLACES * image.shape[1], _PLACES).ravel()
    centres = points[:, 1] * image.shape[1] + points[:, 0]
    described: NDArray[np.uint8] = np.take(pairs, centres[:, None] + places).view(np.uint8)
    return described
