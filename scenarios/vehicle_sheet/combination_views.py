"""Side view and plan of a combination to scale, with its loads and dimensions, on matplotlib axes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from matplotlib.axes import Axes

from scenarios.report.plots import INK, TRUE
from scenarios.vehicle_sheet.combination_outlines import (
    axle_from_above,
    body_from_above,
    body_from_side,
    pivot,
    wheel_from_side,
)
from scenarios.vehicle_sheet.paper import (
    LOAD,
    Scale,
    centre_of_gravity,
    horizontal_dimension,
    vertical_dimension,
)
from vehicle.combination.data_sheet import AxleSheet, DataSheet, origins
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.unit import Unit

_GROUP_SPACING: Final = 2.0  # axles closer than this form a group [m], about as in 96/53/EC
# Depths of the rows of lettering below the ground line [in]; the longest arrow ends at the first.
_ARROW, _LOAD, _GROUP, _AXLES, _HITCHES, _LENGTH = 0.48, 0.51, 0.74, 1.14, 1.40, 1.66
BELOW_GROUND: Final = 1.8  # depth of all of them [in]


@dataclass(frozen=True, slots=True)
class CombinationDrawing:
    """A combination, its data sheet, and the scale at which it is drawn."""

    vehicle: Vehicle
    data: DataSheet
    scale: Scale

    def units(self) -> Iterator[tuple[Unit, float, Unit | None, Unit | None]]:
        """Every unit, its origin's distance behind the foremost point [m], the unit ahead and the unit behind."""
        units, front = self.vehicle.units, self.vehicle.units[0].front_x
        for i, (unit, origin) in enumerate(zip(units, origins(self.vehicle), strict=True)):
            yield unit, front - origin, units[i - 1] if i else None, units[i + 1] if i + 1 < len(units) else None


def side_view(ax: Axes, drawing: CombinationDrawing) -> None:
    """Draw bodies, wheels, centres of gravity, axle and coupling loads, and chains of dimensions."""
    beyond = drawing.scale.metres(0.5)
    ax.plot((-beyond, drawing.data.length + beyond), (0.0, 0.0), color=INK, linewidth=1.0, zorder=1.0)
    top = drawing.data.height + drawing.scale.metres(0.1)
    for unit, origin, ahead, behind in drawing.units():
        body_from_side(ax, unit, origin, ahead, behind)
        for axle in (*unit.axles, *unit.lifted_axles):
            wheel_from_side(ax, origin - axle.x, axle)
        centre_of_gravity(ax, origin - unit.cg_x, unit.cg_height, 0.16)
        middle = origin - 0.5 * (unit.front_x + unit.rear_x)
        ax.text(middle, top, f"{unit.name}, {unit.mass / 1e3:.2f} t", ha="center", va="bottom", fontsize=9.0, color=INK)
    _couplings(ax, drawing)
    _axle_loads(ax, drawing)
    _dimensions(ax, drawing)


def plan_view(ax: Axes, drawing: CombinationDrawing) -> None:
    """Draw outlines and wheels from above, the steered axles at the lock of a left turn."""
    for (unit, origin, ahead, behind), data in zip(drawing.units(), drawing.data.units, strict=True):
        body_from_above(ax, unit, origin, ahead, behind)
        for axle in (*unit.axles, *unit.lifted_axles):
            axle_from_above(ax, unit, origin - axle.x, axle)
        if behind is not None:
            pivot(ax, origin - (unit.hitch_x or 0.0), 0.0)
        for one in data.axles:
            if one.reach is not None:
                at, text = 0.5 * unit.width + drawing.scale.metres(0.1), f"±{math.degrees(one.reach):.0f}°"
                ax.text(one.behind_front, at, text, ha="center", va="bottom", fontsize=8.0, color=TRUE)
    half = 0.5 * drawing.data.width
    vertical_dimension(ax, drawing.scale, drawing.data.length + drawing.scale.metres(0.3), -half, half)


