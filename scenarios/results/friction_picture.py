"""Friction of the ground around a run, on a grid of cells, for drawings."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from vehicle.frames import FloatArray
from vehicle.surface import Surface

_CELLS: Final = 600  # along the longer side
_SMALLEST: Final = 0.05  # cell [m]
_BESIDE: Final = 10.0  # of the road that is in the picture [m]


class FrictionPicture(NamedTuple):
    """Friction in the middles of square cells."""

    values: FloatArray  # (rows of growing y, columns of growing x) [-]
    low: FloatArray  # (2,) lower left corner of the grid in W [m]
    high: FloatArray  # (2,) its upper right corner [m]


def friction_picture(surface: Surface, road: FloatArray) -> FrictionPicture | None:
    """The friction around a road (n, 2) [m]; None if it is the same everywhere there."""
    if surface.is_uniform:
        return None
    low, high = road.min(axis=0) - _BESIDE, road.max(axis=0) + _BESIDE
    cell = max(_SMALLEST, float((high - low).max()) / _CELLS)
    columns, rows = np.ceil((high - low) / cell).astype(int).tolist()
    x, y = (start + cell * (np.arange(n) + 0.5) for start, n in zip(low, (columns, rows), strict=True))
    values = surface.friction_at(*np.meshgrid(x, y))
    if np.ptp(values) == 0.0:
        return None
    return FrictionPicture(values, low, low + cell * np.array([columns, rows]))
