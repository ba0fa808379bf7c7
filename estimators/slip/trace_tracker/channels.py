"""Image channels that distinguish a rut from sand: brightness, lug marks and walls.

The logarithm turns shadows into steps, which a clipped high-pass filter reduces to thin lines. The local contrast is
normalised, so that exposure, contrast and haze have no effect.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimators.slip.trace_tracker.ground_patch import FloatImage

CHANNELS: Final = 3
MARKS: Final = 1  # the channel of the lugs
_DARK: Final = 4.0  # grey level below which noise and JPEG artefacts dominate
_ACROSS: Final = (1, 25)  # window of the mean across the trace that is subtracted: 5 cm, half a wheel [px of 2 mm]
_SATURATION: Final = 0.22  # clipping of log brightness: lug and wall marks reach it, shadow edges reach 1 and more
_SURROUNDINGS: Final = (41, 41)  # window of the mean that is subtracted [px]
_CONTRAST: Final = (61, 61)  # window of the contrast normalisation [px]
_NOISE: Final = 0.02  # contrast of the camera's noise on sand, in log brightness
_LUG_ACROSS: Final = (15, 1)  # lug marks are straight over 3 cm, pebbles and ripples are not [px]
_WALL_ALONG: Final = (3, 25)  # walls are straight over 5 cm along [px]


def channels(patch: NDArray[np.uint8]) -> FloatImage:
    """Brightness, strength of lug marks and strength of walls (rows, columns, 3) of a ground image."""
    bright = _normalised(patch)
    lugs = np.abs(_along(_smooth(cv2.GaussianBlur(bright, (0, 0), 1.2), _LUG_ACROSS)))
    walls = np.abs(_across(_smooth(bright, _WALL_ALONG)))
    # saturated at the median strength of marks, so that one bright edge does not dominate
    return np.asarray(cv2.merge([bright, lugs / (lugs + 0.5), walls / (walls + 0.35)]), dtype=np.float32)


def _normalised(patch: NDArray[np.uint8]) -> FloatImage:
    log = np.log(np.arange(256, dtype=np.float32) + _DARK)[patch]
    log -= _smooth(log, _ACROSS)
    np.clip(log, -_SATURATION, _SATURATION, out=log)
    log -= _smooth(log, _SURROUNDINGS)
    # beside an area of one grey level (glare, dirt, a black edge), where its running sums end just below zero
    power = np.maximum(_smooth(log * log, _CONTRAST), np.float32(0.0))
    log /= np.sqrt(power) + np.float32(_NOISE)
    np.clip(log, -2.0, 2.0, out=log)
    return np.asarray(log, dtype=np.float32)


def _smooth(image: ArrayLike, size: tuple[int, int]) -> FloatImage:
    """Mean over (columns, rows)."""
    return np.asarray(cv2.blur(np.asarray(image, dtype=np.float32), size), dtype=np.float32)


def _along(image: FloatImage) -> FloatImage:
    """Differences over 8 mm along the trace, 0 at the ends."""
    out = np.zeros_like(image)
    np.subtract(image[4:], image[:-4], out=out[2:-2])
    return out


def _across(image: FloatImage) -> FloatImage:
    """Differences over 8 mm across the trace, 0 at the ends."""
    out = np.zeros_like(image)
    np.subtract(image[:, 4:], image[:, :-4], out=out[:, 2:-2])
    return out
