"""What the friction of the ground and its potholes look like: wet, muddy or icy ground, and holes in the road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.world.ground import RoadMap
from sensors.world.textures import NoiseArray
from vehicle.frames import FloatArray
from vehicle.surface import Potholes, Surface

# What a friction looks like, as breakpoints of friction [-] and the share of each look there: wet asphalt has some 0.5
# to 0.6, muddy or snowy ground 0.3 to 0.4, ice 0.1 to 0.2, and from 0.65 on the road is dry.
_WET = ((0.41, 0.46, 0.60, 0.65), (0.0, 1.0, 1.0, 0.0))
_MUDDY = ((0.22, 0.27, 0.41, 0.46), (0.0, 1.0, 1.0, 0.0))
_ICY = ((0.22, 0.27), (1.0, 0.0))
_BESIDE = (4.0, 10.0)  # beyond the road's edge looks fade between these: nobody drives there, and weather ends [m]
_NOWHERE = (1e6, 1e6, 1.0, 0.0)  # a pothole that is not there
_SURROUNDINGS = 1.5  # broken edge and cracks of a pothole are seen this far from its middle [radii]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Condition:
    """The condition of the ground on the nodes of its RoadMap."""

    looks: NoiseArray | None  # (ny, nx, 3) how wet, how muddy and how icy it is, 0..1; None: dry everywhere
    holes: NoiseArray | None  # (ny, nx, 4) W of the middle, radius and depth of the pothole there [m]; None: none


def condition_of(surface: Surface, road: RoadMap) -> Condition:
    """The condition of a surface; where all of it has one friction, it looks dry."""
    potholes = surface.roughness.potholes if surface.roughness else None
    return Condition(
        looks=None if surface.is_uniform else _looks(surface, road),
        holes=_holes(potholes, road) if potholes else None,
    )


def _looks(surface: Surface, road: RoadMap) -> NoiseArray:
    ny, nx = road.light.shape
    x, y = np.meshgrid(road.origin[0] + road.cell * np.arange(nx), road.origin[1] + road.cell * np.arange(ny))
    friction = surface.friction_at(x, y)
    near = np.interp(road.edge_distance, _BESIDE, (1.0, 0.0))
    return np.stack([near * np.interp(friction, *look) for look in (_WET, _MUDDY, _ICY)], axis=-1).astype(np.float32)


def _holes(potholes: Potholes, road: RoadMap) -> NoiseArray:
    """For every node the pothole whose surroundings reach closest to its cell's pixels."""
    ny, nx = road.light.shape
    holes = np.full((ny, nx, 4), _NOWHERE, dtype=np.float32)
    nearest = np.full((ny, nx), 0.71 * road.cell)  # half a cell's diagonal: pixels that look this node up [m]
    for hole in np.column_stack([potholes.x, potholes.y, 0.5 * potholes.diameter, potholes.depth]):
        reach = _SURROUNDINGS * hole[2]
        window, distance = _window(road, hole[:2], reach + road.cell)
        closer = distance - reach < nearest[window]
        nearest[window][closer] = (distance - reach)[closer]
        holes[window][closer] = hole
    return holes


def _window(road: RoadMap, middle: FloatArray, reach: float) -> tuple[tuple[slice, slice], FloatArray]:
    """The part of the map around a place, and the distance of its nodes from there [m]."""
    u, v = (middle - road.origin) / road.cell
    around = reach / road.cell
    rows, columns = (slice(max(int(w - around), 0), max(int(w + around) + 2, 0)) for w in (v, u))
    ny, nx = road.light.shape
    j, i = np.arange(ny)[rows], np.arange(nx)[columns]
    return (rows, columns), road.cell * np.hypot(j[:, None] - v, i[None, :] - u)
