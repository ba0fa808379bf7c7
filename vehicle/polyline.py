"""Polylines in the plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray


def arc_length(points: FloatArray) -> FloatArray:
    """Distance along the polyline through points (n, 2) from the first point to each of them [m], shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def rows_every(points: FloatArray, spacing: float) -> NDArray[np.intp]:
    """Indices of points (n, 2) about ``spacing`` [m] of arc length apart."""
    along = arc_length(points)
    rows: NDArray[np.intp] = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], spacing)))
    return rows
