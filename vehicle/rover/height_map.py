"""Map of ground heights on a grid, smooth between its points."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from vehicle.array_file import read_array
from vehicle.frames import FloatArray
from vehicle.table_file import table_text
from vehicle.user_file import shown


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightMap:
    """Heights on a square grid, bicubic between its points; beyond an edge the height of the edge continues.

    Raises:
        ValueError: if there are fewer than 4 x 4 points, one is not finite, or the spacing is not positive.
    """

    heights: FloatArray  # (n_y, n_x) [m]
    spacing: float  # of the grid [m]
    x: float = 0.0  # of the first column, in W [m]
    y: float = 0.0  # of the first row, in W [m]
    _spline: Any = field(init=False, repr=False)
    _slopes: Any = field(init=False, repr=False)  # its derivatives along x and y

    def __post_init__(self) -> None:
        if self.heights.ndim != 2 or min(self.heights.shape) < 4:
            raise ValueError(f"heights must be at least 4 x 4 points, got shape {self.heights.shape}")
        if not np.all(np.isfinite(self.heights)):
            raise ValueError("heights [m] must all be finite")
        if not self.spacing > 0.0:
            raise ValueError(f"spacing = {self.spacing} m must be positive")
        rows, columns = (np.arange(n) for n in self.heights.shape)
        spline = RectBivariateSpline(self.y + self.spacing * rows, self.x + self.spacing * columns, self.heights, s=0)
        object.__setattr__(self, "_spline", spline)
        object.__setattr__(self, "_slopes", (spline.partial_derivative(0, 1), spline.partial_derivative(1, 0)))

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        z: FloatArray = self._spline.ev(*self._inside(x, y))
        return z

    def gradient(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m] in W; (..., 2)."""
        v, u = self._inside(x, y)
        slope = np.stack([along(v, u, grid=False) for along in self._slopes], axis=-1)
        return np.where(np.stack([u == x, v == y], axis=-1), slope, 0.0)

    def _inside(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nearest place on the grid: y, then x [m]."""
        n_y, n_x = self.heights.shape
        return (
            np.minimum(np.maximum(y, self.y), self.y + self.spacing * (n_y - 1)),
            np.minimum(np.maximum(x, self.x), self.x + self.spacing * (n_x - 1)),
        )


def load_height_map(path: str, spacing: float, *, x: float = 0.0, y: float = 0.0) -> HeightMap:
    """Load a height map: heights [m] in rows of growing y, as ``.npy`` or as comma-separated text.

    Raises:
        ValueError: one line, if the file cannot be read or is not a table of numbers.
    """
    file = Path(path)
    heights = read_array(file) if file.suffix == ".npy" else _from_text(file)
    try:
        return HeightMap(heights=heights.astype(np.float64), spacing=spacing, x=x, y=y)
    except ValueError as error:
        raise ValueError(f"{path}: not a table of heights: {error}") from error


def _from_text(path: Path) -> FloatArray:
    lines = [line for line in table_text(path).splitlines() if line.partition("#")[0].strip()]
    if not lines:
        raise ValueError(f"{path}: not a table of heights: it contains no numbers")
    try:
        return np.loadtxt(lines, delimiter=",", ndmin=2)
    except ValueError as error:
        raise ValueError(f"{path}: not a table of heights: {shown(str(error))}") from error
