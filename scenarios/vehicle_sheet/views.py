"""Side view and plan of a combination to scale, with its loads and dimensions, on matplotlib axes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from matplotlib.axes import Axes

from scenarios.report.drawing import INK, TRUE
from scenarios.vehicle_sheet.outlines import (
    axle_from_above,
    body_from_above,
    body_from_side,
    centre_of_gravity,
    pivot,
    wheel_from_side,
)
from vehicle.combination.data_sheet import AxleSheet, DataSheet, origins
from vehicle.combination.description import GRAVITY, Unit, Vehicle

LOAD, DIMENSION = "#b3261e", "#5b6673"
_GROUP_SPACING: Final = 2.0  # axles closer than this are summed up as a group [m], about where 96/53/EC ends
# How far below the ground line the rows of lettering lie [in]; the longest arrow is as long as its row.
_ARROW, _LOAD, _GROUP, _AXLES, _HITCHES, _LENGTH = 0.48, 0.51, 0.74, 1.14, 1.40, 1.66
BELOW_GROUND: Final = 1.8  # room that they take [in]


@dataclass(frozen=True, slots=True)
class Sheet:
    """A combination and how large it is drawn."""

    vehicle: Vehicle
    facts: DataSheet
    scale: float  # [in/m]

    def metres(self, inches: float) -> float:
        """A length on paper as one of the vehicle's."""
        return inches / self.scale

    def units(self) -> Iterator[tuple[Unit, float, Unit | None, Unit | None]]:
        """Every unit, how far its origin lies behind the foremost point [m], the unit ahead and the one behind."""
        units, front = self.vehicle.units, self.vehicle.units[0].front_x
        for i, (unit, origin) in enumerate(zip(units, origins(self.vehicle), strict=True)):
            yield unit, front - origin, units[i - 1] if i else None, units[i + 1] if i + 1 < len(units) else None


def side_view(ax: Axes, sheet: Sheet) -> None:
    """Bodies, wheels, centres of gravity, axle and coupling loads, and the chains of dimensions."""
    beyond = sheet.metres(0.5)
    ax.plot((-beyond, sheet.facts.length + beyond), (0.0, 0.0), color=INK, linewidth=1.0, zorder=1.0)
    top = sheet.facts.height + sheet.metres(0.1)
    for unit, origin, ahead, behind in sheet.units():
        body_from_side(ax, unit, origin, ahead, behind)
        for axle in (*unit.axles, *unit.lifted_axles):
            wheel_from_side(ax, origin - axle.x, axle)
        centre_of_gravity(ax, origin - unit.cg_x, unit.cg_height)
        middle = origin - 0.5 * (unit.front_x + unit.rear_x)
        ax.text(middle, top, f"{unit.name}, {unit.mass / 1e3:.2f} t", ha="center", va="bottom", fontsize=9.0, color=INK)
    _couplings(ax, sheet)
    _axle_loads(ax, sheet)
    _dimensions(ax, sheet)


def plan_view(ax: Axes, sheet: Sheet) -> None:
    """Outlines and wheels from above, the steered axles at the lock of a left turn."""
    for (unit, origin, ahead, behind), facts in zip(sheet.units(), sheet.facts.units, strict=True):
        body_from_above(ax, unit, origin, ahead, behind)
        for axle in (*unit.axles, *unit.lifted_axles):
            axle_from_above(ax, unit, origin - axle.x, axle)
        if behind is not None:
            pivot(ax, origin - (unit.hitch_x or 0.0), 0.0)
        for one in facts.axles:
            if one.reach is not None:
                at, text = 0.5 * unit.width + sheet.metres(0.1), f"±{math.degrees(one.reach):.0f}°"
                ax.text(one.behind_front, at, text, ha="center", va="bottom", fontsize=8.0, color=TRUE)
    half = 0.5 * sheet.facts.width
    _vertical_dimension(ax, sheet, sheet.facts.length + sheet.metres(0.3), -half, half)


def _couplings(ax: Axes, sheet: Sheet) -> None:
    """Hitches with the load that each puts on the unit ahead."""
    arrow = {"arrowstyle": "-|>", "color": LOAD, "linewidth": 1.2, "shrinkA": 0.0, "shrinkB": 3.5}
    for (_, origin, ahead, _), facts in zip(sheet.units(), sheet.facts.units, strict=True):
        if ahead is None or facts.coupling_load is None:
            continue
        z = ahead.hitch_height or 0.0
        start = z + sheet.metres(0.42)
        pivot(ax, origin, z)
        ax.annotate("", (origin, z), (origin, start), arrowprops=arrow, zorder=5.2)
        text = _tonnes(facts.coupling_load)
        ax.text(origin, start + sheet.metres(0.03), text, ha="center", va="bottom", fontsize=8.0, color=LOAD)


