"""Grid of texels that represents the sand, with its slumping, and the imprint of a wheel in it.

Texel (row, column) has its centre at x = column * TEXEL, y = row * TEXEL in W; arrays are [row, column].

The sunken part of the wheel sweeps the rut. Its floor is as wide as the wheel appears along the direction of travel; a
wheel with side slip sweeps flanks with its front and rear ends. Most of the displaced sand is compacted, the rest lies
in two berms. Sand that the side of the wheel bulldozes lies on the side it slides to.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
TEXEL: Final = 1e-3  # [m]
_STEEPEST: Final = np.float32(0.75 * TEXEL)  # height between texels at the slope of repose of dry sand, tan 37 deg [m]
_SWEEPS: Final = 4  # of slumping after an imprint
_SHARE: Final = np.float32(0.24)  # of the excess height that moves in a sweep; above a quarter it is unstable


class Window(NamedTuple):
    """Rectangle of texels; ``bottom`` and ``right`` are exclusive."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.bottom - self.top, self.right - self.left

    def grown(self, by: int) -> "Window":
        """Window with a margin of ``by`` texels on each side."""
        return Window(self.top - by, self.left - by, self.bottom + by, self.right + by)

    def common(self, other: "Window") -> "Window":
        """Intersection of two windows; it may be empty."""
        return Window(
            max(self.top, other.top),
            max(self.left, other.left),
            min(self.bottom, other.bottom),
            min(self.right, other.right),
        )

    @property
    def is_empty(self) -> bool:
        """True if the window has no texels."""
        return self.bottom <= self.top or self.right <= self.left

    def within(self, outer: "Window") -> tuple[slice, slice]:
        """Slices of its texels in an array of the outer window."""
        return (
            slice(self.top - outer.top, self.bottom - outer.top),
            slice(self.left - outer.left, self.right - outer.left),
        )

    def places(self) -> tuple[Floats, Floats]:
        """x (1, columns) and y (rows, 1) of its texels relative to the first one, to keep float32 precise [m]."""
        rows, columns = self.shape
        x = np.arange(columns, dtype=np.float32)[None, :] * np.float32(TEXEL)
        y = np.arange(rows, dtype=np.float32)[:, None] * np.float32(TEXEL)
        return x, y

    @property
    def corner(self) -> FloatArray:
        """Place of the first texel in W (2,) [m]."""
        return np.array([self.left * TEXEL, self.top * TEXEL])


def window_around(points: FloatArray, margin: float) -> Window:
    """Smallest window with all points (n, 2) of W [m] and a margin around them [m]."""
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return Window(
        math.floor(low[1] / TEXEL),
        math.floor(low[0] / TEXEL),
        math.ceil(high[1] / TEXEL) + 1,
        math.ceil(high[0] / TEXEL) + 1,
    )


def slumped(height: Floats, inside: NDArray[np.bool_], sweeps: int) -> Floats:
    """Height map after some sweeps; in each of them sand moves by at most one texel within ``inside``."""
    ground = height.copy()
    down = (ground[:-1], ground[1:], _SHARE * (inside[1:] & inside[:-1]))
    right = (ground[:, :-1], ground[:, 1:], _SHARE * (inside[:, 1:] & inside[:, :-1]))
    for _ in range(sweeps):
        for one, other, free in (down, right):
            step = other - one
            slide = (step - np.minimum(np.maximum(step, -_STEEPEST), _STEEPEST)) * free
            one += slide
            other -= slide
    return ground


_REPOSE: Final = 0.70  # slope of repose of dry sand, tan 35 deg
_BERM_SHARE: Final = 0.10  # of the displaced sand in each berm; the rest is compacted (assumed)
_BERM: Final = 0.0095  # half width of a berm's crest [m]
_KEPT: Final = 0.18  # share of the relief that remains on the floor of a rut
_FLANK: Final = 0.7  # length of a flank at half height over its length: the sunken part is a parabola
LOWEST_RELIEF, HIGHEST_RELIEF = -0.004, 0.006  # limits of the relief that remains [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tread:
    """Dimensions of a wheel that shape its imprint."""

    radius: float  # [m]
    width: float  # [m]
    lugs: int  # number around the wheel, straight across
    lug_height: float  # [m]


