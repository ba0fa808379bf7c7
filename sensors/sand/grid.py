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

from vehicle.frames import FloatArray

Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
TEXEL: Final = 1e-3  # [m]
_STEEPEST: Final = np.float32(0.75 * TEXEL)  # height between texels at the slope of repose of dry sand, tan 37 deg [m]
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


class Crumbs(NamedTuple):
    """Noise of unit standard deviation that makes the edges of an imprint ragged."""

    fine: Floats  # wavelengths of some millimetres
    broad: Floats  # of some centimetres

    def texels(self, inside: NDArray[np.bool_]) -> "Crumbs":
        """Chosen texels (n,) of a window."""
        return Crumbs(self.fine[inside], self.broad[inside])


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


def strip_of(roll: Roll, window: Window, reach: float) -> Strip:
    """Strip of a path; successive paths cover every texel along them once, also in curves."""
    x, y = window.places()
    a, b = (roll.a - window.corner).astype(np.float32), (roll.b - window.corner).astype(np.float32)
    ta, tb = roll.towards_a.astype(np.float32), roll.towards_b.astype(np.float32)
    behind_a = (x - a[0]) * ta[0] + (y - a[1]) * ta[1]
    before_b = (b[0] - x) * tb[0] + (b[1] - y) * tb[1]
    between = (behind_a >= 0.0) & (before_b > 0.0)
    rows, columns = np.nonzero(between)
    p, q = behind_a[between], before_b[between]
    along = p / np.maximum(p + q, np.float32(1e-9))
    tx, ty = ta[0] + along * (tb[0] - ta[0]), ta[1] + along * (tb[1] - ta[1])
    left_x, left_y = x[0, columns] - a[0] - along * (b[0] - a[0]), y[rows, 0] - a[1] - along * (b[1] - a[1])
    across = left_y * tx - left_x * ty
    near = np.abs(across) < reach
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


def imprinted(
    roll: Roll, tread: Tread, strip: Strip, sand: Sand, large: Floats, crumbs: Crumbs, displaced: float
) -> tuple[Sand, float]:
    """Texels (n,) of a strip after a wheel has rolled through, and the sand removed from its rut per length [m2].

    ``large`` is the ground without its relief [m], ``displaced`` the sand per length that feeds the berms [m2].
    """
    height = sand.height
    across = strip.across + np.float32(0.0011) * crumbs.fine + np.float32(0.0014) * crumbs.broad
    lateral = np.abs(across)
    edge = 0.5 * tread.width * abs(math.cos(roll.slip_angle))
    flank = _contact(tread, roll.sinkage) * abs(math.sin(roll.slip_angle))
    wall = max(roll.sinkage / _REPOSE, 0.004) + 0.5 * flank
    brink = edge + _FLANK * flank  # at half the height of the wall, before and after it slumps
    share = np.clip((brink + 0.5 * wall - lateral) / wall, 0.0, 1.0)
    cut = share * share * (3.0 - 2.0 * share)
    marks, slots = _lug_marks(roll, tread, strip, crumbs, edge)
    relief = _KEPT * np.clip(height - large, LOWEST_RELIEF, HIGHEST_RELIEF)
    floor = large - roll.sinkage + relief + 0.0006 * crumbs.broad + 0.00012 * crumbs.fine + marks
    rut = height + (np.minimum(floor, height + 0.002) - height) * cut
    removed = float(np.maximum(height - rut, 0.0).sum()) * TEXEL**2 / roll.length
    new = rut + _berms(roll, tread, across, brink, displaced, crumbs) * (1.0 - cut)
    pressed = np.maximum(sand.packed, (255.0 * cut * (0.75 + 0.25 * slots)).astype(np.uint8))
    return Sand(np.asarray(new, dtype=np.float32), pressed), removed


