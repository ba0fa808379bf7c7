"""Placement of things along a road, and the surroundings of a country airfield."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.world import things
from sensors.world.ground import Centreline, Landscape, RoadMap
from sensors.world.things import (
    TWIGS_RANGE,
    Colour,
    Mesh,
    Part,
    Thing,
    box,
    cards,
    grid_faces,
    joined,
    polygon,
    smooth_normals,
)
from vehicle.frames import FloatArray, arc_length, resampled

_GAP = 0.5  # between neighbouring things [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Instances:
    """All instances of one kind of thing."""

    thing: Thing
    poses: FloatArray  # (n, 4, 4) pose in W, times a uniform scale
    brightness: FloatArray  # (n,) multiplies the colour


@dataclass(frozen=True, slots=True, kw_only=True)
class Density:
    """Number, distances and sizes of randomly placed things."""

    per_hectare: float  # number on 10 000 m2 at reference density [-]
    nearest: float  # distance of its edge beyond the clearance [m]
    farthest: float  # from the centreline [m]
    scale: tuple[float, float] = (1.0, 1.0)
    at_most: int = 300  # limits the number of triangles of a long course


class Site:
    """The land around the course, with the space already taken."""

    def __init__(
        self, rng: np.random.Generator, centreline: Centreline, landscape: Landscape, clearance: float, density: float
    ) -> None:
        self.rng, self.centreline, self.landscape = rng, centreline, landscape
        self.clearance, self.density = clearance, density
        self._taken = np.empty((0, 3))  # x, y, radius [m]

    def scatter(self, thing: Thing, density: Density) -> Instances:
        """Instances of a thing at random free places."""
        low, high = (f(self.centreline.points, axis=0) for f in (np.min, np.max))
        low, high = low - density.farthest, high + density.farthest
        wanted = self.density * density.per_hectare * float(np.prod(high - low)) * 1e-4
        places = self.rng.uniform(low, high, size=(min(round(wanted), density.at_most), 2))
        scales = self.rng.uniform(*density.scale, size=len(places))
        yaws = self.rng.uniform(0.0, 2.0 * math.pi, size=len(places))
        distance = self.centreline.distance(places)
        kept = [
            i
            for i in range(len(places))
            if distance[i] < density.farthest
            and distance[i] - thing.radius * scales[i] > self.clearance + density.nearest
            and self.take(places[i], thing.radius * scales[i])
        ]
        return self.instances(thing, places[kept], yaws[kept], scales[kept])

    def take(self, place: FloatArray, radius: float) -> bool:
        """Reserve a circle if it is free; True on success."""
        apart = np.hypot(*(self._taken[:, :2] - place).T) - self._taken[:, 2] - radius
        if (apart < _GAP).any():
            return False
        self._taken = np.append(self._taken, [[*place, radius]], axis=0)
        return True

    def row(
        self, thing: Thing, length: float, *, start: FloatArray, yaw: float, pieces: int
    ) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 2) and headings (n,) of a straight row, without the pieces that would not be clear."""
        steps = np.arange(pieces)[:, None] * length
        places = start + steps * np.array([math.cos(yaw), math.sin(yaw)])
        free = self.centreline.distance(places) - thing.radius > self.clearance + 1.0
        kept = [i for i in np.flatnonzero(free) if self.take(places[i], 0.5 * length - 0.5 * _GAP - 0.01)]
        return places[kept], np.full(len(kept), yaw)

    def rows(self, thing: Thing, length: float, *, per_hectare: float, pieces: tuple[int, int]) -> Instances:
        """Several straight rows, such as hedges and fences along fields."""
        low, high = self.centreline.points.min(axis=0) - 45.0, self.centreline.points.max(axis=0) + 45.0
        wanted = min(round(self.density * per_hectare * float(np.prod(high - low)) * 1e-4), 24)
        places, yaws = [np.empty((0, 2))], [np.empty(0)]
        for _ in range(wanted):
            start, yaw = self.rng.uniform(low, high), self.rng.uniform(0.0, 2.0 * math.pi)
            place, heading = self.row(thing, length, start=start, yaw=yaw, pieces=int(self.rng.integers(*pieces)))
            places.append(place)
            yaws.append(heading)
        every = np.concatenate(places)
        return self.instances(thing, every, np.concatenate(yaws), np.ones(len(every)))

    def along_road(self, thing: Thing, *, spacing: float, turned: float) -> Instances:
        """Things on both sides of the road at the edge of the clearance, facing along it, ``spacing`` apart."""
        step = max(1, round(spacing / self.centreline.spacing / max(self.density, 0.1)))
        places, yaws = [np.empty((0, 2))], [np.empty(0)]
        for side in (1.0, -1.0):
            line = self.centreline.offset(side * (self.clearance + thing.radius + 0.3))
            heading = np.unwrap(np.arctan2(*np.gradient(line, axis=0)[:, ::-1].T))
            first = int(self.rng.integers(step))
            place, yaw = line[first::step], heading[first::step] + (turned if side > 0 else turned + math.pi)
            clear = self.centreline.distance(place) - thing.radius > self.clearance
            kept = [i for i in np.flatnonzero(clear) if self.take(place[i], thing.radius)]
            places.append(place[kept])
            yaws.append(yaw[kept])
        every = np.concatenate(places)
        return self.instances(thing, every, np.concatenate(yaws), np.ones(len(every)))

    def instances(self, thing: Thing, places: FloatArray, yaws: FloatArray, scales: FloatArray) -> Instances:
        """Things upright on the ground at positions (n, 2) [m] with headings (n,) [rad] and scales (n,)."""
        poses = np.tile(np.eye(4), (len(places), 1, 1))
        c, s = np.cos(yaws) * scales, np.sin(yaws) * scales
        poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1], poses[:, 2, 2] = c, -s, s, c, scales
        poses[:, :2, 3], poses[:, 2, 3] = places, self.landscape.height(places)
        return Instances(
            thing=thing, poses=poses, brightness=1.0 + thing.variety * self.rng.uniform(-1, 1, len(places))
        )


