"""Clipped images: what both of two images show, and how their exposures differ.

Patches are compared without their mean and contrast, so exposures may differ, but not in what is clipped: an edge of a
clipped area is elsewhere. Gain and offset of grey levels are fitted to the surroundings of tracked points. Points on
one side only (dirt, glare, other objects) disagree with the rest and are left out. Not modelled: vignetting, gamma
curves.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.stereo_pair import Points, mapped, with_levels
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray

_END = 3.0  # pixels nearer to the ends of their image's range are clipped, or nearly so [grey levels]
CLIPPED = 0.02  # largest share of clipped pixels in surroundings that are compared
_AROUND = (11, 5)  # sides of the surroundings of tracked points, smaller ones if most of these are clipped [px]
_FEWEST = 15  # tracked points; fewer show nothing to compare
_LEAST_SPREAD = 4.0  # standard deviation over the points; below it noise decides the gain [grey levels]
_ROUNDS = 6  # of the fit without outliers, at most
_CONVERGED = 0.3  # last change of the line [grey levels]
_RANGE = np.array([12.0, 235.0])  # means that clipping cannot have changed [grey levels]
_OUTLIER = 2.5  # residual of a point that is left out [robust standard deviations]
_LEAST_SCATTER = 1.0  # of the points: rounding and noise [grey levels]
_ALIKE = 3.0  # largest difference between equal exposures [grey levels]: 1.5 on rendered, 2 on real pairs
_ALL_LEVELS = np.arange(256.0)
_SPREAD = np.array([0.1, 0.5, 0.9])  # quantiles of the levels between which the exposures are compared


class Exposure(NamedTuple):
    """Map of grey levels: ``gain`` times the level, plus ``offset`` [grey levels]."""

    gain: float
    offset: float


def match_clipping(
    image: GreyImage, frame: StereoFrame, tracks: NDArray[np.float32]
) -> tuple[GreyImage, StereoFrame] | None:
    """Left image of another moment and frame, both clipped where one of them is; None if they are so already.

    ``tracks`` (n, 4) of points in the image and in the frame's left one [px] tell how the exposures differ.
    """
    change = _tracked_change(image, frame.left, tracks)
    if change is None:
        return None
    of_frame = np.clip(_ALL_LEVELS, *(unclipped_range(image) * change.gain + change.offset))
    low, high = (unclipped_range(frame.left) - change.offset) / change.gain
    return mapped(image, _ALL_LEVELS.clip(low, high)), with_levels(frame, of_frame)


def unclipped_range(image: GreyImage) -> FloatArray:
    """Least and largest grey level (2,) that are certainly not clipped."""
    low, high, _, _ = cv2.minMaxLoc(image)
    return np.array([low + _END, high - _END])


def clipped_share(image: GreyImage) -> float:
    """Share of the image's pixels at the ends of its range: nearly 0 of an image that is not clipped."""
    sample = image[::8]
    low, high, _, _ = cv2.minMaxLoc(sample)
    return 1.0 - cv2.countNonZero(cv2.inRange(sample, low + 1.0, high - 1.0)) / sample.size


def _tracked_change(source: GreyImage, target: GreyImage, tracks: NDArray[np.float32]) -> Exposure | None:
    """Change of exposure by the surroundings of points (n, 4) in both images; None if they agree or tell nothing."""
    for side in _AROUND if len(tracks) >= _FEWEST else ():
        x, y = (_levels_around(image, at, side) for image, at in ((source, tracks[:, :2]), (target, tracks[:, 2:])))
        compared = np.isfinite(x + y)
        x, y = x[compared], y[compared]
        fitted = _fitted(x, y) if len(x) >= _FEWEST else None
        if fitted is not None:
            return _if_visible(fitted, x)
    return None


def _if_visible(change: Exposure | None, x: FloatArray) -> Exposure | None:
    """The change, if it matters at the levels (n,) that are compared; else None."""
    if change is None:
        return None
    levels = np.quantile(x, _SPREAD)
    return change if np.abs(change.gain * levels + change.offset - levels).max() > _ALIKE else None


def _levels_around(image: GreyImage, points: Points, side: int) -> FloatArray:
    """Mean grey levels (n,) of squares around points (n, 2) [px]; NaN where pixels are clipped."""
    (u, v), inside = np.ascontiguousarray(points.T), cv2.inRange(image, *unclipped_range(image).tolist())
    level, clipped = (
        cv2.remap(cv2.blur(of_all, (side, side)), u, v, cv2.INTER_LINEAR).ravel().astype(np.float64)
        for of_all in (image.astype(np.float32), cv2.bitwise_not(inside).astype(np.float32))
    )
    return np.where(clipped > 255.0 * CLIPPED, np.nan, level)


def _fitted(x: FloatArray, y: FloatArray) -> Exposure | None:
    """Line through the mean levels (n,) in both images, without outliers; None if too few agree."""
    candidates = (Exposure(1.0, 0.0), _from_quantiles(x, y))
    best = min(candidates, key=lambda exposure: float(np.median(_distance(exposure, x, y))))
    for _ in range(_ROUNDS):
        distance = _distance(best, x, y)
        kept = distance < _OUTLIER * max(_LEAST_SCATTER, 1.4826 * float(np.median(distance)))
        kept &= _in_range(best, x, y)
        if np.count_nonzero(kept) < _FEWEST:
            return None
        before, best = best, _line(x[kept], y[kept])
        if abs(best.gain - before.gain) * 255.0 + abs(best.offset - before.offset) < _CONVERGED:
            break
    return best


def _from_quantiles(x: FloatArray, y: FloatArray) -> Exposure:
    """Line through low and high quantiles."""
    low_x, _, high_x = np.quantile(x, _SPREAD)
    low_y, _, high_y = np.quantile(y, _SPREAD)
    gain = (high_y - low_y) / (high_x - low_x) if min(high_x - low_x, high_y - low_y) > _LEAST_SPREAD else 1.0
    return Exposure(gain, 0.5 * (low_y + high_y - gain * (low_x + high_x)))


def _line(x: FloatArray, y: FloatArray) -> Exposure:
    """Line through the points with the ratio of their spreads as its slope: both coordinates have errors."""
    spread_x, spread_y = float(np.std(x)), float(np.std(y))
    gain = spread_y / spread_x if min(spread_x, spread_y) > _LEAST_SPREAD else 1.0
    return Exposure(gain, float(np.mean(y)) - gain * float(np.mean(x)))


def _in_range(exposure: Exposure, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
    """Mask (n,) of points whose both levels fit into both images: a limit to one alone would bend the line."""
    low, high = _RANGE
    as_y, as_x = exposure.gain * x + exposure.offset, (y - exposure.offset) / exposure.gain
    inside: NDArray[np.bool_] = (np.minimum(x, as_x) > low) & (np.maximum(x, as_x) < high)
    inside &= (np.minimum(y, as_y) > low) & (np.maximum(y, as_y) < high)
    return inside


def _distance(exposure: Exposure, x: FloatArray, y: FloatArray) -> FloatArray:
    """Distances (n,) of points from the line, in units of the axes' mean."""
    return np.abs(y - exposure.gain * x - exposure.offset) * 2.0 / (1.0 + exposure.gain)
