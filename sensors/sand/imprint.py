"""The imprint of one wheel that rolls over sand: rut, marks of its lugs, and berms beside it.

The rut is what the sunken part of the wheel sweeps: a floor as wide as the wheel looks along its way, and flanks that
its front and rear ends sweep when it does not go where it points. Sand that is pushed out of it lies in two berms, and
most of it is packed; what the wheel's side pushes along lies on the side that it slides to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.sand.grid import TEXEL, Bytes, Floats, Window, window_around
from vehicle.frames import FloatArray

_REPOSE: Final = 0.70  # slope at which dry sand stays, tan 35 deg
_ASIDE: Final = 0.10  # share of the displaced sand that goes into each berm; the rest is packed (assumed)
_BERM: Final = 0.0095  # half width of a berm's crest [m]
_KEPT: Final = 0.18  # share of its own relief that the floor of a rut keeps
_FLANK: Final = 0.7  # of its length, half way up: the sunken part is a parabola, sqrt(1/2) as long there
LOWEST_RELIEF, HIGHEST_RELIEF = -0.004, 0.006  # of what is kept [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tread:
    """A wheel as far as it leaves marks."""

    radius: float  # [m]
    width: float  # [m]
    lugs: int  # around it, straight across
    lug_height: float  # [m]


class Roll(NamedTuple):
    """A short way that a wheel's lowest point goes, from a to b."""

    a: FloatArray  # (2,) in W [m]
    b: FloatArray  # (2,)
    towards_a: FloatArray  # (2,) unit vectors of its travel at a and b
    towards_b: FloatArray
    slip_angle: float  # of its travel against its heading, + left [rad]
    turned_a: float  # angle that the wheel has rolled at a and b [rad]
    turned_b: float
    sinkage: float  # [m]

    @property
    def length(self) -> float:
        """From a to b [m]."""
        return float(np.hypot(*(self.b - self.a)))

    def reach(self, tread: Tread) -> float:
        """How far beside the way anything changes [m]."""
        return 0.5 * tread.width + _contact(tread, self.sinkage) + 0.05


class Crumbs(NamedTuple):
    """Noise of unit deviation that makes edges ragged, of the texels of an imprint."""

    fine: Floats  # some millimetres
    broad: Floats  # some centimetres

    def texels(self, inside: NDArray[np.bool_]) -> Crumbs:
        """Some texels (n,) of a window."""
        return Crumbs(self.fine[inside], self.broad[inside])


class Strip(NamedTuple):
    """The texels of a window that lie beside a way: along and across it."""

    inside: NDArray[np.bool_]  # (h, w) whether a texel belongs to this way and not to the one before or behind
    along: Floats  # (n,) share of the way, 0 at a and 1 at b
    across: Floats  # (n,) + left [m]


def window_of(roll: Roll, reach: float) -> Window:
    """The window that has the strip of a way."""
    ends = ((roll.a, roll.towards_a), (roll.b, roll.towards_b))
    sides = [end + side * np.array([-t[1], t[0]]) for end, t in ends for side in (-reach, reach)]
    return window_around(np.array(sides), 2.0 * TEXEL)


def strip_of(roll: Roll, window: Window, reach: float) -> Strip:
    """The strip of a way: ways that follow each other cover every texel beside them once, in curves, too."""
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
    """Texels of the field as a wheel finds or leaves them."""

    height: Floats  # [m]
    packed: Bytes  # 255 where a wheel has pressed it

    def texels(self, inside: NDArray[np.bool_]) -> Sand:
        """Some texels (n,) of a window."""
        return Sand(self.height[inside], self.packed[inside])

    def with_texels(self, inside: NDArray[np.bool_], texels: Sand) -> Sand:
        """A window with some other texels (n,)."""
        height, packed = self.height.copy(), self.packed.copy()
        height[inside], packed[inside] = texels
        return Sand(height, packed)


