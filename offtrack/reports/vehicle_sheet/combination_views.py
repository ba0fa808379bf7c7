"""Side view and plan of a combination to scale, with its loads and dimensions, on matplotlib axes.

The front is on the left. The horizontal axis is the distance behind the foremost point [m]. The vertical axis is the
height in the side view, and the distance to the right in the plan. As x and y of a unit are both reversed, a left turn
looks like a left turn.
Lengths, widths, heights, axles and hitches come from the file; the shapes of cabs and frames are sketched.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle

from offtrack.reports.plots import GREY, INK, TRUE
from offtrack.reports.vehicle_sheet import sheet
from vehicle.combination.chain_forces import wheel_plane
from vehicle.combination.data_sheet import AxleSheet, DataSheet, reach
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.unit import Axle, Unit

_BODY, _CAB, _FRAME = "#eef2f6", "#dbe5ef", "#aab4be"
_FLAT = 1.6  # a unit no higher than this has no body on its frame [m]: a dolly
# of motor vehicles and dollies [m]; a semi-trailer's frame lies on its hitch
_TOP_OF_FRAME, _DEPTH_OF_FRAME = 0.98, 0.23
_TYRE_WIDTH = 0.30  # [m] of every wheel in the plan view; not in the files
_LIFT = 0.15  # height of a raised axle above the ground [m]
_CAB_LENGTH, _CAB_HEIGHT, _GAP = 2.3, 3.1, 0.1  # [m] of a rigid truck; a tractor's cab is as high as its unit
_BONNETED = 3.6  # a cab with more room than this is drawn behind a bonnet [m]


def body_from_side(ax: Axes, unit: Unit, origin: float, ahead: Unit | None, behind: Unit | None) -> None:
    """Cab, box and frame of a unit whose origin lies ``origin`` [m] behind the foremost point."""
    if ahead is None:
        _motor_vehicle(ax, unit, origin, behind)
    elif unit.height < _FLAT:
        _frame(ax, origin, (unit.front_x, _end_of_frame(unit)))
        drawbar = (ahead.hitch_height or 0.0, _TOP_OF_FRAME - 0.5 * _DEPTH_OF_FRAME)
        ax.plot((origin, origin - unit.front_x), drawbar, color=INK, linewidth=2.0, zorder=2.1)
    else:
        sole = ahead.hitch_height or 0.0
        leads = _carries(behind)  # the trailer behind it, on a frame as low as a tractor's
        end = unit.rear_x if leads else _end_of_frame(unit)
        _box(ax, origin, (unit.front_x, end), (sole, sole + _DEPTH_OF_FRAME), _FRAME, zorder=2.2)
        _box(ax, origin, (unit.front_x, unit.rear_x), (sole + _DEPTH_OF_FRAME, unit.height), _BODY)
        if leads:
            _frame(ax, origin, (max(axle.x for axle in unit.axles) + 0.55, _end_of_frame(unit)))
    if _carries(behind):
        _fifth_wheel(ax, origin - (unit.hitch_x or 0.0), unit.hitch_height or 0.0)


def _motor_vehicle(ax: Axes, unit: Unit, origin: float, behind: Unit | None) -> None:
    _frame(ax, origin, (unit.front_x - 0.05, _end_of_frame(unit)))
    back = cab_back(unit, behind)
    carries_box = not _carries(behind)
    top = min(unit.height, _CAB_HEIGHT) if carries_box else unit.height
    length, nose = unit.front_x - back, origin - unit.front_x
    outline = [(0.0, 0.4), (0.0, 1.5), (0.13 * top, top - 0.45), (0.8, top), (length, top), (length, 0.4)]
    if length > _BONNETED:
        screen = max(length - 3.4, 1.2)  # seats and sleeper take the rest
        outline = [(0.0, 0.4), (0.0, 1.45), (0.25, 1.75), (screen, 2.05), (screen + 0.4, 2.9), (screen + 0.9, top)]
        outline += [(length, top), (length, 0.4)]
    points = [(nose + x, z) for x, z in outline]
    ax.add_patch(Polygon(points, facecolor=_CAB, edgecolor=INK, linewidth=1.0, joinstyle="round", zorder=2.4))
    if carries_box:
        _box(ax, origin, (back - _GAP, unit.rear_x), (_TOP_OF_FRAME, unit.height), _BODY)


def cab_back(unit: Unit, behind: Unit | None) -> float:
    """End of the cab, x in the unit's frame [m], clear of the unit that swings behind it."""
    if behind is None or not _carries(behind):
        return unit.front_x - _CAB_LENGTH
    clear = (unit.hitch_x or 0.0) + math.hypot(behind.front_x, 0.5 * behind.width) + _GAP
    room = unit.front_x - clear
    return clear if room > _BONNETED else max(clear, unit.front_x - _CAB_LENGTH)


def _carries(behind: Unit | None) -> bool:
    """True if the unit behind rests on the motor vehicle; false if it follows on a drawbar."""
    return behind is not None and behind.front_x > 0.0


