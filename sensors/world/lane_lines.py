"""Lines painted between the lanes of a road, as distances on its map.

Interpolated distances must be smooth where a line is. So the distance across has a sign, which changes at the line, and
neighbouring lines count in opposite directions: between them the distance saturates instead of jumping.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from sensors.textures import NoiseArray
from sensors.world.ground import RoadMap
from vehicle.frames import FloatArray
from vehicle.surface.beside_line import BesideLine

_DASH, _PERIOD = 3.0, 12.0  # of a broken line [m]
_COARSEST: Final = 0.8  # cell of a map on which lanes can be told from each other [m]
_PART: Final = 65_536  # nodes at a time


def line_range(road: RoadMap) -> float:
    """Greatest distance on the map of lines [m]: beyond all nodes around a place on a line."""
    return 2.0 * road.cell


def line_map(road: RoadMap, centreline: FloatArray, lines: FloatArray) -> NoiseArray | None:
    """Lines on the nodes of a road's map (ny, nx, 2); None if its cells are wider than a part of a lane.

    Args:
        road: the map.
        centreline: of the road, points (n, 2) closer than a metre [m].
        lines: (n, k, 2) at those points, from right to left: place to the left of the centreline [m], NaN for none;
            1 if the line is broken, 0 if it is solid.

    Returns:
        Distance across from the nearest line, with a sign, and distance along into a line from its end, negative
        outside; both within ``line_range``, the second one at its least where no line is near [m].
    """
    if road.cell > _COARSEST:
        return None
    limit = line_range(road)
    table = np.full((*road.edge_distance.shape, 2), -limit, dtype=np.float32)
    rows, columns = np.nonzero(road.edge_distance < 0.0)
    beside = BesideLine(centreline)
    for first in range(0, len(rows), _PART):
        part = rows[first : first + _PART], columns[first : first + _PART]
        along, across, _, _ = beside.at(road.origin[0] + road.cell * part[1], road.origin[1] + road.cell * part[0])
        table[part] = np.clip(_beside_lines(along, across, beside.along, lines, 1.5 * road.cell), -limit, limit)
    return table


def _beside_lines(
    along: FloatArray, across: FloatArray, stations: FloatArray, lines: FloatArray, near: float
) -> FloatArray:
    """Distances (m, 2) of places along and across (m,) from lines at stations [m], without a limit."""
    after = np.clip(np.searchsorted(stations, along), 1, len(stations) - 1)
    share = (along - stations[after - 1]) / (stations[after] - stations[after - 1])
    offsets = lines[after - 1, :, 0] + share[:, None] * (lines[after, :, 0] - lines[after - 1, :, 0])
    gaps = across[:, None] - offsets
    distances = np.where(np.isnan(gaps), np.inf, np.abs(gaps))
    nearest = np.argmin(distances, axis=1)
    at = np.arange(len(along)), nearest
    is_near = distances[at] < near
    sign = np.where(nearest % 2 == 0, 1.0, -1.0)
    broken = lines[after, nearest, 1] > 0.5
    into_dash = np.abs(along % _PERIOD - 0.5 * _PERIOD) - 0.5 * (_PERIOD - _DASH)
    into = np.where(broken, into_dash, _DASH)
    signed = np.where(np.isfinite(distances[at]), sign * gaps[at], near)
    return np.stack([signed, np.where(is_near, into, -np.inf)], axis=1)
