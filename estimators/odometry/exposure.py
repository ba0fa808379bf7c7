"""Matching of exposures: gain and offset of grey levels between two images of the same scene.

Lucas-Kanade tracking and descriptors assume that a point looks the same in both images. Gain and offset are fitted to
mean grey levels of cells, each compared with the cell at the same place in the other image. Cells on one side only
(dirt, glare, other objects) disagree with the rest and are left out, and so are cells with clipped pixels. Exposures
that agree are not touched: then the images stay as they are, bit by bit. Not modelled: vignetting, gamma curves.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.image_points import disparity_guess
from estimators.stereo_pair import MatchedFrame, Points, mapped, with_levels
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray

_CELL = 24  # larger than errors of the guessed disparity, small enough for cells without clipped pixels [px]
_END = 3.0  # pixels nearer to the ends of their image's range are clipped, or nearly so [grey levels]
_CLIPPED = 0.02  # largest share of clipped pixels in a cell that is compared
_AROUND = (11, 5)  # sides of the surroundings of tracked points, smaller ones if most of these are clipped [px]
_FEWEST = 40  # cells; images with fewer in common show nothing to compare
_FEWEST_TRACKED = 15  # the same of tracked points, which agree better
_LEAST_SPREAD = 4.0  # standard deviation over the cells; below it noise decides the gain [grey levels]
_ROUNDS = 6  # of the fit without outliers, at most
_CONVERGED = 0.3  # last change of the line [grey levels]
_RANGE = np.array([12.0, 235.0])  # means of cells that clipping cannot have changed [grey levels]
_OUTLIER = 2.5  # residual of a cell that is left out [robust standard deviations]
_LEAST_SCATTER = 1.0  # of the cells: rounding and noise [grey levels]
_ALIKE = 3.0  # largest difference between equal exposures [grey levels]: 1.5 on rendered, 2 on real pairs
_MOSTLY = 0.7  # share of cells with clipped pixels above which all other pixels are compared by their rank
_RANKS = np.linspace(0.02, 0.98, 49)
_NEAR = 8.0  # difference of a cell that can come from another disparity [grey levels]
_ALL_LEVELS = np.arange(256.0)
_SPREAD = np.array([0.1, 0.5, 0.9])  # quantiles of the cells between which the exposures are compared


class Exposure(NamedTuple):
    """Map of grey levels: ``gain`` times the level, plus ``offset`` [grey levels]."""

    gain: float
    offset: float


def match_exposures(calibration: StereoCalibration, frame: StereoFrame) -> MatchedFrame:
    """Frame with the right image exposed like the left one; with the same images if they agree.

    A frame that was matched before is returned as it is.
    """
    if isinstance(frame, MatchedFrame):
        return frame
    left, right = cell_means(frame.left), cell_means(frame.right)
    right = np.append(right, np.nan)[_beside(calibration, *right.shape)]
    change = _change(frame.right, right, frame.left, left)
    left_image, right_image = frame.left, frame.right
    if change is not None:
        left_image, right_image = mapped(frame.left, _limited(change)), mapped(frame.right, _exposed(change))
    return MatchedFrame(tick=frame.tick, left=left_image, right=right_image, colour=frame.colour)


def match_over_time(
    frame: StereoFrame, other: StereoFrame, tracks: NDArray[np.float32] | None = None
) -> tuple[StereoFrame, StereoFrame]:
    """Frames of two moments, the first exposed like the second; the same objects if they agree.

    With ``tracks`` (n, 4) of points in both left images [px], their surroundings are compared instead of the same
    places: the motion between the frames then has no effect.
    """
    if tracks is None:
        change = _change(frame.left, cell_means(frame.left), other.left, cell_means(other.left))
    else:
        change = _tracked_change(frame.left, other.left, tracks)
    if change is None:
        return frame, other
    return with_levels(frame, _exposed(change)), with_levels(other, _limited(change))


def match_clipping(
    image: GreyImage, frame: StereoFrame, tracks: NDArray[np.float32]
) -> tuple[GreyImage, StereoFrame] | None:
    """Left image of another moment and frame, both clipped where one of them is; None if they are so already.

    Normalised patches may differ in mean and gain, but not in what is clipped: an edge of a clipped area is elsewhere.
    ``tracks`` (n, 4) of points in the image and in the frame's left one [px] tell how the exposures differ.
    """
    change = _tracked_change(image, frame.left, tracks)
    if change is None:
        return None
    of_frame = np.clip(_ALL_LEVELS, *(_range(image) * change.gain + change.offset))
    low, high = (_range(frame.left) - change.offset) / change.gain
    return mapped(image, _ALL_LEVELS.clip(low, high)), with_levels(frame, of_frame)


def _range(image: GreyImage) -> FloatArray:
    """Least and largest grey level (2,) that are certainly not clipped."""
    low, high, _, _ = cv2.minMaxLoc(image)
    return np.array([low + _END, high - _END])


def cell_means(image: GreyImage, *, clipped: bool = True) -> FloatArray:
    """Mean grey levels of the image's cells; with ``clipped`` NaN where pixels are clipped."""
    cell = min(_CELL, *image.shape)
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    whole = image[: rows * cell : 2, : columns * cell]  # every other row: half the time, and noise is small already
    levels, ends = _sums(whole, rows, columns, _END) / (whole.size / (rows * columns))
    mean: FloatArray = np.rint(levels)
    if clipped:
        mean[np.rint(255.0 * ends) > 255.0 * _CLIPPED] = np.nan
    return mean


def clipped_share(image: GreyImage) -> float:
    """Share of the image's pixels at the ends of its range: nearly 0 of an image that is not clipped.

    A left image that is limited to the levels of the right one counts as clipped there.
    """
    sample = image[::4]
    return float(_sums(sample, 1, 1, 1.0)[1, 0, 0]) / sample.size