def _frame(ax: Axes, origin: float, ends: tuple[float, float]) -> None:
    _box(ax, origin, ends, (_TOP_OF_FRAME - _DEPTH_OF_FRAME, _TOP_OF_FRAME), _FRAME, zorder=2.2)


def _end_of_frame(unit: Unit) -> float:
    """Rear end of a frame that carries body, axles and hitch, x in the unit's frame [m]."""
    last = min(axle.x for axle in (*unit.axles, *unit.lifted_axles))
    return min(unit.rear_x, last - 0.55, (unit.hitch_x or 0.0) - 0.1)


def _fifth_wheel(ax: Axes, x: float, height: float) -> None:
    plate = [(x - 0.5, height), (x + 0.5, height), (x + 0.3, _TOP_OF_FRAME), (x - 0.3, _TOP_OF_FRAME)]
    ax.add_patch(Polygon(plate, facecolor=INK, linewidth=0.0, zorder=2.1))


def _box(
    ax: Axes, origin: float, ends: tuple[float, float], heights: tuple[float, float], colour: str, zorder: float = 2.0
) -> None:
    """A rectangle from x to x [m] in the unit's frame and from height to height [m]."""
    corner, size = (origin - ends[0], heights[0]), (ends[0] - ends[1], heights[1] - heights[0])
    ax.add_patch(Rectangle(corner, *size, facecolor=colour, edgecolor=INK, linewidth=1.0, zorder=zorder))


def pivot(ax: Axes, x: float, y: float) -> None:
    """A hitch."""
    ax.plot(x, y, "o", color="white", markeredgecolor=INK, markersize=6.0, zorder=5.0)
    ax.plot(x, y, "o", color=INK, markersize=2.2, zorder=5.1)


def body_from_above(ax: Axes, unit: Unit, origin: float, ahead: Unit | None, behind: Unit | None) -> None:
    """Outline, frame and drawbar of a unit; dashed for a tractor, whose body is its cab."""
    cab_only = ahead is None and _carries(behind)
    _plan(ax, unit, origin, unit.rear_x, "none" if cab_only else _BODY, dashed=cab_only)
    if ahead is None:
        _plan(ax, unit, origin, cab_back(unit, behind), _CAB)
    ends = [axle.x for axle in (*unit.axles, *unit.lifted_axles)]
    front, rear = max(unit.front_x - 0.3, *ends), min(unit.rear_x + 0.1, *ends)
    start = 0.0 if unit.front_x < 0.0 else front
    for side in (-0.4, 0.4):
        line = [(start, 0.0), (front, side), (rear, side)]
        ax.plot([origin - x for x, _ in line], [y for _, y in line], color=GREY, linewidth=0.8, zorder=2.3)


def _plan(ax: Axes, unit: Unit, origin: float, rear: float, colour: str, *, dashed: bool = False) -> None:
    corner, size = (origin - unit.front_x, -0.5 * unit.width), (unit.front_x - rear, unit.width)
    style = "--" if dashed else "-"
    ax.add_patch(
        Rectangle(corner, *size, facecolor=colour, edgecolor=INK, linewidth=0.9, linestyle=style, alpha=0.6, zorder=2.0)
    )


def axle_from_above(ax: Axes, unit: Unit, x: float, axle: Axle) -> None:
    """An axle with its wheels; steered wheels at the lock of a left turn, and dashed straight ahead."""
    half = 0.5 * axle.track
    shaft = GREY if axle.lifted else INK
    ax.plot((x, x), (-half, half), color=shaft, linewidth=2.4 if axle.driven else 1.2, zorder=2.5)
    lock = _left_lock(unit, axle) if axle.steered else 0.0
    size = 2.0 * axle.wheel_radius, _TYRE_WIDTH
    colour = GREY if axle.lifted else TRUE if axle.steered else INK
    for y in (half, -half):
        if axle.steered:
            sheet.wheel_from_above(ax, (x, -y), size, (1.0, 0.0), GREY, filled=False)
        plane = wheel_plane(axle, y, lock)
        sheet.wheel_from_above(ax, (x, -y), size, (float(plane.x), float(plane.y)), colour, filled=not axle.lifted)


def _left_lock(unit: Unit, axle: Axle) -> float:
    """Angle [rad] of a steered axle's middle at the lock of a left turn: axles behind the turning point go right."""
    fixed = [other.x for other in unit.axles if not other.steered]
    centre = axle.ackermann_x if axle.ackermann_x is not None else sum(fixed) / len(fixed) if fixed else 0.0
    return math.copysign(reach(unit, axle), axle.x - centre)


_GROUP_SPACING: Final = 2.0  # axles closer than this form a group [m], about as in 96/53/EC
# Depths of the rows of lettering below the ground line [in]; the longest arrow ends at the first.
_ARROW, _LOAD, _GROUP, _AXLES, _HITCHES, _LENGTH = 0.48, 0.51, 0.74, 1.14, 1.40, 1.66
BELOW_GROUND: Final = 1.8  # depth of all of them [in]


