"""Random maps for the relief and the brightness of a field of sand.

Each map is periodic. Where a period of one metre would be visible, two maps with incommensurate periods are added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from sensors.sand.grid import TEXEL, Floats, Window
from sensors.textures import fractal_noise

COARSE: Final = 8  # texels a side of a coarse cell
_COARSE_SIZE: Final = 768  # cells; repeats after 6.1 m
_FINE_SIZES: Final = (1024, 864)  # texels; both together repeat after 27 m


def _band(longest: float, shortest: float, cell: float) -> tuple[float, float]:
    """Band of wavelengths [m] in cycles per cell."""
    return (cell / longest if np.isfinite(longest) else 0.0, cell / shortest)


@dataclass(frozen=True, slots=True, eq=False)
class CoarseMap:
    """Smooth noise of unit standard deviation in cells of ``COARSE`` texels."""

    cells: Floats  # (n, n)

    @classmethod
    def draw(cls, rng: np.random.Generator, slope: float, shortest: float) -> CoarseMap:
        """Draw noise without wavelengths below ``shortest`` [m]."""
        band = _band(np.inf, shortest, COARSE * TEXEL)
        return cls(fractal_noise(rng, (_COARSE_SIZE, _COARSE_SIZE), slope, band))

    def over(self, window: Window) -> Floats:
        """Values of the map in a window."""
        top, left = window.top // COARSE - 2, window.left // COARSE - 2
        bottom, right = window.bottom // COARSE + 3, window.right // COARSE + 3
        rows, columns = np.arange(top, bottom) % len(self.cells), np.arange(left, right) % len(self.cells)
        size = (COARSE * (right - left), COARSE * (bottom - top))
        fine = cv2.resize(self.cells[np.ix_(rows, columns)], size, interpolation=cv2.INTER_CUBIC)
        outer = Window(COARSE * top, COARSE * left, COARSE * bottom, COARSE * right)
        return np.asarray(fine[window.within(outer)], dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class FineMap:
    """Noise of unit standard deviation, texel by texel."""

    layers: tuple[Floats, ...]

    @classmethod
    def draw(
        cls, rng: np.random.Generator, slope: float, longest: float, shortest: float, *, layers: int = 1
    ) -> FineMap:
        """Draw noise with wavelengths in a band [m], in one layer or in two that do not repeat together."""
        band = _band(longest, shortest, TEXEL)
        sizes = _FINE_SIZES[:layers]
        scale = np.float32(1.0 / np.sqrt(layers))
        return cls(tuple(scale * fractal_noise(rng, (size, size), slope, band) for size in sizes))

    def over(self, window: Window) -> Floats:
        """Values of the map in a window."""
        total: Floats | None = None
        for layer in self.layers:
            part = _wrapped(layer, window)
            total = part if total is None else total + part
        return np.zeros(window.shape, np.float32) if total is None else total


def _wrapped(layer: Floats, window: Window) -> Floats:
    """Window of a periodic map."""
    n = len(layer)
    top, left = window.top % n, window.left % n
    rows, columns = window.shape
    if top + rows <= n and left + columns <= n:
        return layer[top : top + rows, left : left + columns]
    return layer[np.ix_(np.arange(top, top + rows) % n, np.arange(left, left + columns) % n)]
