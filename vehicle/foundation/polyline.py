"""Polylines in the plane."""

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray


def arc_length(points: FloatArray) -> FloatArray:
    """Distance along the polyline through points (n, 2) from the first point to each of them [m], shape (n,)."""
    chords = points[1:] - points[:-1]
    along = np.zeros(len(chords) + 1)
    np.cumsum(np.hypot(chords[:, 0], chords[:, 1]), out=along[1:])
    return along


def resampled(points: FloatArray, stations: FloatArray) -> FloatArray:
    """Points (m, 2) at distances ``stations`` (m,) along the polyline through points (n, 2) [m]."""
    along = arc_length(points)
    return np.stack([np.interp(stations, along, points[:, i]) for i in range(2)], axis=1)


def dense(points: FloatArray, spacing: float) -> tuple[FloatArray, float]:
    """Points (m, 2) about ``spacing`` [m] apart from one end of the polyline to the other, and their spacing [m]."""
    length = float(arc_length(points)[-1])
    stations = np.linspace(0.0, length, max(2, int(length / spacing) + 1))
    return resampled(points, stations), float(stations[1])


def sides(line: FloatArray, half_width: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Left and right edge (n, 2) of a strip along a line (n, 2) [m].

    Its half width is one number, or (n, 2) to the left and to the right at the points of the line [m].
    """
    along = np.gradient(line, axis=0)
    along /= np.maximum(np.hypot(*along.T), 1e-12)[:, None]  # repeated points have no direction
    left = np.column_stack([-along[:, 1], along[:, 0]])
    widths = np.broadcast_to(half_width, (len(line), 2))
    return line + widths[:, :1] * left, line - widths[:, 1:] * left


def is_left(line: FloatArray, nearest: NDArray[np.intp], xy: FloatArray) -> NDArray[np.bool_]:
    """True for positions (..., 2) [m] to the left of their nearest points (...) of a line (n, 2) [m]."""
    before, after = np.maximum(nearest - 1, 0), np.minimum(nearest + 1, len(line) - 1)
    along, away = line[after] - line[before], xy - line[nearest]
    left: NDArray[np.bool_] = along[..., 0] * away[..., 1] > along[..., 1] * away[..., 0]
    return left


def rows_every(points: FloatArray, spacing: float) -> NDArray[np.intp]:
    """Indices of points (n, 2) about ``spacing`` [m] of arc length apart."""
    along = arc_length(points)
    rows: NDArray[np.intp] = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], spacing)))
    return rows