class Roll(NamedTuple):
    """Short path of a wheel's lowest point, from a to b."""

    a: FloatArray  # (2,) in W [m]
    b: FloatArray  # (2,)
    towards_a: FloatArray  # (2,) unit vectors of travel at a and b
    towards_b: FloatArray
    slip_angle: float  # travel relative to heading, + left [rad]
    turned_a: float  # angle rolled so far at a and b [rad]
    turned_b: float
    sinkage: float  # [m]

    @property
    def length(self) -> float:
        """Distance from a to b [m]."""
        return float(np.hypot(*(self.b - self.a)))

    def reach(self, tread: Tread) -> float:
        """Largest lateral distance at which the sand changes [m]."""
        return 0.5 * tread.width + _contact(tread, self.sinkage) + 0.05


class Imprint(NamedTuple):
    """Numbers of the imprint of a path, in the order of imprint.c; places from the window's first texel [m]."""

    ends: FloatArray  # (4, 2) a and b of the path, and the unit vectors of travel there
    reach: float  # see ``Roll.reach`` [m]
    edge: float  # half the width of the floor [m]
    wall: float  # width of a wall before it slumps [m]
    brink: float  # from the middle to a wall at half its height, before and after it slumps [m]
    sinkage: float  # [m]
    turned: float  # angle rolled at a [rad]
    rolled: float  # from a to b [rad]
    skew: float  # of lug marks: shares of the path, by metre across [1/m]
    lugs: float  # by radian [1/rad]
    lug_width: float  # of a mark over the distance of lugs [-]
    smeared: float  # width over which the ends of marks fade [m]
    depth: float  # of marks [m]
    left: float  # crests of the berms [m]
    right: float

    @classmethod
    def of(cls, roll: Roll, tread: Tread, window: Window, displaced: float) -> "Imprint":
        """Imprint in a window; ``displaced`` is the sand per length that feeds the berms [m2].

        Lugs lie across the heading, not across the direction of travel: side slip skews their marks. A wheel that spins
        or drags smears them by the distance it slides while a lug is in the sand; side slip smears their ends.
        """
        slide, length, contact = math.sin(roll.slip_angle), max(roll.length, 1e-6), _contact(tread, roll.sinkage)
        edge, flank = 0.5 * tread.width * abs(math.cos(roll.slip_angle)), contact * abs(slide)
        rolled, spacing = roll.turned_b - roll.turned_a, 2.0 * math.pi * tread.radius / tread.lugs
        slid = contact * abs(tread.radius * rolled / length - 1.0) / spacing  # while a lug is in the sand [lugs]
        ploughed = (2.0 / 3.0) * roll.sinkage * flank  # by the wheel's side [m2]
        left, right = (
            (_BERM_SHARE * displaced * max(1.0 + 2.0 * to_side, 0.2) + 0.5 * ploughed * (to_side > 0.0))
            / (math.sqrt(math.pi) * _BERM)
            for to_side in (slide, -slide)
        )
        return cls(
            np.array([roll.a - window.corner, roll.b - window.corner, roll.towards_a, roll.towards_b]),
            reach=roll.reach(tread),
            edge=edge,
            wall=max(roll.sinkage / _REPOSE, 0.004) + 0.5 * flank,
            brink=edge + _FLANK * flank,
            sinkage=roll.sinkage,
            turned=roll.turned_a,
            rolled=rolled,
            skew=math.tan(max(min(roll.slip_angle, 1.2), -1.2)) / length,
            lugs=tread.lugs / (2.0 * math.pi),
            lug_width=0.075 + 0.35 * min(slid, 0.5),
            smeared=0.006 + 0.5 * flank,
            depth=tread.lug_height * min(1.0, roll.sinkage / tread.lug_height) / (1.0 + 2.0 * slid),
            left=left,
            right=right,
        )


