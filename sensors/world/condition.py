"""Appearance of the ground's friction and potholes: wet, muddy or icy ground, and holes in the road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.textures import NoiseArray
from sensors.world.ground import RoadMap
from vehicle.frames import FloatArray
from vehicle.surface import Potholes, Surface

# Appearance by friction: breakpoints of friction [-] and the share of the appearance there. Wet asphalt has 0.5 to 0.6,
# muddy or snowy ground 0.3 to 0.4, ice 0.1 to 0.2; from 0.65 on the road is dry.
_WET = ((0.41, 0.46, 0.60, 0.65), (0.0, 1.0, 1.0, 0.0))
_MUDDY = ((0.22, 0.27, 0.41, 0.46), (0.0, 1.0, 1.0, 0.0))
_ICY = ((0.22, 0.27), (1.0, 0.0))
_FADE = (4.0, 10.0)  # distances from the road's edge between which the appearance fades to dry [m]
_NO_HOLE = (1e6, 1e6, 1.0, 0.0)  # far away
_SURROUNDINGS = 1.5  # extent of a pothole's broken edge and cracks from its middle [radii]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Condition:
    """Condition of the ground on the nodes of its RoadMap."""

    looks: NoiseArray | None  # (ny, nx, 3) wet, muddy and icy appearance, 0 to 1; None: dry everywhere
    holes: NoiseArray | None  # (ny, nx, 4) x, y of the middle, radius, depth of the pothole there [m]; None: none


def condition_of(surface: Surface, road: RoadMap) -> Condition:
    """Condition of a surface; one of uniform friction looks dry."""
    potholes = surface.roughness.potholes if surface.roughness else None
    return Condition(
        looks=None if surface.is_uniform else _looks(surface, road),
        holes=_holes(potholes, road) if potholes else None,
    )


def _looks(surface: Surface, road: RoadMap) -> NoiseArray:
    ny, nx = road.light.shape
    x, y = np.meshgrid(road.origin[0] + road.cell * np.arange(nx), road.origin[1] + road.cell * np.arange(ny))
    friction = surface.friction_at(x, y)
    near = np.interp(road.edge_distance, _FADE, (1.0, 0.0))
    return np.stack([near * np.interp(friction, *look) for look in (_WET, _MUDDY, _ICY)], axis=-1).astype(np.float32)


def _holes(potholes: Potholes, road: RoadMap) -> NoiseArray:
    """Pothole of every node: the one whose surroundings reach closest to its cell."""
    ny, nx = road.light.shape
    holes = np.full((ny, nx, 4), _NO_HOLE, dtype=np.float32)
    nearest = np.full((ny, nx), 0.71 * road.cell)  # half a cell's diagonal: the pixels that look this node up [m]
    for hole in np.column_stack([potholes.x, potholes.y, 0.5 * potholes.diameter, potholes.depth]):
        reach = _SURROUNDINGS * hole[2]
        window, distance = _window(road, hole[:2], reach + road.cell)
        closer = distance - reach < nearest[window]
        nearest[window][closer] = (distance - reach)[closer]
        holes[window][closer] = hole
    return holes


def _window(road: RoadMap, middle: FloatArray, reach: float) -> tuple[tuple[slice, slice], FloatArray]:
    """Part of the map around a point, and the distances of its nodes from the point [m]."""
    u, v = (middle - road.origin) / road.cell
    radius = reach / road.cell
    rows, columns = (slice(max(int(w - radius), 0), max(int(w + radius) + 2, 0)) for w in (v, u))
    ny, nx = road.light.shape
    j, i = np.arange(ny)[rows], np.arange(nx)[columns]
    return (rows, columns), road.cell * np.hypot(j[:, None] - v, i[None, :] - u)
