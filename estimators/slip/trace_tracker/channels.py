"""What of the ground's picture tells a rut from sand: brightness, the lugs' marks, and the walls.

Logarithms turn shadows into steps, which a clipped high pass leaves as thin lines; the local contrast is brought to
one, so that exposure, contrast and haze do not matter.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimators.slip.trace_tracker.ground_patch import FloatImage

CHANNELS: Final = 3
MARKS: Final = 1  # the channel of the lugs
_DARK: Final = 4.0  # grey level under which noise and JPEG prevail
_ACROSS: Final = (1, 25)  # mean taken off across the trace: 5 cm, half a wheel [px of 2 mm]
_SATURATION: Final = 0.22  # of log brightness: lug and wall marks reach this, shadow edges 1 and more
_SURROUNDINGS: Final = (41, 41)  # mean taken off [px]
_CONTRAST: Final = (61, 61)  # in which the contrast is made one [px]
_NOISE: Final = 0.02  # log brightness: contrast of the camera's noise on sand
_LUG_ACROSS: Final = (15, 1)  # lug marks are straight over 3 cm, pebbles and ripples' details are not [px]
_WALL_ALONG: Final = (3, 25)  # walls are straight over 5 cm along [px]


def channels(patch: NDArray[np.uint8]) -> FloatImage:
    """Brightness, strength of lug marks and strength of walls (rows, columns, 3) of a picture of the ground."""
    bright = _normalised(patch)
    lugs = np.abs(_along(_smooth(cv2.GaussianBlur(bright, (0, 0), 1.2), _LUG_ACROSS)))
    walls = np.abs(_across(_smooth(bright, _WALL_ALONG)))
    # Strengths are compressed at what half of the marks reach: one bright edge must not stand for many.
    return np.asarray(cv2.merge([bright, lugs / (lugs + 0.5), walls / (walls + 0.35)]), dtype=np.float32)


def _normalised(patch: NDArray[np.uint8]) -> FloatImage:
    log = np.log(np.arange(256, dtype=np.float32) + _DARK)[patch]
    log -= _smooth(log, _ACROSS)
    np.clip(log, -_SATURATION, _SATURATION, out=log)
    log -= _smooth(log, _SURROUNDINGS)
    log /= np.sqrt(_smooth(log * log, _CONTRAST)) + np.float32(_NOISE)
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