@dataclass(frozen=True, slots=True)
class CombinationDrawing:
    """A combination, its data sheet, and the scale at which it is drawn."""

    vehicle: Vehicle
    data: DataSheet
    scale: sheet.Scale

    def units(self) -> Iterator[tuple[Unit, float, Unit | None, Unit | None]]:
        """Every unit, its origin's distance behind the foremost point [m], the unit ahead and the unit behind."""
        units, front = self.vehicle.units, self.vehicle.units[0].front_x
        for i, (unit, origin) in enumerate(zip(units, self.vehicle.origins, strict=True)):
            yield unit, front - origin, units[i - 1] if i else None, units[i + 1] if i + 1 < len(units) else None


def side_view(ax: Axes, drawing: CombinationDrawing) -> None:
    """Draw bodies, wheels, centres of gravity, axle and coupling loads, and chains of dimensions."""
    beyond = drawing.scale.metres(0.5)
    ax.plot((-beyond, drawing.data.length + beyond), (0.0, 0.0), color=INK, linewidth=1.0, zorder=1.0)
    top = drawing.data.height + drawing.scale.metres(0.1)
    for unit, origin, ahead, behind in drawing.units():
        body_from_side(ax, unit, origin, ahead, behind)
        for axle in (*unit.axles, *unit.lifted_axles):
            hub = origin - axle.x, axle.wheel_radius + (_LIFT if axle.lifted else 0.0)
            colour = GREY if axle.lifted else TRUE if axle.steered else INK
            sheet.wheel_from_side(ax, hub, axle.wheel_radius, colour, 0.58, driven=axle.driven)
        sheet.centre_of_gravity(ax, origin - unit.cg_x, unit.cg_height, 0.16)
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
    sheet.vertical_dimension(ax, drawing.scale, drawing.data.length + drawing.scale.metres(0.3), -half, half)


def _couplings(ax: Axes, drawing: CombinationDrawing) -> None:
    """Hitches with the load that each puts on the unit ahead."""
    arrow = {"arrowstyle": "-|>", "color": sheet.LOAD, "linewidth": 1.2, "shrinkA": 0.0, "shrinkB": 3.5}
    for (_, origin, ahead, _), data in zip(drawing.units(), drawing.data.units, strict=True):
        if ahead is None or data.coupling_load is None:
            continue
        z = ahead.hitch_height or 0.0
        start = z + drawing.scale.metres(0.42)
        pivot(ax, origin, z)
        ax.annotate("", (origin, z), (origin, start), arrowprops=arrow, zorder=5.2)
        sheet.load_text(ax, origin, start + drawing.scale.metres(0.03), _tonnes(data.coupling_load), va="bottom")


def _axle_loads(ax: Axes, drawing: CombinationDrawing) -> None:
    """Loads of axles and groups of axles, as arrows under the ground."""
    largest = max(axle.load for unit in drawing.data.units for axle in unit.axles)
    row = -drawing.scale.metres(_LOAD)
    for unit in drawing.data.units:
        for axle in unit.axles:
            text = "lifted" if axle.lifted else f"{axle.load / GRAVITY / 1e3:.2f}"
            sheet.load_arrow(ax, axle.behind_front, drawing.scale.metres(_ARROW) * axle.load / largest, row, text)
        for group in _groups([axle for axle in unit.axles if not axle.lifted]):
            _bracket(ax, drawing, group)
    sheet.load_text(ax, -drawing.scale.metres(0.12), row, "load [t]", ha="right")


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
    ax.plot((first, first, last, last), (z + tick, z, z, z + tick), color=sheet.LOAD, linewidth=0.9)
    sheet.load_text(ax, 0.5 * (first + last), z - tick, _tonnes(sum(axle.load for axle in group)))


def _tonnes(load: float) -> str:
    return f"{load / GRAVITY / 1e3:.2f} t"


def _dimensions(ax: Axes, drawing: CombinationDrawing) -> None:
    """Chains of dimensions: axles, hitches, overall length; and the height."""
    length = drawing.data.length

    def below(row: float) -> float:
        return -drawing.scale.metres(row)

    axles = [axle.behind_front for unit in drawing.data.units for axle in unit.axles]
    hitches = [unit.behind_front for unit in drawing.data.units[1:]]
    sheet.horizontal_dimension(ax, drawing.scale, below(_AXLES), [0.0, *sorted(axles), length])
    if hitches:
        sheet.horizontal_dimension(ax, drawing.scale, below(_HITCHES), [0.0, *hitches, length])
    sheet.horizontal_dimension(ax, drawing.scale, below(_LENGTH if hitches else _HITCHES), [0.0, length])
    sheet.vertical_dimension(ax, drawing.scale, length + drawing.scale.metres(0.3), 0.0, drawing.data.height)
