"""Ground along a road: height and bank by the distance along a line, continued level to both sides."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from vehicle.frames import FloatArray
from vehicle.surface.beside_line import BesideLine

STEEPEST: Final = 0.2  # slope and bank, as of other surfaces [-]


class Relief(Protocol):
    """Height of ground above a plane or cone."""

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        ...

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m]; shape (..., 2)."""
        ...


class RoadRelief:
    """Height and slope of the ground around a line.

    Across the line the ground rises by its bank, up to ``reach`` [m] to either side; beyond that it keeps the height
    of there. The nearest point of the line decides. Beyond its ends the ground is level.

    Raises:
        ValueError: if the line has a slope or bank beyond ``STEEPEST``.
    """

    def __init__(self, line: FloatArray, heights: FloatArray, banks: FloatArray, *, reach: float) -> None:
        """Relief of a line of points (n, 2) closer than a metre, with heights [m] and banks (n,) [-], + rises left."""
        self._beside, self._reach = BesideLine(line), reach
        along = self._beside.along
        self._height, self._bank = CubicSpline(along, heights), CubicSpline(along, banks)
        self._slope, self._twist = self._height.derivative(), self._bank.derivative()
        for name, values in (("slope", self._slope(along)), ("bank", banks)):
            worst = int(np.argmax(np.abs(values)))
            if abs(values[worst]) > STEEPEST:
                raise ValueError(f"{name} = {values[worst]:.3f} at {along[worst]:.1f} m must be within {STEEPEST}")

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        s, across, _, _ = self._beside.at(x, y)
        height: FloatArray = self._height(s) + self._bank(s) * np.clip(across, -self._reach, self._reach)
        return height

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m]; shape (..., 2)."""
        s, across, heading, stretch = self._beside.at(x, y)
        inside = np.abs(across) < self._reach
        offset = np.clip(across, -self._reach, self._reach)
        along = (self._slope(s) + self._twist(s) * offset) / stretch
        along = np.where((s > 0.0) & (s < self._beside.along[-1]), along, 0.0)
        rise = np.where(inside, self._bank(s), 0.0)
        c, sin = np.cos(heading), np.sin(heading)
        return np.stack([along * c - rise * sin, along * sin + rise * c], axis=-1)


class SumOfReliefs:
    """Several reliefs on top of each other."""

    def __init__(self, *reliefs: Relief) -> None:
        self._reliefs = reliefs

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        return np.asarray(sum(relief.height(x, y) for relief in self._reliefs))

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m]; shape (..., 2)."""
        return np.asarray(sum(relief.gradient(x, y) for relief in self._reliefs))
