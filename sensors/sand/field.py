"""Field of sand tiles, made when first seen or driven on, with older tracks in it and light on it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.sand.grid import (
    TEXEL,
    Bytes,
    Floats,
    Imprint,
    Roll,
    Sand,
    Tread,
    Window,
    rolled_over,
    window_of,
)
from sensors.sand.relief import ALBEDO, Relief
from sensors.sand.solids import Rock
from sensors.world.sky import Sunlight
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray, arc_length

_OFFSET: Final = (0.17, 0.33)  # of a track along the route from the rover's own left wheels [m]
_SPACING: Final = 0.95  # of tracks across the route [m]


class Track(NamedTuple):
    """Straight track of one wheel."""

    roll: Roll
    tread: Tread


def pressed_by(track: Track, window: Window, sand: Sand, relief: Relief) -> Sand:
    """Sand of a window after a track was pressed into it."""
    roll, tread = track
    part = window.common(window_of(roll, roll.reach(tread)))
    if part.is_empty:
        return sand
    at = part.within(window)
    before = Sand(sand.height[at], sand.packed[at])
    height, packed = sand.height.copy(), sand.packed.copy()
    (height[at], packed[at]), _ = rolled(before, track, part, relief, roll.sinkage * tread.width)
    return Sand(height, packed)


def rolled(sand: Sand, track: Track, window: Window, relief: Relief, displaced: float) -> tuple[Sand, float]:
    """Sand of a window after a wheel rolled through it, and what it removed per length [m2].

    ``displaced`` is the sand per length that feeds the berms [m2].
    """
    numbers = Imprint.of(*track, window, displaced)
    after, removed = rolled_over(sand, numbers, relief.large(window), relief.crumbs(window), window)
    return after, removed / track.roll.length


def foreign_tracks(rng: np.random.Generator, route: FloatArray, wheel_left: float) -> tuple[Track, ...]:
    """Draw tracks beside and across the left wheels' path, for a rover whose middle takes a route (n, 2)."""
    along = arc_length(route)
    tracks = []
    for centre in np.arange(0.7, along[-1], _SPACING):
        s = centre + rng.uniform(-0.25, 0.25)
        turn = rng.choice((-1.0, 1.0)) * math.radians(rng.uniform(25.0, 90.0))
        tracks.append(_track(rng, _place(route, along, s, wheel_left), turn, half=1.2))
    for start in np.arange(0.2, along[-1], 3.2):
        side = rng.choice((-1.0, 1.0)) * rng.uniform(*_OFFSET)
        turn = math.radians(rng.uniform(-4.0, 4.0))
        tracks.append(_track(rng, _place(route, along, start + 1.5, wheel_left + side), turn, half=1.5))
    return tuple(tracks)


def _place(route: FloatArray, along: FloatArray, s: float, left: float) -> tuple[FloatArray, float]:
    """Point at a distance ``s`` along a route and ``left`` of it [m], and the route's direction there [rad]."""
    place = np.array([np.interp(s, along, route[:, k]) for k in (0, 1)])
    k = int(np.clip(np.searchsorted(along, s) - 1, 0, len(route) - 2))
    step = route[k + 1] - route[k]
    direction = math.atan2(step[1], step[0])
    return place + left * np.array([-math.sin(direction), math.cos(direction)]), direction


def _track(rng: np.random.Generator, at: tuple[FloatArray, float], turn: float, half: float) -> Track:
    """Draw a track through a place, at an angle ``turn`` [rad] to a direction, ``half`` [m] to both sides."""
    middle, direction = at
    towards = np.array([math.cos(direction + turn), math.sin(direction + turn)])
    tread = Tread(
        radius=rng.uniform(0.09, 0.14),
        width=rng.uniform(0.08, 0.13),
        lugs=int(rng.integers(16, 28)),
        lug_height=rng.uniform(0.003, 0.005),
    )
    length = 2.0 * half
    roll = Roll(
        a=middle - half * towards,
        b=middle + half * towards,
        towards_a=towards,
        towards_b=towards,
        slip_angle=0.0,
        turned_a=0.0,
        turned_b=length / tread.radius / (1.0 - rng.uniform(0.0, 0.15)),
        sinkage=rng.uniform(0.006, 0.010),
    )
    return Track(roll, tread)


_HIGHEST: Final = 0.034  # largest height of relief above the ground around it [m]
_PENUMBRA: Final = np.float32(0.0006)  # height over which a shadow fades, as edges of sand are blunt [m]
_NARROW, _BROAD = 17, 61  # texels a side of the surroundings that hide parts of the sky
_PACKED: Final = 0.10  # loss of albedo of compacted sand, which is smoother and damp from below; assumed
_COVERED: Final = 0.8  # share of the cover, such as pebbles, that a wheel presses into the sand; assumed