def _sums(image: GreyImage, rows: int, columns: int, end: float) -> NDArray[np.int32]:
    """Sums (2, rows, columns) over cells: grey levels, and number of those nearer than ``end`` to an end of the range.

    They are compiled C (``cells.c``); without a C compiler OpenCV does the same.
    """
    (low, high, _, _), compiled = cv2.minMaxLoc(image), kernel("estimators.odometry", "cells.c", "add_up")
    low, high, height, width = low + end, high - end, image.shape[0] // rows, image.shape[1] // columns
    if compiled is None:
        masks = image, (cv2.inRange(image, low, high) == 0).astype(np.uint8)
        corners = np.array([cv2.integral(of_all)[::height, ::width] for of_all in masks])
        return np.diff(np.diff(corners, axis=1), axis=2)
    image = image if image.strides[1] == 1 else np.ascontiguousarray(image)
    sums = np.empty((2, rows, columns), np.int32)
    compiled(rows, columns, height, width, image, image.strides[0], int(low), int(high), sums)
    return sums


@lru_cache(maxsize=4)
def _beside(calibration: StereoCalibration, rows: int, columns: int) -> NDArray[np.int64]:
    """Places (rows, columns) among the right image's cells of what each cell of the left one shows; -1: nowhere."""
    v, u = np.mgrid[:rows, :columns]
    centres: Points = (np.column_stack([u.ravel(), v.ravel()]) * _CELL + 0.5 * (_CELL - 1)).astype(np.float32)
    shift = np.rint(disparity_guess(calibration, centres)[:, 0] / _CELL).astype(np.int64).reshape(rows, columns)
    return np.where(u >= shift, v * columns + u - shift, -1)


def _change(
    source: GreyImage, source_cells: FloatArray, target: GreyImage, target_cells: FloatArray
) -> Exposure | None:
    """Change of exposure from the source to the target; None if they agree or cannot be compared."""
    compared = np.isfinite(source_cells + target_cells)
    x, y = source_cells[compared], target_cells[compared]
    if _agree(x, y):
        return None
    best = _fitted(x, y, _FEWEST) if len(x) >= _FEWEST else None
    if best is None and np.mean(np.isnan(source_cells) | np.isnan(target_cells)) > _MOSTLY:
        x, y = _unclipped_levels(source, target)
        best = _from_quantiles(x, y) if len(x) >= len(_RANKS) // 5 else None
    return _if_visible(best, x)


def _tracked_change(source: GreyImage, target: GreyImage, tracks: NDArray[np.float32]) -> Exposure | None:
    """Change of exposure by the surroundings of points (n, 4) in both images; None if they agree or tell nothing."""
    for side in _AROUND if len(tracks) >= _FEWEST_TRACKED else ():
        x, y = (_levels_around(image, at, side) for image, at in ((source, tracks[:, :2]), (target, tracks[:, 2:])))
        compared = np.isfinite(x + y)
        x, y = x[compared], y[compared]
        fitted = _fitted(x, y, _FEWEST_TRACKED) if len(x) >= _FEWEST_TRACKED else None
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
    (u, v), inside = np.ascontiguousarray(points.T), cv2.inRange(image, *_range(image).tolist())
    level, clipped = (
        cv2.remap(cv2.blur(of_all, (side, side)), u, v, cv2.INTER_LINEAR).ravel().astype(np.float64)
        for of_all in (image.astype(np.float32), cv2.bitwise_not(inside).astype(np.float32))
    )
    return np.where(clipped > 255.0 * _CLIPPED, np.nan, level)


def _agree(x: FloatArray, y: FloatArray) -> bool:
    """True if most cells agree without any change: the usual case, found out quickly."""
    near = np.abs(y - x) < _NEAR
    count = np.count_nonzero(near)
    if count < max(_FEWEST, _MOSTLY * len(x)):
        return False
    line = _line(x[near], y[near])
    mean, spread = float(np.mean(x)), float(np.std(x))
    ends = np.array([mean - 1.5 * spread, mean + 1.5 * spread])
    return bool(np.abs(line.gain * ends + line.offset - ends).max() < 0.5 * _ALIKE)


def _unclipped_levels(source: GreyImage, target: GreyImage) -> tuple[FloatArray, FloatArray]:
    """Grey levels of the same ranks in both images, without the ranks that are clipped in one: for large gains."""
    x, y = (np.quantile(image[::4, ::4], _RANKS) for image in (source, target))
    inside = np.logical_and.reduce(
        [(low < z) & (z < high) for z, (low, high) in ((x, _range(source)), (y, _range(target)))]
    )
    return x[inside], y[inside]


def _fitted(x: FloatArray, y: FloatArray, fewest: int) -> Exposure | None:
    """Line through the means (n,) of cells in both images, without outliers; None if too few agree."""
    candidates = (Exposure(1.0, 0.0), _from_quantiles(x, y))
    best = min(candidates, key=lambda exposure: float(np.median(_distance(exposure, x, y))))
    for _ in range(_ROUNDS):
        distance = _distance(best, x, y)
        kept = distance < _OUTLIER * max(_LEAST_SCATTER, 1.4826 * float(np.median(distance)))
        kept &= _in_range(best, x, y)
        if np.count_nonzero(kept) < fewest:
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


def _exposed(change: Exposure) -> FloatArray:
    """Grey levels (256,) after the change."""
    return change.gain * _ALL_LEVELS + change.offset


def _limited(change: Exposure) -> FloatArray:
    """Grey levels (256,) limited to those that an image has after the change: where that one is clipped, both are."""
    limited: FloatArray = np.clip(_ALL_LEVELS, *_exposed(change)[[0, -1]])
    return limited