def imprinted(
    roll: Roll, tread: Tread, strip: Strip, sand: Sand, large: Floats, crumbs: Crumbs, displaced: float
) -> tuple[Sand, float]:
    """Texels (n,) of a strip after a wheel has rolled through, and how much sand has gone from its rut per length [m2].

    ``large`` is the ground without its relief [m], ``displaced`` the sand per length that the berms come from [m2].
    """
    height = sand.height
    across = strip.across + np.float32(0.0011) * crumbs.fine + np.float32(0.0014) * crumbs.broad
    beside = np.abs(across)
    edge = 0.5 * tread.width * abs(math.cos(roll.slip_angle))
    flank = _contact(tread, roll.sinkage) * abs(math.sin(roll.slip_angle))
    wall = max(roll.sinkage / _REPOSE, 0.004) + 0.5 * flank
    brink = edge + _FLANK * flank  # where the wall is half as high, before and after it slumps
    share = np.clip((brink + 0.5 * wall - beside) / wall, 0.0, 1.0)
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
    """Half the length of the wheel's part below the ground [m]."""
    depth = min(sinkage, tread.radius)
    return math.sqrt(depth * (2.0 * tread.radius - depth))


def _lug_marks(roll: Roll, tread: Tread, strip: Strip, crumbs: Crumbs, edge: float) -> tuple[Floats, Floats]:
    """Slots that lugs leave and ridges behind them [m], and the slots alone (0 to 1).

    Lugs lie across the heading, not across the way: slip skews their marks. A wheel that spins or drags smears them by
    what it slides while a lug is in the sand; one that slides sideways smears their ends.
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
    odd -= np.floor(odd)  # 0 to 1: no two lugs press alike
    slots = np.exp(-np.square(np.square((phase - 0.28) / width)))
    ridges = np.exp(-(((phase - 0.50) / 0.085) ** 2)) + 0.3 * np.exp(-(((phase - 0.05) / 0.055) ** 2))
    smeared = 0.006 + 0.5 * contact * abs(math.sin(roll.slip_angle))
    ends = np.clip((edge - 0.002 - np.abs(strip.across)) / smeared, 0.0, 1.0)
    depth = tread.lug_height * min(1.0, roll.sinkage / tread.lug_height) * clear
    marks = depth * ends * (0.5 * ridges * (0.7 + 0.5 * odd) * (1.0 + 0.2 * crumbs.fine) - slots * (0.75 + 0.5 * odd))
    return np.asarray(marks, dtype=np.float32), np.asarray(slots * ends, dtype=np.float32)


def _berms(roll: Roll, tread: Tread, across: Floats, edge: float, displaced: float, crumbs: Crumbs) -> Floats:
    """Sand that lies beside the rut [m]."""
    slide = math.sin(roll.slip_angle)
    ploughed = (2.0 / 3.0) * roll.sinkage * _contact(tread, roll.sinkage) * abs(slide)  # by the wheel's side [m2]
    left = _ASIDE * displaced * max(1.0 + 2.0 * slide, 0.2) + 0.5 * ploughed * (slide > 0.0)
    right = _ASIDE * displaced * max(1.0 - 2.0 * slide, 0.2) + 0.5 * ploughed * (slide < 0.0)
    crest = np.where(across > 0.0, left, right) / (math.sqrt(math.pi) * _BERM)
    away = np.abs(across) - edge
    profile = np.exp(-(((away - 0.013) / _BERM) ** 2)) * np.clip((away + 0.006) / 0.006, 0.0, 1.0)
    ragged = np.clip(1.0 + 0.4 * crumbs.broad + 0.2 * crumbs.fine, 0.15, 2.2)
    thrown = np.exp(-np.clip(away - 0.012, 0.0, None) / 0.012) * (away > 0.012) * np.clip(crumbs.fine - 1.0, 0.0, 2.0)
    return np.asarray(np.minimum(crest * profile * ragged, 0.014) + 0.25 * crest * thrown, dtype=np.float32)