class Crumbs(NamedTuple):
    """Noise of unit standard deviation that makes the edges of an imprint ragged."""

    fine: Floats  # wavelengths of some millimetres
    broad: Floats  # of some centimetres


class Strip(NamedTuple):
    """Texels of a window along a wheel's path, in coordinates of the path."""

    inside: NDArray[np.bool_]  # (h, w) True for texels of this path, not of the one before or after
    along: Floats  # (n,) share of the path, 0 at a and 1 at b
    across: Floats  # (n,) + left [m]


def window_of(roll: Roll, reach: float) -> Window:
    """Window that contains the strip of a path."""
    ends = ((roll.a, roll.towards_a), (roll.b, roll.towards_b))
    sides = [end + side * np.array([-t[1], t[0]]) for end, t in ends for side in (-reach, reach)]
    return window_around(np.array(sides), 2.0 * TEXEL)


def strip_of(p: Imprint, window: Window) -> Strip:
    """Strip of a path; successive paths cover every texel along them once, also in curves."""
    x, y = window.places()
    (a_x, a_y), (b_x, b_y), (ta_x, ta_y), (tb_x, tb_y) = p.ends.astype(np.float32)
    behind_a = (x - a_x) * ta_x + (y - a_y) * ta_y
    before_b = (b_x - x) * tb_x + (b_y - y) * tb_y
    between = (behind_a >= 0.0) & (before_b > 0.0)
    rows, columns = np.nonzero(between)
    f, g = behind_a[between], before_b[between]
    along = f / np.maximum(f + g, np.float32(1e-9))
    tx, ty = ta_x + along * (tb_x - ta_x), ta_y + along * (tb_y - ta_y)
    left_x, left_y = x[0, columns] - a_x - along * (b_x - a_x), y[rows, 0] - a_y - along * (b_y - a_y)
    across = left_y * tx - left_x * ty
    near = np.abs(across) < p.reach
    between[between] = near
    return Strip(between, along[near], across[near])


class Sand(NamedTuple):
    """State of some texels of the field."""

    height: Floats  # [m]
    packed: Bytes  # 255 where a wheel has compacted it

    def texels(self, inside: NDArray[np.bool_]) -> "Sand":
        """Chosen texels (n,) of a window."""
        return Sand(self.height[inside], self.packed[inside])

    def with_texels(self, inside: NDArray[np.bool_], texels: "Sand") -> "Sand":
        """Copy of a window with new values in chosen texels (n,)."""
        height, packed = self.height.copy(), self.packed.copy()
        height[inside], packed[inside] = texels
        return Sand(height, packed)


def imprinted(p: Imprint, strip: Strip, sand: Sand, large: Floats, crumbs: Crumbs) -> tuple[Sand, float]:
    """Texels (n,) of a strip after a wheel has rolled through, and the sand removed from its rut [m3].

    ``large`` is the ground without its relief [m].
    """
    height = sand.height
    across = strip.across + np.float32(0.0011) * crumbs.fine + np.float32(0.0014) * crumbs.broad
    share = np.clip((p.brink + 0.5 * p.wall - np.abs(across)) / p.wall, 0.0, 1.0)
    cut = share * share * (3.0 - 2.0 * share)
    marks, slots = _lug_marks(p, strip, crumbs)
    relief = _KEPT * np.clip(height - large, LOWEST_RELIEF, HIGHEST_RELIEF)
    floor = large - p.sinkage + relief + 0.0006 * crumbs.broad + 0.00012 * crumbs.fine + marks
    rut = height + (np.minimum(floor, height + 0.002) - height) * cut
    removed = float(np.maximum(height - rut, 0.0).sum()) * TEXEL**2
    new = rut + _berms(p, across, crumbs) * (1.0 - cut)
    pressed = np.maximum(sand.packed, (255.0 * cut * (0.75 + 0.25 * slots)).astype(np.uint8))
    return Sand(np.asarray(new, dtype=np.float32), pressed), removed