@dataclass(frozen=True, slots=True)
class Reach:
    """Surroundings of a texel on which its light depends, and which its own shadow changes."""

    rays: tuple[tuple[int, int, float], ...]  # rows, columns towards the sun, and height of the ray there [m]
    before: Window  # margins around a texel with the ground that its light depends on
    behind: Window  # margins around it with the texels whose light it may change

    @classmethod
    def of(cls, light: Sunlight) -> "Reach":
        """Surroundings for a position of the sun."""
        across = math.hypot(light.direction[0], light.direction[1])
        near = _NARROW // 2 + 1
        if light.overcast or across < 1e-3:  # no shadows, or the sun at the zenith
            return cls((), Window(*[_BROAD // 2 + 1] * 4), Window(*[near] * 4))
        slope = float(light.direction[2]) / across
        length, rays, k = _HIGHEST / slope / TEXEL, [], 1.0
        while k < length:
            row, column = (round(k * float(light.direction[axis]) / across) for axis in (1, 0))
            rays.append((row, column, math.hypot(row, column) * TEXEL * slope))
            k = 1.15 * k + 0.7
        row, column = (_outward(length * float(light.direction[axis]) / across) for axis in (1, 0))
        low = _BROAD // 2 + 1
        return cls(
            tuple(rays),
            Window(max(low, -row), max(low, -column), max(low, row), max(low, column)),
            Window(max(near, row), max(near, column), max(near, -row), max(near, -column)),
        )


def _mean(height: Floats, side: int) -> Floats:
    """Mean height of the surroundings."""
    return np.asarray(cv2.blur(height, (side, side)), dtype=np.float32)


def _outward(length: float) -> int:
    """Next whole number away from 0."""
    return math.ceil(length) if length > 0.0 else math.floor(length)


def around(window: Window, margins: Window) -> Window:
    """Window with margins on its four sides."""
    return Window(
        window.top - margins.top,
        window.left - margins.left,
        window.bottom + margins.bottom,
        window.right + margins.right,
    )


def sunlit(height: Floats, reach: Reach, light: Sunlight) -> tuple[Floats, Floats]:
    """Shares of the light of sun and sky on the inner part of a height map, inside the margins ``reach.before``."""
    top, left = reach.before.top, reach.before.left
    h, w = height.shape[0] - top - reach.before.bottom, height.shape[1] - left - reach.before.right

    def shifted(row: int, column: int) -> Floats:
        return height[top + row : top + row + h, left + column : left + column + w]

    here = shifted(0, 0)
    slope_x = (shifted(0, 1) - shifted(0, -1)) * np.float32(0.5 / TEXEL)
    slope_y = (shifted(1, 0) - shifted(-1, 0)) * np.float32(0.5 / TEXEL)
    upright = np.float32(1.0) / cv2.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    sx, sy, sz = (np.float32(part) for part in light.direction)
    facing = np.maximum((sz - sx * slope_x - sy * slope_y) * upright, 0.0)
    if reach.rays:
        over = np.full(here.shape, -np.inf, dtype=np.float32)  # highest ray of the sun that is blocked
        ray = np.empty(here.shape, dtype=np.float32)
        for row, column, rise in reach.rays:
            np.subtract(shifted(row, column), np.float32(rise), out=ray)
            np.maximum(over, ray, out=over)
        hidden = np.clip((over - here) / _PENUMBRA + np.float32(0.5), 0.0, 1.0)
        facing *= 1.0 - hidden
    middle = (slice(top, top + h), slice(left, left + w))
    hollow = np.maximum(_mean(height, _NARROW)[middle] - here, 0.0) * np.float32(60.0)
    hollow += np.maximum(_mean(height, _BROAD)[middle] - here, 0.0) * np.float32(22.0)
    open_sky = np.clip(1.0 - hollow, 0.35, 1.0) * (0.75 + 0.25 * upright)
    return np.asarray(facing, dtype=np.float32), np.asarray(open_sky, dtype=np.float32)


_NUMBERS: Final = (
    *(f"TEXEL={TEXEL}f", f"PENUMBRA={_PENUMBRA}f", f"PACKED_ALBEDO={ALBEDO * (1.0 - _PACKED)}f"),
    *(f"COVERED={_COVERED}f", f"ALBEDO={ALBEDO}f"),
)


def encoded(albedo: Bytes, packed: Bytes, past_rocks: Bytes, sun: Floats, sky: Floats) -> Bytes:
    """Reflected shares of sun and sky (h, w, 2) as bytes: square roots, which are as fine in the dark as needed."""
    own = albedo.astype(np.float32)
    pressed = packed.astype(np.float32) * np.float32(1.0 / 255.0)
    own += (np.float32(ALBEDO * (1.0 - _PACKED)) - own) * (np.float32(_COVERED) * pressed)
    share = own * np.float32(0.5 / ALBEDO)
    roots = np.empty((*share.shape, 2), np.uint8)
    for k, light in enumerate((sun * (past_rocks * np.float32(1.0 / 255.0)), sky)):
        roots[..., k] = np.minimum(255.0 * cv2.sqrt(share * light), 255.0)
    return roots


_SHARES: Final = np.square(np.arange(256.0), dtype=np.float32) * np.float32(2.0 / 255.0**2)


def decoded(roots: Bytes) -> Floats:
    """Reflected shares (h, w, 2) of sun and sky from the output of ``encoded``."""
    return np.asarray(cv2.LUT(roots, _SHARES), dtype=np.float32)


TILE: Final = 512  # texels a side
_MOST: Final = 256  # tiles in memory: 67 m2, of 2.3 MB each; a view takes 10
_ALL_LIGHT: Final = np.broadcast_to(np.full(TILE, 255, np.uint8), (TILE, TILE))  # without memory for each tile
_BLOCK: Final = 32  # texels a side of the blocks whose light is updated together
_NEW, _CHANGED = 2, 1  # flags of blocks: never seen; shaped by a wheel since
_AHEAD: Final = 5  # blocks beyond the view whose light is made with that of new ground in it: fewer and larger pieces


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A square of the field."""

    height: Floats  # in W [m]
    albedo: Bytes
    tint: Bytes
    packed: Bytes  # 255 where a wheel has compacted it
    light: Bytes  # (n, n, 2) reflected light of sun and sky, see ``encoded``
    stale: NDArray[np.uint8]  # (blocks, blocks) why the light is out of date: _NEW, _CHANGED; 0: it is not
    rock_light: Bytes  # share of the sun's light past the rocks


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Tiles of sand that were used last, with what new ones are made from; those left out lose their imprints."""

    relief: Relief
    sun: Sunlight
    tracks: tuple[Track, ...]
    rocks: tuple[Rock, ...]
    reach: Reach
    tiles: dict[tuple[int, int], Tile] = field(default_factory=dict)

    def height(self, window: Window) -> Floats:
        """Copy of the ground's height in a window [m]."""
        out = np.empty(window.shape, np.float32)
        for tile, here, there in self._parts(window):
            out[there] = tile.height[here]
        return out

    def sand(self, window: Window) -> Sand:
        """Copy of the sand in a window."""
        sand = Sand(np.empty(window.shape, np.float32), np.empty(window.shape, np.uint8))
        for tile, here, there in self._parts(window):
            sand.height[there], sand.packed[there] = tile.height[here], tile.packed[here]
        return sand

    def write(self, window: Window, sand: Sand) -> None:
        """Write new sand to a window; its light is updated when it is next seen."""
        for tile, here, there in self._parts(window):
            tile.height[here] = sand.height[there]
            tile.packed[here] = sand.packed[there]
        # the light of tiles that do not exist yet is stale anyway
        for tile, (rows, columns), _ in self._parts(around(window, self.reach.behind), only_existing=True):
            tile.stale[
                rows.start // _BLOCK : (rows.stop - 1) // _BLOCK + 1,
                columns.start // _BLOCK : (columns.stop - 1) // _BLOCK + 1,
            ] |= _CHANGED

    def light(self, window: Window) -> Bytes:
        """Light of sun and sky that a window reflects (h, w, 2), see ``encoded``."""
        self._update_light(window)
        out = np.empty((*window.shape, 2), np.uint8)
        for tile, here, there in self._parts(window):
            out[there] = tile.light[here]
        return out

    def tint(self, window: Window) -> Bytes:
        """Greyness of the ground: 0 sand, 255 stone."""
        out = np.empty(window.shape, np.uint8)
        for tile, here, there in self._parts(window):
            out[there] = tile.tint[here]
        return out

    def _update_light(self, window: Window) -> None:
        """Bring light up to date: of new ground also some blocks beyond the window, of changed ground within it."""
        first, last = (side // _BLOCK for side in window[:2]), (-(-side // _BLOCK) for side in window[2:])
        in_view = Window(*first, *last)
        for blocks, kind in ((in_view.grown(_AHEAD), _NEW), (in_view, _CHANGED)):
            stale = np.full(blocks.shape, _NEW, np.uint8)
            for tile, here, there in self._parts(_texels(blocks), only_existing=True):
                stale[_in_blocks(there)] = tile.stale[_in_blocks(here)]
            stale &= kind
            if not stale[in_view.within(blocks)].any():
                continue
            count, _, groups, _ = cv2.connectedComponentsWithStats(stale, connectivity=8)
            for column, row, columns, rows, _ in groups[1:count].tolist():
                top, left = blocks.top + row, blocks.left + column
                group = Window(top, left, top + rows, left + columns)
                if not group.common(in_view).is_empty:
                    self._bake(_texels(group))

    def _bake(self, window: Window) -> None:
        before = self.reach.before
        height = self.height(around(window, before))
        compiled = kernel("sensors.sand", "light.c", "bake", _NUMBERS)
        means = [] if compiled is None else [_mean(height, side) for side in (_NARROW, _BROAD)]
        lights = sunlit(height, self.reach, self.sun) if compiled is None else ()
        for tile, here, (rows, columns) in self._parts(window):
            parts = tile.albedo[here], tile.packed[here], tile.rock_light[here]
            if compiled is None:
                tile.light[here] = encoded(*parts, *(light[rows, columns] for light in lights))
            else:
                ground = [part[before.top + rows.start :, before.left + columns.start :] for part in (height, *means)]
                steps = (height.shape[1], TILE, tile.rock_light.strides[0])
                light = (
                    len(self.reach.rays),
                    np.array(self.reach.rays, np.float32),
                    self.sun.direction.astype(np.float32),
                )
                compiled(*parts[0].shape, *steps, *light, *ground, *parts, tile.light[here])
            tile.stale[_in_blocks(here)] = 0

    def _parts(
        self, window: Window, *, only_existing: bool = False
    ) -> Iterator[tuple[Tile, tuple[slice, slice], tuple[slice, slice]]]:
        """Tiles under a window, each with the common part as slices of the tile and of the window."""
        for i in range(window.top // TILE, (window.bottom - 1) // TILE + 1):
            for j in range(window.left // TILE, (window.right - 1) // TILE + 1):
                if only_existing and (i, j) not in self.tiles:
                    continue
                extent = _extent(i, j)
                common = window.common(extent)
                yield self._tile(i, j), common.within(extent), common.within(window)

    def _tile(self, i: int, j: int) -> Tile:
        tile = self.tiles.pop((i, j), None) or self._new_tile(_extent(i, j))
        self.tiles[i, j] = tile  # the last one of the dictionary is the one used last
        if len(self.tiles) > _MOST:
            del self.tiles[next(iter(self.tiles))]
        return tile

    def make_one(self, window: Window) -> None:
        """Make one tile of a window, if one is missing."""
        for i in range(window.top // TILE, (window.bottom - 1) // TILE + 1):
            for j in range(window.left // TILE, (window.right - 1) // TILE + 1):
                if (i, j) not in self.tiles:
                    self._tile(i, j)
                    return

    def _new_tile(self, window: Window) -> Tile:
        ground = self.relief.ground(window)
        sand = Sand(ground.height, np.zeros(window.shape, np.uint8))
        for track in self.tracks:
            sand = pressed_by(track, window, sand, self.relief)
        return Tile(
            height=sand.height,
            albedo=ground.albedo,
            tint=ground.tint,
            packed=sand.packed,
            light=np.zeros((*window.shape, 2), np.uint8),
            stale=np.full((TILE // _BLOCK, TILE // _BLOCK), _NEW, np.uint8),
            rock_light=self._rock_light(window, sand.height),
        )

    def _rock_light(self, window: Window, height: Floats) -> Bytes:
        """Share of the sun's light past the rocks."""
        lights = [light for rock in self.rocks if (light := rock.light(window, height, self.sun.direction)) is not None]
        if not lights:
            return _ALL_LIGHT
        return np.asarray(255.0 * np.prod(lights, axis=0), dtype=np.uint8)


def _extent(i: int, j: int) -> Window:
    """Texels of a tile."""
    return Window(i * TILE, j * TILE, (i + 1) * TILE, (j + 1) * TILE)


def _texels(blocks: Window) -> Window:
    """Window of texels from one of blocks."""
    return Window(*(side * _BLOCK for side in blocks))


def _in_blocks(part: tuple[slice, slice]) -> tuple[slice, slice]:
    """Slices of texels that begin and end with blocks, as slices of blocks."""
    rows, columns = part
    return (slice(rows.start // _BLOCK, rows.stop // _BLOCK), slice(columns.start // _BLOCK, columns.stop // _BLOCK))
