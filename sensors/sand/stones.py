"""Pebbles on the sand: shapes drawn once, and their places in each tile of the field."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np

from sensors.sand.grid import TEXEL, Bytes, Floats, Window

SMALLEST, LARGEST = 0.0015, 0.017  # radius of pebbles [m]
_POWER: Final = 1.75  # exponent of the number of pebbles over their radius: shingle, assumed
_SHAPES: Final = 96
_POSITIVE: Final = 1 << 20  # offset that keeps seeds positive: more windows than a field has to any side


class Shape(NamedTuple):
    """Shape of a pebble from above."""

    height: Floats  # (n, n) above the sand [m], nowhere below -1 mm
    inside: Bytes  # (n, n) 1 inside the outline
    radius: float  # [m]


class Pebble(NamedTuple):
    """Pebble in or near a window."""

    shape: Shape
    row: int  # of its middle in the window [texels]
    column: int
    albedo: float  # relative to sand
    tint: float  # 0 sand, 1 grey stone

    def cover(self, size: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Slices of a window of this size that it covers, and of the visible part of its shape."""
        n = len(self.shape.height) // 2
        extent = Window(self.row - n, self.column - n, self.row + n + 1, self.column + n + 1)
        whole = Window(0, 0, *size)
        common = extent.common(whole)
        return common.within(whole), common.within(extent)


@dataclass(frozen=True, slots=True, eq=False)
class Pebbles:
    """Shapes by growing radius, and the density of pebbles."""

    shapes: tuple[Shape, ...]
    density: float  # [1/m2]

    @classmethod
    def draw(cls, rng: np.random.Generator, density: float) -> Pebbles:
        """Draw shapes with the radii of shingle."""
        shares = (np.arange(_SHAPES) + 0.5) / _SHAPES
        radii = np.minimum(SMALLEST * (1.0 - shares) ** (-1.0 / _POWER), LARGEST)
        return cls(tuple(_shape(rng, float(radius)) for radius in radii), density)

    def near(self, seed: int, window: Window) -> list[Pebble]:
        """Pebbles that reach into a window, whose borders are multiples of its size; the same for each neighbour."""
        return [pebble for i in (-1, 0, 1) for j in (-1, 0, 1) for pebble in self._scattered(seed, window, i, j)]

    def _scattered(self, seed: int, window: Window, i: int, j: int) -> list[Pebble]:
        """Pebbles of the window i rows and j columns of windows away that reach into this one."""
        rows, columns = window.shape
        cell = (window.top // rows + i + _POSITIVE, window.left // columns + j + _POSITIVE)
        rng = np.random.default_rng([seed, *cell])
        count = rng.poisson(self.density * rows * columns * TEXEL**2)
        shapes = rng.integers(len(self.shapes), size=count)
        row, column = (rng.integers(side, size=count) + side * shift for side, shift in ((rows, i), (columns, j)))
        albedo, tint = rng.uniform(0.55, 1.15, count), rng.uniform(0.1, 0.8, count)
        reach = np.array([len(shape.height) // 2 for shape in self.shapes])[shapes]
        reaching = (row + reach >= 0) & (row - reach < rows) & (column + reach >= 0) & (column - reach < columns)
        return [
            Pebble(self.shapes[shape], *place)
            for shape, *place in zip(
                *(values[reaching].tolist() for values in (shapes, row, column, albedo, tint)), strict=True
            )
        ]


def _shape(rng: np.random.Generator, radius: float) -> Shape:
    """Draw an irregular, half-buried ellipsoid."""
    reach = math.ceil(1.3 * radius / TEXEL) + 1
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] * TEXEL
    turn, flat = rng.uniform(0.0, math.pi), rng.uniform(0.7, 1.0)
    u, v = x * math.cos(turn) + y * math.sin(turn), (y * math.cos(turn) - x * math.sin(turn)) / flat
    around = np.arctan2(v, u)
    outline = (
        1.0 + 0.1 * np.cos(2.0 * around + rng.uniform(0.0, 6.3)) + 0.08 * np.cos(3.0 * around + rng.uniform(0, 6.3))
    )
    q = (u * u + v * v) / (radius * outline) ** 2
    height = radius * rng.uniform(0.45, 0.85) * (np.clip(1.0 - q, 0.0, 1.0) ** 0.6 - 0.1)
    smooth = cv2.GaussianBlur(height.astype(np.float32), (0, 0), 0.7)
    return Shape(np.asarray(smooth, dtype=np.float32), (q < 1.0).astype(np.uint8), radius)
