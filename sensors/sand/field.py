"""Field of sand tiles, which are made when first seen or driven on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.sand.grid import Bytes, Floats, Window
from sensors.sand.imprint import Sand
from sensors.sand.light import Reach, around, encoded, sunlit
from sensors.sand.relief import Relief
from sensors.sand.solids import Rock
from sensors.sand.tracks import Track, pressed_by
from sensors.world.sky import Sunlight

TILE: Final = 512  # texels a side
_BLOCK: Final = 32  # texels a side of the blocks whose light is updated together


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A square of the field."""

    height: Floats  # in W [m]
    albedo: Bytes
    tint: Bytes
    packed: Bytes  # 255 where a wheel has compacted it
    light: Bytes  # (2, n, n) reflected light of sun and sky, see ``light.encoded``
    stale: NDArray[np.uint8]  # (blocks, blocks) 1 where the light is out of date
    rock_light: Bytes | None  # share of the sun's light past the rocks; None: all


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Tiles of sand that exist so far, with what new ones are made from."""

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
        packed = np.empty(window.shape, np.uint8)
        for tile, here, there in self._parts(window):
            packed[there] = tile.packed[here]
        return Sand(self.height(window), packed)

    def write(self, window: Window, sand: Sand) -> None:
        """Write new sand to a window; its light is updated when it is next seen."""
        for tile, here, there in self._parts(window):
            tile.height[here] = sand.height[there]
            tile.packed[here] = sand.packed[there]
        for tile, (rows, columns), _ in self._parts(around(window, self.reach.behind)):
            tile.stale[
                rows.start // _BLOCK : (rows.stop - 1) // _BLOCK + 1,
                columns.start // _BLOCK : (columns.stop - 1) // _BLOCK + 1,
            ] = 1

    def light(self, window: Window) -> Bytes:
        """Light of sun and sky that a window reflects (2, h, w), see ``light.encoded``."""
        self._update_light(window)
        out = np.empty((2, *window.shape), np.uint8)
        for tile, here, there in self._parts(window):
            out[:, *there] = tile.light[:, *here]
        return out

    def tint(self, window: Window) -> Bytes:
        """Greyness of the ground: 0 sand, 255 stone."""
        out = np.empty(window.shape, np.uint8)
        for tile, here, there in self._parts(window):
            out[there] = tile.tint[here]
        return out

    def _update_light(self, window: Window) -> None:
        """Bring the light of a window up to date, one group of connected stale blocks after the other."""
        top, left = window.top // _BLOCK, window.left // _BLOCK
        blocks = Window(top, left, -(-window.bottom // _BLOCK), -(-window.right // _BLOCK))
        whole = Window(*(side * _BLOCK for side in blocks))
        stale = np.zeros(blocks.shape, np.uint8)
        for i in range(window.top // TILE, (window.bottom - 1) // TILE + 1):
            for j in range(window.left // TILE, (window.right - 1) // TILE + 1):
                if self._tile(i, j).stale.all():  # never seen: the whole tile at once is fastest
                    self._bake(_extent(i, j))
        for tile, here, there in self._parts(whole):
            stale[_in_blocks(there)] = tile.stale[_in_blocks(here)]
        if not stale.any():
            return
        count, _, groups, _ = cv2.connectedComponentsWithStats(stale, connectivity=8)
        for column, row, columns, rows, _ in groups[1:count].tolist():
            self._bake(
                Window(
                    *(_BLOCK * side for side in (top + row, left + column, top + row + rows, left + column + columns))
                )
            )

    def _bake(self, window: Window) -> None:
        sun, sky = sunlit(self.height(around(window, self.reach.before)), self.reach, self.sun)
        for tile, here, there in self._parts(window):
            direct = sun[there]
            if tile.rock_light is not None:
                direct = direct * (tile.rock_light[here] * np.float32(1.0 / 255.0))
            tile.light[:, *here] = encoded(tile.albedo[here], tile.packed[here], direct, sky[there])
            tile.stale[_in_blocks(here)] = 0

    def _parts(self, window: Window) -> Iterator[tuple[Tile, tuple[slice, slice], tuple[slice, slice]]]:
        """Tiles under a window, each with the common part as slices of the tile and of the window."""
        for i in range(window.top // TILE, (window.bottom - 1) // TILE + 1):
            for j in range(window.left // TILE, (window.right - 1) // TILE + 1):
                extent = _extent(i, j)
                common = window.common(extent)
                yield self._tile(i, j), common.within(extent), common.within(window)

    def _tile(self, i: int, j: int) -> Tile:
        if (i, j) not in self.tiles:
            self.tiles[i, j] = self._new_tile(_extent(i, j))
        return self.tiles[i, j]

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
            light=np.zeros((2, *window.shape), np.uint8),
            stale=np.ones((TILE // _BLOCK, TILE // _BLOCK), np.uint8),
            rock_light=self._rock_light(window, sand.height),
        )

    def _rock_light(self, window: Window, height: Floats) -> Bytes | None:
        """Share of the sun's light past the rocks; None if none is near."""
        lights = [light for rock in self.rocks if (light := rock.light(window, height, self.sun.direction)) is not None]
        if not lights:
            return None
        return np.asarray(255.0 * np.prod(lights, axis=0), dtype=np.uint8)


def _extent(i: int, j: int) -> Window:
    """Texels of a tile."""
    return Window(i * TILE, j * TILE, (i + 1) * TILE, (j + 1) * TILE)


def _in_blocks(part: tuple[slice, slice]) -> tuple[slice, slice]:
    """Slices of texels that begin and end with blocks, as slices of blocks."""
    rows, columns = part
    return (
        slice(rows.start // _BLOCK, rows.stop // _BLOCK),
        slice(columns.start // _BLOCK, columns.stop // _BLOCK),
    )
