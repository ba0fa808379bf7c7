"""Slumping of sand that is steeper than its slope of repose."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sensors.sand.grid import TEXEL, Floats

_STEEPEST: Final = np.float32(0.75 * TEXEL)  # height between texels at the slope of repose of dry sand, tan 37 deg [m]
_SHARE: Final = np.float32(0.24)  # of the excess height that moves in a sweep; above a quarter it is unstable


def slumped(height: Floats, inside: NDArray[np.bool_], sweeps: int) -> Floats:
    """Height map after some sweeps; in each of them sand moves by at most one texel within ``inside``."""
    ground = height.copy()
    down = (ground[:-1], ground[1:], _SHARE * (inside[1:] & inside[:-1]))
    right = (ground[:, :-1], ground[:, 1:], _SHARE * (inside[:, 1:] & inside[:, :-1]))
    for _ in range(sweeps):
        for one, other, free in (down, right):
            step = other - one
            slide = (step - np.minimum(np.maximum(step, -_STEEPEST), _STEEPEST)) * free
            one += slide
            other -= slide
    return ground
