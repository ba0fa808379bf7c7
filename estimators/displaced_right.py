"""Pairs whose right camera is not where it was calibrated, because it exposes at another time.

A moving camera that exposes late has turned and moved on by then. Its rotation is removed from the image by a
homography; its displacement shifts every point by an amount that depends on the depth. The shift is removed point by
point: right images of matched points are converted to those of a camera at the calibrated position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from estimators.matched_frame import MatchedFrame
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

Pixels = NDArray[np.floating[Any]]  # (n, 2) u, v [px]
PixelsT = TypeVar("PixelsT", bound=Pixels)

_SHORTEST = 0.3  # least effective baseline, as a share of the calibrated one: nearer to the epipole depth is unknown
_LEAST_AHEAD = 0.2  # least depth in the displaced camera, as a share of that in the calibrated one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DisplacedFrame(MatchedFrame):
    """A stereo pair with parallel cameras whose right one is not at its calibrated position."""

    right_shift: FloatArray  # (3,) of the right camera from there, along the axes of the left one [m]


def right_shift(frame: StereoFrame) -> FloatArray | None:
    """Displacement (3,) of a frame's right camera [m]; None for an ordinary pair."""
    return frame.right_shift if isinstance(frame, DisplacedFrame) else None


def right_position(calibration: StereoCalibration, shift: FloatArray | None) -> FloatArray:
    """Position (3,) of the right camera in the left one [m]."""
    position = np.array([calibration.baseline, 0.0, 0.0])
    return position if shift is None else position + shift


def as_calibrated(calibration: StereoCalibration, left: Pixels, right: PixelsT, shift: FloatArray | None) -> PixelsT:
    """Right images (n, 2) that a camera at its calibrated position has of the points with these images [px].

    Depth comes from the shift along the epipolar line; the distance from that line is kept as a difference of the rows.
    Points near the epipole, whose depth is unknown, are NaN.
    """
    if shift is None:
        return right
    f, b, c = calibration.focal_length, calibration.baseline, np.array([calibration.cx, calibration.cy])
    r, q = (left - c) / f, (right - c) / f
    # q - r = inverse depth times this
    along = q * shift[2] - np.array([b + shift[0], shift[1]])
    length = np.sqrt((along**2).sum(axis=1))
    inverse_depth = ((q - r) * along).sum(axis=1) / np.maximum(length, _SHORTEST * b) ** 2
    across = (along[:, 0] * (q - r)[:, 1] - along[:, 1] * (q - r)[:, 0]) / np.maximum(length, _SHORTEST * b)
    corrected = np.column_stack([r[:, 0] - b * inverse_depth, r[:, 1] - across])
    corrected[length < _SHORTEST * b] = np.nan
    result: PixelsT = (f * corrected + c).astype(right.dtype)
    return result


def displaced(calibration: StereoCalibration, left: Pixels, right: PixelsT, shift: FloatArray | None) -> PixelsT:
    """Right images (n, 2) in the displaced camera of points with these left and calibrated right images [px]."""
    if shift is None:
        return right
    f, b = calibration.focal_length, calibration.baseline
    inverse_depth = np.maximum((left[:, 0] - right[:, 0]) / (f * b), 0.0)
    seen: Any = right + _image_shift(calibration, right, inverse_depth, shift)
    result: PixelsT = seen.astype(right.dtype)
    return result


def image_shift(calibration: StereoCalibration, points: FloatArray, shift: FloatArray) -> FloatArray:
    """Shift (n, 2) [px] of the right images of known points (n, 3) by the displacement of the camera."""
    right = (points[:, :2] - [calibration.baseline, 0.0]) / points[:, 2:]
    pixels = calibration.focal_length * right + [calibration.cx, calibration.cy]
    return _image_shift(calibration, pixels, 1.0 / points[:, 2], shift)


def _image_shift(
    calibration: StereoCalibration, right: Pixels, inverse_depth: FloatArray, shift: FloatArray
) -> FloatArray:
    """Shift (n, 2) [px] of calibrated right images (n, 2) with these inverse depths (n,) [1/m]."""
    f, c = calibration.focal_length, np.array([calibration.cx, calibration.cy])
    ahead = np.maximum(1.0 - inverse_depth * shift[2], _LEAST_AHEAD)
    moved: FloatArray = ((right - c) * shift[2] - f * shift[:2]) * (inverse_depth / ahead)[:, None]
    return moved
