"""The rendered world as plain data: ground, things, sky and light, generated from one random stream."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors import textures
from sensors.textures import TextureArray
from sensors.world import sky
from sensors.world.ground import (
    Centreline,
    Condition,
    Landscape,
    RoadMap,
    condition_of,
    ground_mesh,
    line_map,
    road_map,
)
from sensors.world.scenery import Instances, Site, grain_fields, kerbs, patched, planted
from sensors.world.shapes import Mesh
from sensors.world.sky import Sunlight, daylight
from vehicle.foundation.quantity import check_number
from vehicle.frames import FloatArray
from vehicle.surface import Surface

_DETAIL_SIZE = 2048  # [px]
_DETAIL_PERIOD = 12.0  # one repeat of the ground's detail: 171 px/m [m]
_MAP_MARGIN = 60.0  # of the road map, with its shadows, around the course [m]
_MAX_DENSITY = 2.0
_TEXTURES: dict[str, Callable[[np.random.Generator], TextureArray]] = {
    "foliage": textures.foliage,
    "twigs": textures.twigs,
    "bark": textures.bark,
    "stone": textures.stone,
    "brick": textures.brick,
    "tiles": textures.tiles,
    "planks": textures.planks,
    "window": textures.window,
    "banded": textures.banded,
    "chevrons": textures.chevrons,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """Input of a renderer; independent of the rendering method."""

    ground: Mesh
    detail: TextureArray  # (n, n, 4) relative brightness of asphalt, grass, gravel; mask of patches
    detail_period: float  # [m]
    road: RoadMap
    condition: Condition  # of the ground
    scenery: tuple[Instances, ...]  # things that do not move
    textures: dict[str, TextureArray]  # by the names that the things use; a fourth channel is the opacity
    panorama: TextureArray  # see sensors.world.sky
    light: Sunlight
    moving: tuple[Instances, ...] = ()  # things that a renderer moves between images; they throw soft shadows


def build_world(
    *,
    rng: np.random.Generator,
    centreline: FloatArray,
    road_half_width: float | FloatArray,
    surface: Surface,
    scenery_density: float,
    clearance: float,
    sun_azimuth: float | None = None,
    sun_elevation: float | None = None,
    overcast: bool = False,
    grain: bool = False,
    tarmac_patches: float = 0.0,
    lane_lines: FloatArray | None = None,
) -> World:
    """The world around a road.

    Args:
        rng: of everything random.
        centreline: polyline (n, 2) of the road's middle [m]; it may meet and cross itself.
        road_half_width: everywhere, or (n, 2) to the left and right of the points of the centreline [m].
        surface: shape of the ground up to 100 m beyond the centreline's bounding box.
        scenery_density: number of things relative to the reference, 0 (bare ground and sky) to 2.
        clearance: distance from the centreline within which only kerb stones stand [m].
        sun_azimuth: from north, + east [rad]; None: random.
        sun_elevation: above the horizon [rad]; None: 43 deg.
        overcast: True if clouds hide the sun.
        grain: True for fields of grain beyond the road.
        tarmac_patches: number of patches per 100 m2 of the road.
        lane_lines: (n, k, 2) lines painted on the road, at the points of the centreline, see ``line_map``; None: none.

    Raises:
        ValueError: naming the argument that is out of its range.
    """
    _check(centreline, road_half_width, scenery_density, clearance)
    low, high = centreline.min(axis=0), centreline.max(axis=0)
    landscape = Landscape(rng, surface, low, high)
    line = Centreline(centreline, road_half_width)
    chance = rng.uniform(0.0, 2.0 * np.pi)
    light = daylight(chance, azimuth=sun_azimuth, elevation=sun_elevation, overcast=overcast)
    scenery: list[Instances] = []
    if scenery_density > 0.0:
        site = Site(rng, line, landscape, clearance, scenery_density)
        scenery = [kerbs(site), *planted(site)]
    if grain:
        scenery.append(grain_fields(rng, line, landscape))
    road = road_map(rng, line, low - _MAP_MARGIN, high + _MAP_MARGIN)
    if tarmac_patches > 0.0:
        road = patched(rng, road, tarmac_patches)
    if lane_lines is not None:
        road = replace(road, lines=line_map(road, centreline, lane_lines))
    return World(
        ground=ground_mesh(rng, landscape, line, low, high),
        detail=textures.ground_detail(rng, _DETAIL_SIZE),
        detail_period=_DETAIL_PERIOD,
        road=replace(road, light=_shadows(road, scenery, light.direction)),
        condition=condition_of(surface, road),
        scenery=tuple(instances for instances in scenery if len(instances.poses)),
        textures={name: make(rng) for name, make in _TEXTURES.items()},
        panorama=sky.panorama(rng, light),
        light=light,
    )


def _check(
    centreline: FloatArray, road_half_width: float | FloatArray, scenery_density: float, clearance: float
) -> None:
    if centreline.ndim != 2 or centreline.shape[1] != 2 or len(centreline) < 2:
        raise ValueError(f"centreline of shape {centreline.shape} must be (n, 2) with n >= 2 points [m]")
    narrowest, widest = float(np.min(road_half_width)), float(np.max(road_half_width))
    if narrowest <= 0.0:
        raise ValueError(f"road_half_width = {narrowest} m must be positive")
    check_number("scenery_density", scenery_density, 0.0, _MAX_DENSITY)
    if clearance < widest:
        raise ValueError(f"clearance = {clearance} m must be at least road_half_width = {widest} m")


def _shadows(road: RoadMap, scenery: list[Instances], sun: FloatArray) -> NDArray[np.float32]:
    """Sunlight on the map's nodes: dark in the shadow of each part of a thing, projected along the sun's rays."""
    light = np.ones(road.light.shape, dtype=np.float32)
    for instances in scenery:
        for part in instances.thing.nearest_parts:
            for pose in instances.poses:
                points = part.mesh.vertices @ pose[:3, :3].T  # relative to the foot
                shadow = points[:, :2] - np.maximum(points[:, 2:], 0.0) * sun[:2] / sun[2]
                outline = cv2.convexHull(((shadow + pose[:2, 3] - road.origin) / road.cell).astype(np.float32))
                cv2.fillConvexPoly(light, np.round(outline * 16.0).astype(np.int32), 0.0, shift=4)
    soft = cv2.GaussianBlur(light, (0, 0), 0.35 / road.cell)
    soft[[0, -1]], soft[:, [0, -1]] = 1.0, 1.0
    return np.asarray(soft, dtype=np.float32)