def kerbs(site: Site) -> Instances:
    """Kerb stones along the outline of the road, without those inside another arm of the road."""
    stone = things.kerb_stone()
    places, yaws = [np.empty((0, 2))], [np.empty(0)]
    for side, edge in zip((1.0, -1.0), site.centreline.edges, strict=True):
        ends = _equidistant(edge, things.KERB_LENGTH)
        outside = site.centreline.edge_distance(ends) > -0.02
        on_outline = outside[1:] & outside[:-1]
        chord = np.diff(ends, axis=0)
        yaw = np.arctan2(chord[:, 1], chord[:, 0])
        places.append((0.5 * (ends[1:] + ends[:-1]))[on_outline])
        yaws.append(yaw[on_outline] + (0.0 if side > 0 else math.pi))
    flat = site.instances(stone, np.concatenate(places), np.concatenate(yaws), np.ones(sum(map(len, places))))
    return Instances(thing=stone, poses=_tilted(flat.poses, site.landscape), brightness=flat.brightness)


def _equidistant(line: FloatArray, length: float) -> FloatArray:
    """Points (n, 2) every ``length`` [m] along a line (m, 2)."""
    return resampled(line, np.arange(0.0, arc_length(line)[-1], length))


def _tilted(poses: FloatArray, landscape: Landscape) -> FloatArray:
    """Upright poses, tilted with the slope along their x axis, for long flat things."""
    tilted = poses.copy()
    half = 0.4  # half the base of the slope [m]
    ahead = landscape.height(poses[:, :2, 3] + half * poses[:, :2, 0])
    behind = landscape.height(poses[:, :2, 3] - half * poses[:, :2, 0])
    tilted[:, 2, 0] = (ahead - behind) / (2.0 * half)  # a shear: the stone's ends stay upright
    return tilted


def planted(site: Site) -> list[Instances]:
    """All plants, buildings and road furniture; large things first, as they need the most space."""
    rng = site.rng
    green, yellow, dark = (0.85, 0.92, 0.75), (1.05, 1.0, 0.62), (0.66, 0.80, 0.66)
    cottage = house(size=(11.0, 7.5), eaves=5.3, walls="brick", wall_colour=things.WHITE, rows=2)
    villa = house(size=(9.0, 8.0), eaves=5.3, walls="stone", wall_colour=(1.1, 1.06, 0.95), rows=2)
    barn = house(size=(19.0, 10.0), eaves=4.6, walls="planks", wall_colour=(0.9, 0.85, 0.8), rows=0)
    built = Density(per_hectare=0.9, nearest=8.0, farthest=75.0)
    trees = Density(per_hectare=7.0, nearest=2.0, farthest=85.0, scale=(0.7, 1.35))
    low = Density(per_hectare=18.0, nearest=0.3, farthest=40.0, scale=(0.5, 1.5))
    scenery = [site.scatter(thing, built) for thing in (cottage, villa, barn)]
    scenery.append(site.along_road(things.lamp(), spacing=34.0, turned=0.5 * math.pi))
    scenery.append(site.along_road(things.bend_sign(), spacing=47.0, turned=0.0))
    scenery.append(site.along_road(things.marker_post(), spacing=12.0, turned=0.0))
    scenery.append(site.rows(things.hedge(rng), things.HEDGE_LENGTH, per_hectare=3.0, pieces=(4, 12)))
    scenery.append(site.rows(things.fence(), things.FENCE_LENGTH, per_hectare=3.0, pieces=(6, 20)))
    for colour in (green, yellow, dark):
        scenery.append(site.scatter(things.broadleaf(rng, colour), trees))
    scenery.append(site.scatter(things.conifer(rng), trees))
    for thing in (things.bush(rng), things.bush(rng), things.rock(rng)):
        scenery.append(site.scatter(thing, low))
    far = Density(per_hectare=3.5, nearest=85.0, farthest=260.0, scale=(0.8, 1.3))
    scenery += [site.scatter(things.wood(rng), far) for _ in range(2)]
    return scenery