def _contact(tread: Tread, sinkage: float) -> float:
    """Half the length of the sunken part of the wheel [m]."""
    depth = min(sinkage, tread.radius)
    return math.sqrt(depth * (2.0 * tread.radius - depth))


def _lug_marks(p: Imprint, strip: Strip, crumbs: Crumbs) -> tuple[Floats, Floats]:
    """Heights of lug marks, slots and the ridges behind them [m], and the slots alone (0 to 1)."""
    turned = p.turned + (strip.along - strip.across * p.skew) * p.rolled
    count = turned * p.lugs + 0.03 * crumbs.broad + 0.022 * crumbs.fine
    number = np.floor(count)
    phase = count - number
    odd = np.sin(number * 12.9898) * 43758.5453
    odd -= np.floor(odd)  # 0 to 1: every lug presses a little differently
    slots = np.exp(-np.square(np.square((phase - 0.28) / p.lug_width)))
    ridges = np.exp(-(((phase - 0.50) / 0.085) ** 2)) + 0.3 * np.exp(-(((phase - 0.05) / 0.055) ** 2))
    ends = np.clip((p.edge - 0.002 - np.abs(strip.across)) / p.smeared, 0.0, 1.0)
    marks = p.depth * ends * (0.5 * ridges * (0.7 + 0.5 * odd) * (1.0 + 0.2 * crumbs.fine) - slots * (0.75 + 0.5 * odd))
    return np.asarray(marks, dtype=np.float32), np.asarray(slots * ends, dtype=np.float32)


def _berms(p: Imprint, across: Floats, crumbs: Crumbs) -> Floats:
    """Heights of the berms on both sides of the rut [m]."""
    crest, outside = np.where(across > 0.0, np.float32(p.left), np.float32(p.right)), np.abs(across) - p.brink
    profile = np.exp(-(((outside - 0.013) / _BERM) ** 2)) * np.clip((outside + 0.006) / 0.006, 0.0, 1.0)
    ragged = np.clip(1.0 + 0.4 * crumbs.broad + 0.2 * crumbs.fine, 0.15, 2.2)
    thrown = (
        np.exp(-np.clip(outside - 0.012, 0.0, None) / 0.012) * (outside > 0.012) * np.clip(crumbs.fine - 1.0, 0.0, 2.0)
    )
    return np.asarray(np.minimum(crest * profile * ragged, 0.014) + 0.25 * crest * thrown, dtype=np.float32)


_NUMBERS: Final = tuple(
    f"{name}={float(value)!r}f"
    for name, value in (
        ("TEXEL", TEXEL),
        ("BERM", _BERM),
        ("KEPT", _KEPT),
        ("LOWEST", LOWEST_RELIEF),
        ("HIGHEST", HIGHEST_RELIEF),
        ("SHARE", _SHARE),
        ("STEEPEST", _STEEPEST),
    )
)


def rolled_over(sand: Sand, p: Imprint, large: Floats, crumbs: Crumbs, window: Window) -> tuple[Sand, float]:
    """Sand of a window after a wheel has rolled over it and its walls slumped, and the sand removed [m3]."""
    compiled = kernel("sensors.sand", "imprint.c", "imprint", _NUMBERS)
    if compiled is None:
        strip = strip_of(p, window)
        of_these = (part[strip.inside] for part in (large, *crumbs))
        after, removed = imprinted(p, strip, sand.texels(strip.inside), next(of_these), Crumbs(*of_these))
        new = sand.with_texels(strip.inside, after)
        return Sand(slumped(new.height, strip.inside, _SWEEPS), new.packed), removed
    new, removed_here = Sand(*map(np.array, sand)), np.empty(1)
    arrays = (
        np.array([*p.ends.ravel(), *p[1:]], np.float32),
        *(np.ascontiguousarray(part) for part in (large, *crumbs)),
    )
    compiled(*window.shape, _SWEEPS, *arrays, *new, np.empty(window.shape, np.uint8), removed_here)
    return new, float(removed_here[0])