def _axle_loads(ax: Axes, sheet: Sheet) -> None:
    """What each axle and each group of axles carries, as arrows under the ground."""
    largest = max(axle.load for unit in sheet.facts.units for axle in unit.axles)
    row = -sheet.metres(_LOAD)
    arrow = {"arrowstyle": "-|>", "color": LOAD, "linewidth": 1.6, "shrinkA": 0.0, "shrinkB": 0.0}
    for unit in sheet.facts.units:
        for axle in unit.axles:
            if axle.load > 0.0:
                length = sheet.metres(_ARROW) * axle.load / largest
                ax.annotate("", (axle.behind_front, 0.0), (axle.behind_front, -length), arrowprops=arrow)
            text = "lifted" if axle.lifted else f"{axle.load / GRAVITY / 1e3:.2f}"
            ax.text(axle.behind_front, row, text, ha="center", va="top", fontsize=8.0, color=LOAD)
        for group in _groups([axle for axle in unit.axles if not axle.lifted]):
            _bracket(ax, sheet, group)
    ax.text(-sheet.metres(0.12), row, "load [t]", ha="right", va="top", fontsize=8.0, color=LOAD)


def _groups(axles: Sequence[AxleSheet]) -> list[list[AxleSheet]]:
    """Axles that follow each other closely, in groups of two or more."""
    groups: list[list[AxleSheet]] = []
    for axle in axles:
        if groups and axle.behind_front - groups[-1][-1].behind_front < _GROUP_SPACING:
            groups[-1].append(axle)
        else:
            groups.append([axle])
    return [group for group in groups if len(group) > 1]


def _bracket(ax: Axes, sheet: Sheet, group: Sequence[AxleSheet]) -> None:
    first, last, z = group[0].behind_front, group[-1].behind_front, -sheet.metres(_GROUP)
    tick = sheet.metres(0.05)
    ax.plot((first, first, last, last), (z + tick, z, z, z + tick), color=LOAD, linewidth=0.9)
    total = _tonnes(sum(axle.load for axle in group))
    ax.text(0.5 * (first + last), z - tick, total, ha="center", va="top", fontsize=8.0, color=LOAD)


def _tonnes(load: float) -> str:
    return f"{load / GRAVITY / 1e3:.2f} t"


def _dimensions(ax: Axes, sheet: Sheet) -> None:
    """Chains of dimensions: axles, hitches, overall length; and the height."""
    length = sheet.facts.length
    axles = [axle.behind_front for unit in sheet.facts.units for axle in unit.axles]
    hitches = [unit.behind_front for unit in sheet.facts.units[1:]]
    _chain(ax, sheet, _AXLES, [0.0, *sorted(axles), length])
    if hitches:
        _chain(ax, sheet, _HITCHES, [0.0, *hitches, length])
    _chain(ax, sheet, _LENGTH if hitches else _HITCHES, [0.0, length])
    _vertical_dimension(ax, sheet, length + sheet.metres(0.3), 0.0, sheet.facts.height)


def _chain(ax: Axes, sheet: Sheet, row: float, stations: Sequence[float]) -> None:
    z, tick = -sheet.metres(row), sheet.metres(0.04)
    ax.plot((stations[0], stations[-1]), (z, z), color=DIMENSION, linewidth=0.7)
    for x in stations:
        _tick(ax, x, z, tick)
    for start, stop in pairwise(stations):
        middle, text = 0.5 * (start + stop), f"{stop - start:.2f}"
        ax.text(middle, z + 0.3 * tick, text, ha="center", va="bottom", fontsize=7.5, color=DIMENSION)


def _vertical_dimension(ax: Axes, sheet: Sheet, x: float, low: float, high: float) -> None:
    tick = sheet.metres(0.04)
    ax.plot((x, x), (low, high), color=DIMENSION, linewidth=0.7)
    for z in (low, high):
        _tick(ax, x, z, tick)
    middle, text = 0.5 * (low + high), f"{high - low:.2f}"
    ax.text(x + tick, middle, text, ha="left", va="center", rotation=90.0, fontsize=7.5, color=DIMENSION)


def _tick(ax: Axes, x: float, z: float, size: float) -> None:
    """The slanted stroke that ends a dimension."""
    ax.plot((x - size, x + size), (z - size, z + size), color=DIMENSION, linewidth=1.2)
