"""Ground that a rover drives on: slope, mounds, and a map of heights."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from vehicle.foundation.data_file import read_array, table_text
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightMap:
    """Heights on a square grid, bicubic between its points; beyond an edge the height of the edge continues.

    Raises:
        ValueError: if there are fewer than 4 x 4 points, or one is not finite.
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
        rows, columns = (np.arange(n) for n in self.heights.shape)
        y, x = self.y + self.spacing * rows, self.x + self.spacing * columns
        spline = scipy.interpolate.RectBivariateSpline(y, x, self.heights, s=0)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Mound:
    """A bell-shaped mound, or with a negative height a crater; it is steepest at half a ``radius`` from its top."""

    x: float  # of its top, in W [m]
    y: float  # [m]
    height: float  # [m]
    radius: float  # where the height has fallen to 0.14: two standard deviations of the bell [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Terrain:
    """Large shape of the ground, and its friction where it is firm: without soil, everywhere."""

    slope_x: float = 0.0  # rise along W's x [-]; tan(5 deg) for a slope of 5 deg
    slope_y: float = 0.0  # rise along W's y [-]
    friction: float = 0.6  # of a wheel on firm ground [-]; assumed: a lugged metal wheel on rock or floor
    mounds: tuple[Mound, ...] = ()
    height_map: HeightMap | None = None
    _bells: FloatArray = field(init=False, repr=False, compare=False)  # (n, 4) the mounds' x, y, height, radius [m]

    def __post_init__(self) -> None:
        bells = np.array([(mound.x, mound.y, mound.height, mound.radius) for mound in self.mounds]).reshape(-1, 4)
        object.__setattr__(self, "_bells", bells)

    @property
    def is_uniform(self) -> bool:
        """True if it is one plane."""
        return not self.mounds and self.height_map is None

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        x, y = _common(x, y)
        z: FloatArray = self.slope_x * x + self.slope_y * y
        if self.mounds:
            z = z + np.sum(self._heights(x, y), axis=-1)
        return z if self.height_map is None else z + self.height_map.height(x, y)

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m] in W; (..., 2)."""
        x, y = _common(x, y)
        slope = np.empty((*x.shape, 2))
        slope[...] = self.slope_x, self.slope_y
        if self.mounds:
            steep = (-4.0 / self._bells[:, 3] ** 2) * self._heights(x, y)
            slope[..., 0] += np.sum(steep * (x[..., None] - self._bells[:, 0]), axis=-1)
            slope[..., 1] += np.sum(steep * (y[..., None] - self._bells[:, 1]), axis=-1)
        return slope if self.height_map is None else slope + self.height_map.gradient(x, y)

    def _heights(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Heights of all mounds [m] at x, y [m]; (..., n)."""
        at_x, at_y, height, radius = self._bells.T
        squared = (x[..., None] - at_x) ** 2 + (y[..., None] - at_y) ** 2
        bells: FloatArray = height * np.exp((-2.0 / radius**2) * squared)
        return bells


def _common(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if x.shape != y.shape:
        x, y = np.broadcast_arrays(x, y)
    return x, y
