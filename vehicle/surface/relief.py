"""Ground along a road: height and bank by the distance along a line, continued level to both sides."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_NEAREST_TO_CENTRE: Final = (
    0.2  # least of 1 - curvature * offset: beyond it, distances along the line are not stretched
)
STEEPEST: Final = 0.2  # slope and bank, as of other surfaces [-]


class RoadRelief:
    """Height and slope of the ground around a line.

    Across the line the ground rises by its bank, up to ``reach`` [m] to either side; beyond that it keeps the height
    of there. The nearest point of the line decides. Beyond its ends the ground is level.

    Raises:
        ValueError: if the line has a slope or bank beyond ``STEEPEST``.
    """

    def __init__(self, line: FloatArray, heights: FloatArray, banks: FloatArray, *, reach: float) -> None:
        """Relief of a line of points (n, 2) closer than a metre, with heights [m] and banks (n,) [-], + rises left."""
        along = arc_length(line)
        self._line, self._along, self._reach = line, along, reach
        self._tree = KDTree(line)
        tangents = np.gradient(line, along, axis=0)
        heading = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
        self._heading, self._curvature = heading, np.gradient(heading, along)
        self._height, self._bank = CubicSpline(along, heights), CubicSpline(along, banks)
        self._slope, self._twist = self._height.derivative(), self._bank.derivative()
        for name, values in (("slope", self._slope(along)), ("bank", banks)):
            worst = int(np.argmax(np.abs(values)))
            if abs(values[worst]) > STEEPEST:
                raise ValueError(f"{name} = {values[worst]:.3f} at {along[worst]:.1f} m must be within {STEEPEST}")

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        s, across, _, _ = self._beside(x, y)
        height: FloatArray = self._height(s) + self._bank(s) * np.clip(across, -self._reach, self._reach)
        return height

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m]; shape (..., 2)."""
        s, across, heading, curvature = self._beside(x, y)
        inside = np.abs(across) < self._reach
        offset = np.clip(across, -self._reach, self._reach)
        along = (self._slope(s) + self._twist(s) * offset) / np.maximum(1.0 - curvature * across, _NEAREST_TO_CENTRE)
        along = np.where((s > 0.0) & (s < self._along[-1]), along, 0.0)
        rise = np.where(inside, self._bank(s), 0.0)
        c, sin = np.cos(heading), np.sin(heading)
        return np.stack([along * c - rise * sin, along * sin + rise * c], axis=-1)

    def _beside(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Distance along the line and to its left [m], heading [rad] and curvature [1/m] of the nearest point."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        _, k = self._tree.query(np.stack([x, y], axis=-1))
        d_x, d_y = x - self._line[k, 0], y - self._line[k, 1]
        c, sin, curvature = np.cos(self._heading[k]), np.sin(self._heading[k]), self._curvature[k]
        ahead, across = c * d_x + sin * d_y, c * d_y - sin * d_x
        ahead = ahead / np.maximum(1.0 - curvature * across, _NEAREST_TO_CENTRE)
        s = np.clip(self._along[k] + ahead, 0.0, self._along[-1])
        return s, across - 0.5 * curvature * ahead**2, self._heading[k] + curvature * ahead, curvature