def house(*, size: tuple[float, float], eaves: float, walls: str, wall_colour: Colour, rows: int) -> Thing:
    """A house with a gable roof along x; ``size`` is length and width, ``rows`` the number of storeys with windows."""
    half_x, half_y = size[0] / 2, size[1] / 2
    ridge = eaves + 0.8 * half_y
    gables = []
    for sign in (1.0, -1.0):
        x, y = sign * half_x, sign * half_y
        gables.append(polygon(np.array([[x, -y, eaves], [x, y, eaves], [x, 0.0, ridge]]), texture_size=2.4))
    shell = box((-half_x, half_x), (-half_y, half_y), (-1.0, eaves), texture_size=2.4, lid=False)
    parts = [
        Part(mesh=joined(shell, *gables), texture=walls, colour=wall_colour),
        Part(mesh=_roof(half_x, half_y, eaves, ridge), texture="tiles"),
    ]
    if rows:
        parts.append(Part(mesh=_windows(half_x, half_y, rows), texture="window"))
    return Thing(name="house", parts=tuple(parts), variety=0.12)


def _roof(half_x: float, half_y: float, eaves: float, ridge: float) -> Mesh:
    """Two slopes with an overhang all round, visible from above and from below."""
    x, overhang = half_x + 0.35, 0.45
    slope = (ridge - eaves) / half_y
    low, top, y = eaves - overhang * slope + 0.06, ridge + 0.06, half_y + overhang
    sides = []
    for sign in (1.0, -1.0):
        corners = np.array([[x, sign * y, low], [-x, sign * y, low], [-x, 0.0, top], [x, 0.0, top]])
        corners[:, 0] *= sign
        sides += [polygon(corners, texture_size=3.0), polygon(corners[::-1], texture_size=3.0, shade=0.3)]
    chimney = box((0.3 * half_x, 0.3 * half_x + 0.7), (-0.35, 0.35), (eaves, ridge + 0.7), texture_size=3.0)
    return joined(*sides, chimney)


def _windows(half_x: float, half_y: float, rows: int) -> Mesh:
    """Windows in rows on all four walls, 3 cm in front of them."""
    panes = []
    for along, out, yaw in ((half_x, half_y, 0.0), (half_y, half_x, np.pi / 2)):
        count = max(1, int(2 * along / 2.6))
        for place in (np.arange(count) - 0.5 * (count - 1)) * 2.6:
            for storey in range(rows):
                z = 1.0 + 2.7 * storey
                pane = np.array([[-0.55, 0, z], [0.55, 0, z], [0.55, 0, z + 1.3], [-0.55, 0, z + 1.3]])
                for side in (0.0, np.pi):
                    mesh = polygon(pane, texture_size=1.3).moved(by=(float(place), -out - 0.03, 0.0))
                    panes.append(mesh.moved(by=(0.0, 0.0, 0.0), yaw=yaw + side))
    return joined(*panes)


_BED = 8.0  # side of a square bed of crop [m]
_NODES = 6  # of the mesh along a side, edges included
_HEIGHT = 0.75  # of ripe wheat [m]
_UNEVENNESS = 0.04  # standard deviation of the top of the crop [m]
_EARS = 60  # tufts above a bed
_VERGE = 2.0  # of grass between a road and the crop [m]
_REACH = 55.0  # of the fields beyond the verge [m]
_MAX_BEDS = 1500  # limits the number of triangles of a long course
_PATCHES = (0.4, 3.0)  # sides of patches [m]
_RIPE: Colour = (2.5, 1.45, 0.95)  # turns the green of leaves into straw


