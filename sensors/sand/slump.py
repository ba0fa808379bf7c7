"""Sand that is steeper than it can stay slides down."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sensors.sand.grid import TEXEL, Floats

_STEEPEST: Final = np.float32(0.75 * TEXEL)  # from texel to texel: tan 37 deg, the repose of dry sand [m]
_SHARE: Final = np.float32(0.24)  # of what is too much goes to each neighbour at once; a quarter is what stays stable


def slumped(height: Floats, inside: NDArray[np.bool_], sweeps: int) -> Floats:
    """The height map after so many sweeps, in each of which sand moves by one texel within ``inside``."""
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