def _contact(tread: Tread, sinkage: float) -> float:
    """Half the length of the sunken part of the wheel [m]."""
    depth = min(sinkage, tread.radius)
    return math.sqrt(depth * (2.0 * tread.radius - depth))


def _lug_marks(roll: Roll, tread: Tread, strip: Strip, crumbs: Crumbs, edge: float) -> tuple[Floats, Floats]:
    """Heights of lug marks, slots and the ridges behind them [m], and the slots alone (0 to 1).

    Lugs lie across the heading, not across the direction of travel: side slip skews their marks. A wheel that spins or
    drags smears them by the distance it slides while a lug is in the sand; side slip smears their ends.
    """
    rolled = roll.turned_b - roll.turned_a
    length = max(roll.length, 1e-6)
    skew = math.tan(max(min(roll.slip_angle, 1.2), -1.2))
    turned = roll.turned_a + (strip.along - strip.across * (skew / length)) * rolled
    count = turned * (tread.lugs / (2.0 * math.pi)) + 0.03 * crumbs.broad + 0.022 * crumbs.fine
    number = np.floor(count)
    phase = count - number
    contact = _contact(tread, roll.sinkage)
    spacing = 2.0 * math.pi * tread.radius / tread.lugs
    slid = contact * abs(tread.radius * rolled / length - 1.0)  # while a lug is in the sand [m]
    clear = 1.0 / (1.0 + 2.0 * slid / spacing)
    width = 0.075 + 0.35 * min(slid / spacing, 0.5)
    odd = np.sin(number * 12.9898) * 43758.5453
    odd -= np.floor(odd)  # 0 to 1: every lug presses a little differently
    slots = np.exp(-np.square(np.square((phase - 0.28) / width)))
    ridges = np.exp(-(((phase - 0.50) / 0.085) ** 2)) + 0.3 * np.exp(-(((phase - 0.05) / 0.055) ** 2))
    smeared = 0.006 + 0.5 * contact * abs(math.sin(roll.slip_angle))
    ends = np.clip((edge - 0.002 - np.abs(strip.across)) / smeared, 0.0, 1.0)
    depth = tread.lug_height * min(1.0, roll.sinkage / tread.lug_height) * clear
    marks = depth * ends * (0.5 * ridges * (0.7 + 0.5 * odd) * (1.0 + 0.2 * crumbs.fine) - slots * (0.75 + 0.5 * odd))
    return np.asarray(marks, dtype=np.float32), np.asarray(slots * ends, dtype=np.float32)


def _berms(roll: Roll, tread: Tread, across: Floats, edge: float, displaced: float, crumbs: Crumbs) -> Floats:
    """Heights of the berms on both sides of the rut [m]."""
    slide = math.sin(roll.slip_angle)
    ploughed = (2.0 / 3.0) * roll.sinkage * _contact(tread, roll.sinkage) * abs(slide)  # by the wheel's side [m2]
    left = _BERM_SHARE * displaced * max(1.0 + 2.0 * slide, 0.2) + 0.5 * ploughed * (slide > 0.0)
    right = _BERM_SHARE * displaced * max(1.0 - 2.0 * slide, 0.2) + 0.5 * ploughed * (slide < 0.0)
    crest = np.where(across > 0.0, left, right) / (math.sqrt(math.pi) * _BERM)
    outside = np.abs(across) - edge
    profile = np.exp(-(((outside - 0.013) / _BERM) ** 2)) * np.clip((outside + 0.006) / 0.006, 0.0, 1.0)
    ragged = np.clip(1.0 + 0.4 * crumbs.broad + 0.2 * crumbs.fine, 0.15, 2.2)
    thrown = (
        np.exp(-np.clip(outside - 0.012, 0.0, None) / 0.012) * (outside > 0.012) * np.clip(crumbs.fine - 1.0, 0.0, 2.0)
    )
    return np.asarray(np.minimum(crest * profile * ragged, 0.014) + 0.25 * crest * thrown, dtype=np.float32)
