"""Grid of texels that represents the sand, windows of it, and slumping of what is too steep.

Texel (row, column) has its centre at x = column * TEXEL, y = row * TEXEL in W; arrays are [row, column].
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
TEXEL: Final = 1e-3  # [m]
_STEEPEST: Final = np.float32(0.75 * TEXEL)  # height between texels at the slope of repose of dry sand, tan 37 deg [m]
_SHARE: Final = np.float32(0.24)  # of the excess height that moves in a sweep; above a quarter it is unstable


class Window(NamedTuple):
    """Rectangle of texels; ``bottom`` and ``right`` are exclusive."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.bottom - self.top, self.right - self.left

    def grown(self, by: int) -> Window:
        """Window with a margin of ``by`` texels on each side."""
        return Window(self.top - by, self.left - by, self.bottom + by, self.right + by)

    def common(self, other: Window) -> Window:
        """Intersection of two windows; it may be empty."""
        return Window(
            max(self.top, other.top),
            max(self.left, other.left),
            min(self.bottom, other.bottom),
            min(self.right, other.right),
        )

    @property
    def is_empty(self) -> bool:
        """True if the window has no texels."""
        return self.bottom <= self.top or self.right <= self.left

    def within(self, outer: Window) -> tuple[slice, slice]:
        """Slices of its texels in an array of the outer window."""
        return (
            slice(self.top - outer.top, self.bottom - outer.top),
            slice(self.left - outer.left, self.right - outer.left),
        )

    def places(self) -> tuple[Floats, Floats]:
        """x (1, columns) and y (rows, 1) of its texels relative to the first one, to keep float32 precise [m]."""
        rows, columns = self.shape
        x = np.arange(columns, dtype=np.float32)[None, :] * np.float32(TEXEL)
        y = np.arange(rows, dtype=np.float32)[:, None] * np.float32(TEXEL)
        return x, y

    @property
    def corner(self) -> FloatArray:
        """Place of the first texel in W (2,) [m]."""
        return np.array([self.left * TEXEL, self.top * TEXEL])


def window_around(points: FloatArray, margin: float) -> Window:
    """Smallest window with all points (n, 2) of W [m] and a margin around them [m]."""
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return Window(
        math.floor(low[1] / TEXEL),
        math.floor(low[0] / TEXEL),
        math.ceil(high[1] / TEXEL) + 1,
        math.ceil(high[0] / TEXEL) + 1,
    )


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