def patched(rng: np.random.Generator, road: RoadMap, per_100_m2: float) -> RoadMap:
    """The map with rectangular patches of different wear on the road."""
    ny, nx = road.edge_distance.shape
    count = round(per_100_m2 * 1e-2 * road.cell**2 * nx * ny)
    wear = road.gravel.copy()
    centres = rng.uniform(size=(count, 2)) * np.array([nx, ny])
    sides = np.exp(rng.uniform(math.log(_PATCHES[0]), math.log(_PATCHES[1]), size=(count, 2))) / road.cell
    turns = rng.uniform(0.0, 90.0, size=count)
    for centre, side, turn, worn in zip(centres, sides, turns, rng.uniform(0.0, 1.0, size=count), strict=True):
        corners = cv2.boxPoints((centre.tolist(), side.tolist(), float(turn)))
        cv2.fillConvexPoly(wear, np.round(corners * 16.0).astype(np.int32), float(worn), shift=4)
    return replace(road, gravel=np.where(road.edge_distance < 0.0, wear, road.gravel).astype(np.float32))


def grain_fields(rng: np.random.Generator, line: Centreline, landscape: Landscape) -> Instances:
    """Beds of ripe grain on a lattice, clear of the road and within reach of it."""
    nearest = line.greatest_half_width + _VERGE + np.sqrt(0.5) * _BED
    low, high = line.points.min(axis=0) - nearest - _REACH, line.points.max(axis=0) + nearest + _REACH
    axes = [np.arange(low[i], high[i], _BED) for i in range(2)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    distance = line.distance(places)
    order = np.argsort(distance)
    kept = order[(distance[order] > nearest) & (distance[order] < nearest + _REACH)][:_MAX_BEDS]
    bed = _bed(rng)
    return Instances(
        thing=bed,
        poses=_poses(rng, places[kept], landscape),
        brightness=1.0 + bed.variety * rng.uniform(-1.0, 1.0, len(kept)),
    )


def _poses(rng: np.random.Generator, places: FloatArray, landscape: Landscape) -> FloatArray:
    """Poses upright on the ground, turned by random multiples of 90 deg, so that neighbours differ."""
    turns = rng.integers(4, size=len(places))
    c, s = np.array([1.0, 0.0, -1.0, 0.0])[turns], np.array([0.0, 1.0, 0.0, -1.0])[turns]
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1] = c, -s, s, c
    poses[:, :2, 3], poses[:, 2, 3] = places, landscape.height(places)
    return poses


def _bed(rng: np.random.Generator) -> Thing:
    """One bed: an uneven top with sides down to the ground, and ears above it."""
    top = _top(rng)
    xy = rng.uniform(-0.48 * _BED, 0.48 * _BED, size=(_EARS, 2))
    places = np.column_stack([xy, np.full(_EARS, _HEIGHT)])
    upwards = np.tile(np.array([0.0, 0.0, 1.0]), (_EARS, 1))
    ears = cards(rng, places, upwards, 0.4, np.full(_EARS, 0.95))
    straw = Part(mesh=top, texture="foliage", colour=_RIPE)
    awns = Part(mesh=ears, texture="twigs", colour=_RIPE, distances=(0.0, TWIGS_RANGE))
    return Thing(name="grain", parts=(straw, awns), variety=0.12)


def _top(rng: np.random.Generator) -> Mesh:
    side = np.linspace(-0.5 * _BED, 0.5 * _BED, _NODES)
    side = np.concatenate([side[:1], side, side[-1:]])  # the outermost nodes twice: at the top and in the ground
    x, y = np.meshgrid(side, side, indexing="ij")
    z = np.where(_inside(len(side)), _HEIGHT + _UNEVENNESS * rng.standard_normal(x.shape), -0.5)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    level = np.stack([x, y, np.where(z > 0.0, z, _HEIGHT)], axis=-1).reshape(-1, 3)
    faces = grid_faces(len(side), len(side))
    return Mesh(
        vertices=vertices,
        normals=smooth_normals(level, faces),  # lit without the edges of the bed
        uv=np.stack([x + 0.7 * z, y + 0.7 * z], axis=-1).reshape(-1, 2) / 1.6,
        shade=np.where(z > 0.0, 0.95, 0.35).ravel(),
        faces=faces,
    )


def _inside(nodes: int) -> NDArray[np.bool_]:
    inside = np.zeros((nodes, nodes), dtype=bool)
    inside[1:-1, 1:-1] = True
    return inside