def _couplings(ax: Axes, drawing: CombinationDrawing) -> None:
    """Hitches with the load that each puts on the unit ahead."""
    arrow = {"arrowstyle": "-|>", "color": LOAD, "linewidth": 1.2, "shrinkA": 0.0, "shrinkB": 3.5}
    for (_, origin, ahead, _), data in zip(drawing.units(), drawing.data.units, strict=True):
        if ahead is None or data.coupling_load is None:
            continue
        z = ahead.hitch_height or 0.0
        start = z + drawing.scale.metres(0.42)
        pivot(ax, origin, z)
        ax.annotate("", (origin, z), (origin, start), arrowprops=arrow, zorder=5.2)
        text = _tonnes(data.coupling_load)
        ax.text(origin, start + drawing.scale.metres(0.03), text, ha="center", va="bottom", fontsize=8.0, color=LOAD)


def _axle_loads(ax: Axes, drawing: CombinationDrawing) -> None:
    """Loads of axles and groups of axles, as arrows under the ground."""
    largest = max(axle.load for unit in drawing.data.units for axle in unit.axles)
    row = -drawing.scale.metres(_LOAD)
    arrow = {"arrowstyle": "-|>", "color": LOAD, "linewidth": 1.6, "shrinkA": 0.0, "shrinkB": 0.0}
    for unit in drawing.data.units:
        for axle in unit.axles:
            if axle.load > 0.0:
                length = drawing.scale.metres(_ARROW) * axle.load / largest
                ax.annotate("", (axle.behind_front, 0.0), (axle.behind_front, -length), arrowprops=arrow)
            text = "lifted" if axle.lifted else f"{axle.load / GRAVITY / 1e3:.2f}"
            ax.text(axle.behind_front, row, text, ha="center", va="top", fontsize=8.0, color=LOAD)
        for group in _groups([axle for axle in unit.axles if not axle.lifted]):
            _bracket(ax, drawing, group)
    ax.text(-drawing.scale.metres(0.12), row, "load [t]", ha="right", va="top", fontsize=8.0, color=LOAD)


def _groups(axles: Sequence[AxleSheet]) -> list[list[AxleSheet]]:
    """Groups of two or more axles that follow each other closely."""
    groups: list[list[AxleSheet]] = []
    for axle in axles:
        if groups and axle.behind_front - groups[-1][-1].behind_front < _GROUP_SPACING:
            groups[-1].append(axle)
        else:
            groups.append([axle])
    return [group for group in groups if len(group) > 1]


def _bracket(ax: Axes, drawing: CombinationDrawing, group: Sequence[AxleSheet]) -> None:
    first, last, z = group[0].behind_front, group[-1].behind_front, -drawing.scale.metres(_GROUP)
    tick = drawing.scale.metres(0.05)
    ax.plot((first, first, last, last), (z + tick, z, z, z + tick), color=LOAD, linewidth=0.9)
    total = _tonnes(sum(axle.load for axle in group))
    ax.text(0.5 * (first + last), z - tick, total, ha="center", va="top", fontsize=8.0, color=LOAD)


def _tonnes(load: float) -> str:
    return f"{load / GRAVITY / 1e3:.2f} t"


def _dimensions(ax: Axes, drawing: CombinationDrawing) -> None:
    """Chains of dimensions: axles, hitches, overall length; and the height."""
    length = drawing.data.length

    def below(row: float) -> float:
        return -drawing.scale.metres(row)

    axles = [axle.behind_front for unit in drawing.data.units for axle in unit.axles]
    hitches = [unit.behind_front for unit in drawing.data.units[1:]]
    horizontal_dimension(ax, drawing.scale, below(_AXLES), [0.0, *sorted(axles), length])
    if hitches:
        horizontal_dimension(ax, drawing.scale, below(_HITCHES), [0.0, *hitches, length])
    horizontal_dimension(ax, drawing.scale, below(_LENGTH if hitches else _HITCHES), [0.0, length])
    vertical_dimension(ax, drawing.scale, length + drawing.scale.metres(0.3), 0.0, drawing.data.height)
