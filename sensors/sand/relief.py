"""Undisturbed sand: its kinds by name, and its relief, colour and pebbles, made tile by tile from one seed.

Each map is periodic. Where a period of one metre would be visible, two maps with incommensurate periods are added.
"""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.sand.grid import TEXEL, Bytes, Crumbs, Floats, Window
from sensors.textures import fractal_noise, sigmoid, to_bytes
from vehicle.engine.compiler import kernel
from vehicle.rover.terrain import Terrain

SMALLEST, LARGEST = 0.0015, 0.017  # radius of pebbles [m]
_POWER: Final = 1.75  # exponent of the number of pebbles over their radius: shingle, assumed
_SHAPES: Final = 96
_POSITIVE: Final = 1 << 20  # offset that keeps seeds positive: more windows than a field has to any side


@dataclass(frozen=True, slots=True, eq=False)
class Pebbles:
    """Square shapes by growing radius, one after the other, and the density of pebbles."""

    heights: Floats  # (texels,) above the sand [m], nowhere below -1 mm
    inside: NDArray[np.bool_]  # (texels,) True inside the outlines
    halves: NDArray[np.int64]  # (shapes,) of their sides, without the middle [texels]
    density: float  # [1/m2]

    @classmethod
    def draw(cls, rng: np.random.Generator, density: float) -> "Pebbles":
        """Draw shapes with the radii of shingle."""
        shares = (np.arange(_SHAPES) + 0.5) / _SHAPES
        radii = np.minimum(SMALLEST * (1.0 - shares) ** (-1.0 / _POWER), LARGEST)
        shapes = [_shape(rng, float(radius)) for radius in radii]
        heights, inside = (np.concatenate([part.ravel() for part in parts]) for parts in zip(*shapes, strict=True))
        return cls(heights, inside, np.array([len(height) // 2 for height, _ in shapes]), density)

    def near(self, seed: int, window: Window) -> tuple[NDArray[np.int64], Floats]:
        """Pebbles that reach into a window, whose borders are multiples of its size; the same for each neighbour.

        Returns:
            Row and column of their middles in the window, half sides and beginnings of their shapes (n, 4) [texels],
            and albedos relative to sand and tints, 0 sand, 1 grey stone (n, 2); the lowest first.
        """
        cells = [self._scattered(seed, window, i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        return np.concatenate([places for places, _ in cells]), np.concatenate([looks for _, looks in cells])

    def _scattered(self, seed: int, window: Window, i: int, j: int) -> tuple[NDArray[np.int64], Floats]:
        """Pebbles of the window i rows and j columns of windows away that reach into this one."""
        rows, columns = window.shape
        cell = (window.top // rows + i + _POSITIVE, window.left // columns + j + _POSITIVE)
        rng = np.random.default_rng([seed, *cell])
        count = rng.poisson(self.density * rows * columns * TEXEL**2)
        shapes = rng.integers(len(self.halves), size=count)
        row, column = (rng.integers(side, size=count) + side * shift for side, shift in ((rows, i), (columns, j)))
        albedo, tint = rng.uniform(0.55, 1.15, count), rng.uniform(0.1, 0.8, count)
        sizes, reach = (2 * self.halves + 1) ** 2, self.halves[shapes]
        reaching = (row + reach >= 0) & (row - reach < rows) & (column + reach >= 0) & (column - reach < columns)
        places = np.column_stack([row, column, reach, (np.cumsum(sizes) - sizes)[shapes]])
        return places[reaching], np.column_stack([albedo, tint]).astype(np.float32)[reaching]

    def lay(self, places: NDArray[np.int64], looks: Floats, height: Floats, albedo: Floats, tint: Floats) -> None:
        """Lay pebbles on the sand of a window, which gets new height, albedo and tint."""
        compiled = kernel("sensors.sand", "relief.c", "lay")
        if compiled is not None:
            compiled(len(places), *height.shape, places, looks, self.heights, self.inside, height, albedo, tint)
            return
        whole = Window(0, 0, *height.shape)
        for (row, column, n, begin), look in zip(places.tolist(), looks.tolist(), strict=True):
            extent, side = Window(row - n, column - n, row + n + 1, column + n + 1), 2 * n + 1
            here, part = extent.common(whole).within(whole), extent.common(whole).within(extent)
            shape = slice(begin, begin + side**2)
            raised, inside = self.heights[shape].reshape(side, side), self.inside[shape].reshape(side, side)[part]
            np.maximum(0.5 * height[here] + raised[part], height[here], out=height[here], where=inside)
            albedo[here][inside], tint[here][inside] = look


def _shape(rng: np.random.Generator, radius: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Draw the height (n, n) of an irregular, half-buried ellipsoid above the sand [m], and where it is a pebble."""
    reach = math.ceil(1.3 * radius / TEXEL) + 1
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] * TEXEL
    turn, flat = rng.uniform(0.0, math.pi), rng.uniform(0.7, 1.0)
    u, v = x * math.cos(turn) + y * math.sin(turn), (y * math.cos(turn) - x * math.sin(turn)) / flat
    around = np.arctan2(v, u)
    outline = (
        1.0 + 0.1 * np.cos(2.0 * around + rng.uniform(0.0, 6.3)) + 0.08 * np.cos(3.0 * around + rng.uniform(0, 6.3))
    )
    q = (u * u + v * v) / (radius * outline) ** 2
    height = radius * rng.uniform(0.45, 0.85) * (np.clip(1.0 - q, 0.0, 1.0) ** 0.6 - 0.1)
    smooth = cv2.GaussianBlur(height.astype(np.float32), (0, 0), 0.7)
    return np.asarray(smooth, dtype=np.float32), q < 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SandKind:
    """Look of a kind of sand, and the default range of the sun's position.

    All sizes are assumed: chosen by eye from the paper's description, in the range of natural beaches.
    """

    ripples: float = 0.0005  # amplitude of wind ripples [m]
    low_relief: float = 0.0025  # standard deviation of the relief above 0.1 m wavelength [m]
    stones: float = 300.0  # pebbles above 1.5 mm radius [1/m2]
    blotches: float = 0.05  # standard deviation of the relative albedo [-]
    wet: float = 0.0  # share of the light that wet patches absorb [-]
    cracks: float = 0.0  # depth of cracks across the path [m]
    rocks: float = 0.0  # beside the path [1/m2]
    foreign_tracks: bool = False  # tracks of other vehicles beside and across the path
    mast: bool = False  # the rover has a mast with a head that pans
    azimuth: tuple[float, float] = (math.radians(60.0), math.radians(210.0))  # of the sun from the path, + left [rad]
    elevation: tuple[float, float] = (math.radians(30.0), math.radians(48.0))  # of the sun [rad]


# A sun ahead on the right casts the rover's own shadow into the camera's view, ahead on the left the shadows of rocks
# beside the path. From behind it brings out relief across the path.
_OWN_SHADOW: Final = (math.radians(-75.0), math.radians(10.0))  # [rad]
_ROCK_SHADOWS: Final = (math.radians(-50.0), math.radians(80.0))
_BEHIND: Final = (math.radians(105.0), math.radians(215.0))
_LOW: Final = (math.radians(22.0), math.radians(38.0))

KINDS: Final[dict[str, SandKind]] = {
    "uniform": SandKind(),
    "ripples": SandKind(ripples=0.0028, cracks=0.004, azimuth=_BEHIND, elevation=_LOW),
    "pebbles": SandKind(ripples=0.0008, low_relief=0.004, stones=3500.0, blotches=0.13, wet=0.35),
    "shadows": SandKind(
        ripples=0.0008, low_relief=0.003, stones=700.0, blotches=0.07, rocks=2.0, mast=True, azimuth=_OWN_SHADOW
    ),
    "mast_shadows": SandKind(
        ripples=0.0006,
        low_relief=0.003,
        stones=2200.0,
        blotches=0.10,
        rocks=5.0,
        mast=True,
        azimuth=_ROCK_SHADOWS,
        elevation=_LOW,
    ),
    "foreign": SandKind(ripples=0.0008, low_relief=0.003, stones=500.0, blotches=0.06, foreign_tracks=True),
}


def kind_named(name: str) -> SandKind:
    """Look up a kind of sand.

    Raises:
        ValueError: if there is no kind of this name.
    """
    if name not in KINDS:
        raise ValueError(f"terrain = {name!r} must be one of {', '.join(KINDS)}")
    return KINDS[name]


_COARSE: Final = 8  # texels a side of a coarse cell
_COARSE_SIZE: Final = 768  # cells; repeats after 6.1 m
_FINE_SIZES: Final = (1024, 864)  # texels; both together repeat after 27 m
RIPPLE_LENGTH: Final = 0.085  # crest to crest of wind ripples in medium sand [m]
_CRACKS: Final = 0.41  # distance between cracks [m]
ALBEDO: Final = 150.0  # mean of sand [levels]


@dataclass(frozen=True, slots=True, eq=False)
class _CoarseMap:
    """Smooth noise of unit standard deviation in cells of ``COARSE`` texels."""

    cells: Floats  # (n, n)

    @classmethod
    def draw(cls, rng: np.random.Generator, slope: float, shortest: float) -> "_CoarseMap":
        """Draw noise without wavelengths below ``shortest`` [m]."""
        band = _band(np.inf, shortest, _COARSE * TEXEL)
        return cls(fractal_noise(rng, (_COARSE_SIZE, _COARSE_SIZE), slope, band))

    def over(self, window: Window) -> Floats:
        """Values of the map in a window."""
        top, left = window.top // _COARSE - 2, window.left // _COARSE - 2
        bottom, right = window.bottom // _COARSE + 3, window.right // _COARSE + 3
        rows, columns = np.arange(top, bottom) % len(self.cells), np.arange(left, right) % len(self.cells)
        size = (_COARSE * (right - left), _COARSE * (bottom - top))
        fine = cv2.resize(self.cells[np.ix_(rows, columns)], size, interpolation=cv2.INTER_CUBIC)
        outer = Window(_COARSE * top, _COARSE * left, _COARSE * bottom, _COARSE * right)
        return np.asarray(fine[window.within(outer)], dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _FineMap:
    """Noise of unit standard deviation, texel by texel."""

    layers: tuple[Floats, ...]

    @classmethod
    def draw(
        cls, rng: np.random.Generator, slope: float, longest: float, shortest: float, *, layers: int = 1
    ) -> "_FineMap":
        """Draw noise with wavelengths in a band [m], in one layer or in two that do not repeat together."""
        band = _band(longest, shortest, TEXEL)
        sizes = _FINE_SIZES[:layers]
        scale = np.float32(1.0 / np.sqrt(layers))
        return cls(tuple(scale * fractal_noise(rng, (size, size), slope, band) for size in sizes))

    def over(self, window: Window) -> Floats:
        """Values of the map in a window."""
        total: Floats | None = None
        for layer in self.layers:
            part = _wrapped(layer, window)
            total = part if total is None else total + part
        return np.zeros(window.shape, np.float32) if total is None else total


@dataclass(frozen=True, slots=True, eq=False)
class UndisturbedSand:
    """Sand of a window before any wheel."""

    height: Floats  # in W [m]
    albedo: Bytes  # mean ``ALBEDO``
    tint: Bytes  # 0 sand, 255 grey stone


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Generator of undisturbed sand for any place."""

    kind: SandKind
    terrain: Terrain
    crest: float  # direction across the ripples, in W [rad]
    seed: int
    low: _CoarseMap
    warp: _CoarseMap
    patches: _CoarseMap
    rough: _FineMap
    grain: _FineMap
    pebbles: Pebbles

    @classmethod
    def draw(cls, rng: np.random.Generator, kind: SandKind, terrain: Terrain, crest: float) -> "Relief":
        """Draw the relief of a kind of sand on a large shape."""
        return cls(
            kind=kind,
            terrain=terrain,
            crest=crest,
            seed=int(rng.integers(1 << 48)),
            low=_CoarseMap.draw(rng, 1.9, 0.10),
            warp=_CoarseMap.draw(rng, 1.8, 0.12),
            patches=_CoarseMap.draw(rng, 1.4, 0.05),
            rough=_FineMap.draw(rng, 1.6, 0.05, 0.004, layers=2),
            grain=_FineMap.draw(rng, 0.5, 0.008, 0.0025, layers=2),
            pebbles=Pebbles.draw(rng, kind.stones),
        )

    def ground(self, window: Window) -> UndisturbedSand:
        """Sand of a window; its borders must be multiples of its size, as pebbles are drawn by windows."""
        grain, patches = self.grain.over(window), self.patches.over(window)
        height = self._ripples(window, patches) + np.float32(0.0003) * self.rough.over(window)
        height += np.float32(0.00006) * grain
        height += self.kind.low_relief * self.low.over(window) - self._cracks(window, patches)
        albedo = 1.0 + 0.6 * self.kind.blotches * grain + self.kind.blotches * patches
        albedo -= 0.35 * np.clip(3.0 * (np.abs(grain) - 2.6), 0.0, 1.0) * np.sign(grain)  # dark and bright grains
        if self.kind.wet:
            albedo *= 1.0 - self.kind.wet * sigmoid(6.0 * (patches - 0.8))
        tint = np.zeros(window.shape, np.float32)
        self.pebbles.lay(*self.pebbles.near(self.seed, window), height, albedo, tint)
        height += self.large(window)
        return UndisturbedSand(
            height.astype(np.float32), np.clip(ALBEDO * albedo, 0, 255).astype(np.uint8), to_bytes(tint)
        )

    def crumbs(self, window: Window) -> Crumbs:
        """Noise that makes the edges of ruts ragged."""
        return Crumbs(self.rough.over(window), self.patches.over(window))

    def large(self, window: Window) -> Floats:
        """Height of the large shape in a window [m]."""
        outer = window.grown(_COARSE)
        rows, columns = (math.ceil(side / _COARSE) for side in outer.shape)
        x = outer.left * TEXEL + (np.arange(columns) * _COARSE + 0.5 * (_COARSE - 1)) * TEXEL
        y = outer.top * TEXEL + (np.arange(rows) * _COARSE + 0.5 * (_COARSE - 1)) * TEXEL
        coarse = np.asarray(
            self.terrain.height(x[None, :] + 0.0 * y[:, None], y[:, None] + 0.0 * x[None, :]), np.float32
        )
        fine = cv2.resize(coarse, (columns * _COARSE, rows * _COARSE), interpolation=cv2.INTER_LINEAR)
        return np.asarray(fine[_COARSE:, _COARSE:][: window.shape[0], : window.shape[1]], dtype=np.float32)

    def _ripples(self, window: Window, patches: Floats) -> Floats:
        """Heights of wind ripples, whose crests wind and end [m]."""
        cycles = self._across_crests(window, RIPPLE_LENGTH) + np.float32(0.012 / RIPPLE_LENGTH) * self.warp.over(window)
        phase = np.float32(2.0 * math.pi) * cycles
        strength = np.clip(0.8 + 0.35 * patches, 0.1, 1.6)
        return np.asarray(self.kind.ripples * strength * (np.sin(phase) + 0.25 * np.sin(2.0 * phase + 0.9)), np.float32)

    def _cracks(self, window: Window, patches: Floats) -> Floats:
        """Depth of cracks, which run parallel to the crests [m]."""
        if not self.kind.cracks:
            return np.zeros(window.shape, np.float32)
        warp = np.float32(0.02) * self.warp.over(window) + np.float32(0.0012) * self.rough.over(window)
        place = self._across_crests(window, _CRACKS) + warp * np.float32(1.0 / _CRACKS)  # [cracks]
        distance = np.abs(place - np.round(place)) * np.float32(_CRACKS)
        open_here = np.clip(0.6 + patches, 0.0, 1.0)
        return np.asarray(self.kind.cracks * open_here * np.exp(-((distance / 0.004) ** 2)), dtype=np.float32)

    def _across_crests(self, window: Window, length: float) -> Floats:
        """Distance across the crests in wavelengths [-], less a whole number of them to keep float32 precise."""
        x, y = window.places()
        c, s = math.cos(self.crest), math.sin(self.crest)
        begin = float(window.corner @ [c, s]) / length
        return x * np.float32(c / length) + y * np.float32(s / length) + np.float32(begin - math.floor(begin))


def _band(longest: float, shortest: float, cell: float) -> tuple[float, float]:
    """Band of wavelengths [m] in cycles per cell."""
    return (cell / longest if np.isfinite(longest) else 0.0, cell / shortest)


def _wrapped(layer: Floats, window: Window) -> Floats:
    """Window of a periodic map."""
    n = len(layer)
    rows, columns = (
        [slice(max(begin - k, 0), min(begin + size - k, n)) for k in range(0, begin + size, n)]
        for begin, size in ((window.top % n, window.shape[0]), (window.left % n, window.shape[1]))
    )
    parts = [[layer[r, c] for c in columns] for r in rows]
    return parts[0][0] if len(rows) == len(columns) == 1 else np.block(parts)
