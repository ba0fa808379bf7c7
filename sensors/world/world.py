"""The rendered world as plain data, generated from one random stream, and ground that wheels change.

A sinking wheel presses, smears and splashes, so the rear camera sees other ground than the front camera saw at the same
place. Only the appearance is modelled: a strip along every wheel's track shows other ground of the same kind, which may
flow along with the vehicle while it is in view. Wheels come in groups, such as those of one unit of the vehicle; each
group changes the ground again. Relief is not modelled.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors import textures
from sensors.camera.rig import StereoCalibration
from sensors.camera.stereo_camera import PairSource
from sensors.messages import ColourImage
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
from sensors.world.sky import Sunlight, daylight
from sensors.world.things import Mesh
from vehicle.frames import FloatArray, inverse, transform
from vehicle.surface import Surface

_DETAIL_SIZE = 2048  # [px]
_DETAIL_PERIOD = 12.0  # one repeat of the ground's detail: 171 px/m [m]
_MAP_MARGIN = 60.0  # of the road map, with its shadows, around the course [m]
_TEXTURES = (  # by the names of the functions that make them
    *("foliage", "twigs", "bark", "stone", "brick"),
    *("tiles", "planks", "window", "banded", "chevrons"),
)


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
        clearance: distance from the centreline within which only kerb stones stand; at least the road's half width [m].
        sun_azimuth: from north, + east [rad]; None: random.
        sun_elevation: above the horizon [rad]; None: 43 deg.
        overcast: True if clouds hide the sun.
        grain: True for fields of grain beyond the road.
        tarmac_patches: number of patches per 100 m2 of the road.
        lane_lines: (n, k, 2) lines painted on the road, at the points of the centreline, see ``line_map``; None: none.
    """
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
        textures={name: getattr(textures, name)(rng) for name in _TEXTURES},
        panorama=sky.panorama(rng, light),
        light=light,
    )


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


# Offset in W to the ground that is shown after each group: beyond the cameras' view [m]
_OFFSETS = np.array([[1.3, 1.1], [-1.1, 1.3]])
_NEAR = 4.0  # distance from a camera beyond which tracks are out of view [m]
_SUBPIXEL = 4  # fractional bits of pixel coordinates when drawing


class ReformedGround:
    """Renderer of downward cameras above ground that wheels re-form: a ``PairSource`` around another one.

    It stores the body's pose at every call, so the calls have to be in the order of the drive.
    """

    def __init__(
        self, source: PairSource, surface: Surface, wheels: Sequence[FloatArray], *, width: float, flow: float = 0.0
    ) -> None:
        """Renderer around ``source``, for two groups of wheels (n, 2) [m] in the body's frame, the foremost first.

        Each wheel re-forms a strip of ``width`` [m], which moves at ``flow`` times the body's velocity.
        """
        self._source, self._surface, self._width, self._flow = source, surface, width, flow
        self._groups = [np.column_stack([group, np.zeros(len(group)), np.ones(len(group))]) for group in wheels]
        self._bodies: list[FloatArray] = []  # X_WB (4, 4) of every call, oldest first

    @property
    def calibration(self) -> StereoCalibration:
        """Calibration of both cameras."""
        return self._source.calibration

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right image, RGB or RGBA, of cameras carried by a body at X_WB (4, 4)."""
        self._bodies.append(X_WB.copy())
        X_WCl = X_WB @ self.calibration.X_SC
        poses = (X_WCl, X_WCl @ self.calibration.X_ClCr)
        left, right = self._source.render(X_WB)
        for group, offset in zip(self._groups, _OFFSETS, strict=False):
            after = self._source.render(self._displaced(X_WB, offset))
            tracks = np.array([(group @ body.T)[:, :3] for body in self._bodies])  # (calls, n, 3)
            left, right = (
                np.where(self._rolled_pixels(X_WC, tracks)[..., None], new, old)
                for X_WC, new, old in zip(poses, after, (left, right), strict=True)
            )
        return left, right

    def _displaced(self, X_WB: FloatArray, offset: FloatArray) -> FloatArray:
        """Pose of the body above the ground that is shown instead, at the same height above it."""
        here, start = X_WB[:2, 3], self._bodies[0][:2, 3]
        there = here + offset - self._flow * (here - start)  # ground that moves along falls behind more slowly
        rise = float(self._surface.height(*there) - self._surface.height(*here))
        return transform(np.eye(3), np.array([*(there - here), rise])) @ X_WB

    def _rolled_pixels(self, X_WC: FloatArray, tracks: FloatArray) -> NDArray[np.bool_]:
        """Mask (height, width) of a camera's pixels that show ground along the wheels' ``tracks`` (calls, n, 3)."""
        c = self.calibration
        mask = np.zeros((c.height, c.width), dtype=np.uint8)
        near = np.hypot(*np.moveaxis(tracks[..., :2] - X_WC[:2, 3], -1, 0)) < _NEAR
        X_CW = inverse(X_WC)
        for wheel in range(tracks.shape[1]):
            points = tracks[near[:, wheel], wheel] @ X_CW[:3, :3].T + X_CW[:3, 3]
            if len(points) > 1:
                pixels = c.focal_length * points[:, :2] / points[:, 2:] + (c.cx, c.cy)
                thickness = max(1, round(self._width * c.focal_length / float(points[:, 2].mean())))
                line = np.rint(pixels * (1 << _SUBPIXEL)).astype(np.int32)
                cv2.polylines(mask, [line], isClosed=False, color=1, thickness=thickness, shift=_SUBPIXEL)
        return mask > 0
