"""The rendered ground: mesh, relief, map of the road on it, its condition, and painted lane lines.

Interpolated distances must be smooth where a line is. So the distance across has a sign, which changes at the line, and
neighbouring lines count in opposite directions: between them the distance saturates instead of jumping.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from sensors.textures import NoiseArray, fractal_noise
from sensors.world.things import FaceArray, Mesh
from vehicle.frames import FloatArray, arc_length, dense, is_left, sides
from vehicle.surface import Potholes, Surface
from vehicle.surface.relief import BesideLine

MARGIN = 100.0  # the ground follows the surface this far beyond the centreline's bounding box [m]
_HORIZON = 900.0  # extent of the ground around the course; hills beyond fade into haze [m]
_FINE = 12.0  # distance from the centreline with the finest cells; cameras are closer to it [m]
_CELL = 2.5  # finest cell: the error on a cone of 2.5 % is then h^2 c/8R = 2 mm at R = 10 m [m]
_COARSEST = 40.0  # largest cell near the course: the shortest wavelength of the texture's distortion [m]
_WIDEST = 256  # largest cell anywhere [finest cells]
_UNEVEN = 2e-3  # heights of a measured surface that are drawn: some of its forms are 5 mm high [m]
_UNEVEN_CELL = 0.16  # largest cell there: some points over the length of a small bump [m]
_MOST_UNEVEN_CELLS = 300_000  # each pair of triangles costs time in every picture
_GRADING, _FAR = 0.4, 60.0  # width of a cell over its distance from the centreline [-]; it grows beyond that [m]
_SAG, _SAG_ANGLE = 0.6e-3, 2e-4  # allowed error of the triangles near the course [m], and its increase with distance
_BENDS, _BEND = (40.0, 140.0), 1.6  # wavelengths and standard deviation of the texture's distortion [m]
_CORNERS = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
_CELLS = 300  # most fine cells along the longer side, which limits the mesh of long courses
_MAP_CELL = 0.25  # the error of interpolated distances is then h^2/8R = 1 mm at R = 6 m [m]
_MAP_SIDE = 8000  # with its coarser levels beside it under 16384, which OpenGL 4.1 drivers accept at least [px]
_MAP_NODES = 1 << 24  # memory limits it to these: cells of 0.25 m on 2 km of straight road, or 1 km square
_MAP_REACH = 16.0  # greatest distance from the road's edge in the map [m]
_SPACING = 0.05  # of the centreline's points: distance error below 0.1 mm at the road's edge [m]


class Waves:
    """A smooth aperiodic field: a sum of plane waves of random direction, wavelength and phase."""

    def __init__(self, rng: np.random.Generator, *, wavelengths: tuple[float, float], count: int) -> None:
        length = np.exp(rng.uniform(math.log(wavelengths[0]), math.log(wavelengths[1]), size=count))  # [m]
        heading = rng.uniform(0.0, 2.0 * np.pi, size=count)
        self._k = 2.0 * np.pi / length * np.stack([np.cos(heading), np.sin(heading)])  # (2, count) [rad/m]
        self._phase = rng.uniform(0.0, 2.0 * np.pi, size=count)

    def __call__(self, xy: FloatArray) -> FloatArray:
        """Value at xy (..., 2) [m]: zero mean, unit standard deviation."""
        waves: FloatArray = np.sin(xy @ self._k + self._phase).sum(axis=-1) * np.sqrt(2.0 / len(self._phase))
        return waves


class Landscape:
    """Height of the rendered ground: the surface of the course, and hills beyond its margin."""

    def __init__(self, rng: np.random.Generator, surface: Surface, low: FloatArray, high: FloatArray) -> None:
        self._surface, self._low, self._high = surface, low - MARGIN, high + MARGIN
        self._hills = Waves(rng, wavelengths=(150.0, 450.0), count=9)

    def height(self, xy: FloatArray) -> FloatArray:
        """Height [m] at xy (..., 2) [m]."""
        inside = np.clip(xy, self._low, self._high)
        beyond = np.linalg.norm(xy - inside, axis=-1)
        rise = np.clip(beyond / 350.0, 0.0, 1.0)
        hills = 24.0 * rise**1.5 * (0.75 + 0.35 * self._hills(xy))
        height: FloatArray = ground_height(self._surface, inside) + hills
        return height

    def slope(self, xy: FloatArray, over: float = _CELL) -> FloatArray:
        """Slope along both axes [-] at xy (..., 2) [m], over the width of a cell [m]."""
        rise = [self.height(xy + step) - self.height(xy - step) for step in over * np.eye(2)]
        return np.stack(rise, axis=-1) / (2.0 * over)

    def uneven_places(self) -> FloatArray:
        """Places (n, 2) [m] of a measured surface whose forms are finer than a cell and high enough to be drawn."""
        measured = self._surface.roughness.measured if self._surface.roughness else None
        return np.empty((0, 2)) if measured is None else measured.uneven_places(_UNEVEN, _CELL)


def ground_height(surface: Surface, xy: FloatArray) -> FloatArray:
    """Height [m] of the rendered ground around the course at xy (..., 2) [m]."""
    height: FloatArray = surface.height(xy[..., 0], xy[..., 1])
    if surface.roughness is not None:  # potholes are narrower than a cell: they are only shaded
        height = height + surface.roughness.waves(xy[..., 0], xy[..., 1])
    return height


class Centreline:
    """The road's centreline as dense points, for distances from it and from the road's edges."""

    def __init__(self, polyline: FloatArray, half_width: float | FloatArray = 0.0) -> None:
        """Centreline through points (n, 2) of a road; its half width is one number, or (n, 2) to both sides [m]."""
        self.points, self.spacing = dense(polyline, _SPACING)  # (n, 2), [m]
        self.half_width: float | FloatArray = half_width  # at the dense points
        if isinstance(half_width, np.ndarray):
            along = arc_length(polyline)
            at = np.linspace(0.0, along[-1], len(self.points))
            self.half_width = np.stack([np.interp(at, along, side) for side in half_width.T], axis=1)
        self.greatest_half_width = float(np.max(half_width))  # [m]
        self._tree = scipy.spatial.cKDTree(self.points)

    def distance(self, xy: FloatArray, up_to: float = np.inf) -> FloatArray:
        """Distance [m] of xy (..., 2) from the centreline; infinite beyond ``up_to`` [m]."""
        return np.asarray(self._tree.query(xy, distance_upper_bound=up_to)[0], dtype=np.float64)

    def edge_distance(self, xy: FloatArray, up_to: float = np.inf) -> FloatArray:
        """Distance [m] of xy (..., 2) from the road's edge, negative on the road; at most ``up_to`` from its middle."""
        if not isinstance(self.half_width, np.ndarray):
            return np.asarray(np.minimum(self.distance(xy, up_to), up_to) - self.half_width, dtype=np.float64)
        distance, nearest = self._tree.query(xy, distance_upper_bound=up_to)
        nearest = np.minimum(nearest, len(self.points) - 1)  # the number of points: none is near
        half_width = np.where(is_left(self.points, nearest, xy), *np.moveaxis(self.half_width[nearest], -1, 0))
        return np.asarray(np.minimum(distance, up_to) - half_width, dtype=np.float64)

    @property
    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Left and right edge of the road (n, 2) [m]."""
        if not isinstance(self.half_width, np.ndarray):
            return self.offset(self.half_width), self.offset(-self.half_width)
        return sides(self.points, self.half_width)

    def offset(self, by: float) -> FloatArray:
        """Points (n, 2) ``by`` metres to the left of the centreline's points."""
        tangent = np.gradient(self.points, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        return self.points + by * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadMap:
    """Appearance of the ground around the road, on a lattice of nodes ``cell`` apart that starts at ``origin``."""

    origin: FloatArray  # (2,) position of node [0, 0] in W [m]
    cell: float  # [m]
    edge_distance: NoiseArray  # (ny, nx) distance from the road's edge, negative on the road [m]
    light: NoiseArray  # (ny, nx) 1 in the sun, 0 in full shadow
    gravel: NoiseArray  # (ny, nx) off the road: share of gravel, 0 to 1; on it: wear, 0 to 1
    lushness: NoiseArray  # (ny, nx) of the grass, 0..1
    lines: NoiseArray | None = None  # (ny, nx, 2) lines between lanes, see sensors.world.ground; None: none


def road_map(rng: np.random.Generator, centreline: Centreline, low: FloatArray, high: FloatArray) -> RoadMap:
    """Map of a road along a centreline, without shadows, that covers the box from ``low`` to ``high`` [m]."""
    cell = max(_MAP_CELL, float((high - low).max()) / _MAP_SIDE, math.sqrt(float((high - low).prod()) / _MAP_NODES))
    nx, ny = (scipy.fft.next_fast_len(int(side / cell) + 2, real=True) for side in high - low)
    nodes = np.stack(np.meshgrid(low[0] + cell * np.arange(nx), low[1] + cell * np.arange(ny)), axis=-1)
    reach = centreline.greatest_half_width + _MAP_REACH
    edge_distance = centreline.edge_distance(nodes, up_to=reach)
    longest = np.minimum(cell / np.array([12.0, 60.0]), 0.2)  # wide cells show longer waves only [cycles/cell]
    blotches = fractal_noise(rng, (ny, nx), 1.0, (longest[0], 0.4))
    lushness = 0.5 + 0.19 * fractal_noise(rng, (ny, nx), 1.1, (longest[1], cell / 1.5))
    off_road = 0.40 + 0.13 * blotches + 0.2 * (0.5 - lushness) + 0.42 * np.clip(1.4 - edge_distance, 0.0, 1.0)
    middle = edge_distance + centreline.greatest_half_width  # distance from it, of a road of one width
    wheels = np.clip(1.0 - np.abs(np.abs(middle) - 1.0) / 0.6, 0.0, 1.0)
    worn = 0.5 + 0.15 * blotches + 0.15 * wheels
    return RoadMap(
        origin=low,
        cell=cell,
        edge_distance=edge_distance.astype(np.float32),
        light=np.ones((ny, nx), dtype=np.float32),
        gravel=np.where(edge_distance < 0.0, worn, off_road).astype(np.float32),
        lushness=lushness,
    )


def ground_mesh(
    rng: np.random.Generator, landscape: Landscape, line: Centreline, low: FloatArray, high: FloatArray
) -> Mesh:
    """Triangle mesh of the ground: fine where it is curved near the course, coarser elsewhere.

    A pixel that several triangles share is shaded once for each: flat ground in small cells would cost 50 % more time.
    ``uv`` is the position in metres, distorted by a smooth field of some metres, so that the repeats of a texture are
    nowhere shifted by the same vector.
    """
    bends = [Waves(rng, wavelengths=_BENDS, count=7) for _ in range(2)]
    cell = max(_CELL, float((high - low).max() + 2 * _FINE) / _CELLS)
    uneven = _Uneven.of(landscape.uneven_places(), cell)
    xy, faces = _triangulated(landscape, line, low, high, cell, uneven)
    normals = np.concatenate([-landscape.slope(xy), np.ones((len(xy), 1))], axis=1)
    if uneven is not None:
        near = uneven.touches(xy, uneven.cell)
        normals[near, :2] = -landscape.slope(xy[near], 0.5 * uneven.cell)
    return Mesh(
        vertices=np.column_stack([xy, landscape.height(xy)]),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        uv=xy + _BEND * np.stack([bend(xy) for bend in bends], axis=-1),
        shade=np.ones(len(xy)),
        faces=faces,
    )


class _Uneven:
    """Places whose ground has forms finer than the other ground's cells."""

    def __init__(self, places: FloatArray, cell: float, parts: int) -> None:
        self.parts, self.cell = parts, cell / parts  # of a finest cell elsewhere [-], [m]
        self._tree = scipy.spatial.cKDTree(places)

    @classmethod
    def of(cls, places: FloatArray, cell: float) -> "_Uneven | None":
        """The places (n, 2) [m] on ground with finest cells of ``cell`` [m]; None if there are none."""
        if not len(places):
            return None
        parts = 2 ** math.ceil(math.log2(cell / _UNEVEN_CELL))
        while parts > 1 and _squares(places, cell / parts) > _MOST_UNEVEN_CELLS:
            parts //= 2
        return cls(np.unique(np.floor(places * parts / cell), axis=0) * cell / parts, cell, parts)

    def touches(self, middles: FloatArray, side: float) -> NDArray[np.bool_]:
        """True for squares (n, 2) with that side [m] that hold such a place, or nearly."""
        distance, _ = self._tree.query(middles, distance_upper_bound=0.5 * side + 1.5 * self.cell, p=np.inf)
        return np.isfinite(distance)


def _squares(places: FloatArray, side: float) -> int:
    """Number of squares of that side [m] that hold places (n, 2) [m]."""
    return len(np.unique(np.floor(places / side), axis=0))


def _triangulated(
    landscape: Landscape, line: Centreline, low: FloatArray, high: FloatArray, cell: float, uneven: _Uneven | None
) -> tuple[FloatArray, FaceArray]:
    """Nodes (n, 2) [m] up to the horizon, and the triangles between them; finest cells are ``cell`` [m] wide."""
    start = low - _HORIZON
    side = _WIDEST  # of square cells, in finest cells; all nodes are whole multiples of these
    nx, ny = np.ceil((high - low + 2 * _HORIZON) / (side * cell)).astype(int)
    cells = side * np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1).reshape(-1, 2)
    finest = cell
    if uneven is not None:
        side, cells, cell = side * uneven.parts, cells * uneven.parts, uneven.cell
    corners = []
    while len(cells):
        split = _too_wide(landscape, line, start + cell * cells, side * cell, finest)
        if uneven is not None and side > 1:
            split |= uneven.touches(start + cell * (cells + 0.5 * side), side * cell)
        corners.append((cells[~split, None] + side * _CORNERS).reshape(-1, 2))
        side //= 2
        cells = (cells[split, None] + side * _CORNERS).reshape(-1, 2)
    nodes = np.unique(np.concatenate(corners), axis=0)
    faces = scipy.spatial.Delaunay(nodes).simplices
    a, b, c = (nodes[faces[:, i]] for i in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = np.where(area[:, None] > 0, faces, faces[:, ::-1])[area != 0]
    return start + cell * nodes, np.asarray(faces, dtype=np.int32)


def _too_wide(
    landscape: Landscape, line: Centreline, cells: FloatArray, side: float, finest: float
) -> NDArray[np.bool_]:
    """Mask of the square cells (n, 2), given by their lowest corners, that have to be quartered."""
    distance = np.maximum(line.distance(cells + 0.5 * side) - 0.71 * side, 0.0)
    share = np.linspace(0.0, 1.0, 5)
    inside = np.stack(np.meshgrid(share, share, indexing="ij"), axis=-1)
    z = landscape.height(cells[:, None, None] + side * inside)  # (n, 5, 5)
    across = z[:, :1] + share[:, None] * (z[:, -1:] - z[:, :1])
    level = across[:, :, :1] + share * (across[:, :, -1:] - across[:, :, :1])
    bent = np.abs(z - level).max(axis=(1, 2)) > _SAG + _SAG_ANGLE * distance
    wide = _GRADING * np.maximum(1.0, distance / _FAR)
    coarsest = np.maximum(_COARSEST, wide * distance)
    divisible = side > np.maximum(finest, wide * (distance - _FINE))
    too_wide: NDArray[np.bool_] = divisible & (bent | (side > coarsest))
    return too_wide


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
        looks=None if surface.is_uniform else _looks(surface, road), holes=_holes(potholes, road) if potholes else None
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


_DASH, _PERIOD = 3.0, 12.0  # of a broken line [m]
_COARSEST_LANES: Final = 0.8  # cell of a map on which lanes can be told from each other [m]
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
    if road.cell > _COARSEST_LANES:
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
