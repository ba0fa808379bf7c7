"""Bodies, frames, wheels and couplings of a combination on matplotlib axes, from the side and from above.

The front is on the left. The horizontal axis is the distance behind the foremost point [m]. The vertical axis is the
height in the side view, and the distance to the right in the plan. As x and y of a unit are both reversed, a left turn
looks like a left turn.
Lengths, widths, heights, axles and hitches come from the file; the shapes of cabs and frames are sketched.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle

from scenarios.report.plots import GREY, INK, TRUE
from vehicle.combination.data_sheet import reach
from vehicle.combination.multibody import Vector
from vehicle.combination.unit import Axle, Unit
from vehicle.combination.wheel import wheel_plane

_BODY, _CAB, _FRAME = "#eef2f6", "#dbe5ef", "#aab4be"
_FLAT = 1.6  # a unit no higher than this has no body on its frame [m]: a dolly
_TOP_OF_FRAME, _DEPTH_OF_FRAME = (
    0.98,
    0.23,
)  # [m] of motor vehicles and dollies; a semi-trailer's frame lies on its hitch
_TYRE_WIDTH = 0.30  # [m] of every wheel in the plan view; not in the files
_LIFT = 0.15  # height of a raised axle above the ground [m]
_CAB_LENGTH, _CAB_HEIGHT, _GAP = 2.3, 3.1, 0.1  # [m] of a rigid truck; a tractor's cab is as high as its unit
_BONNETED = 3.6  # a cab with more room than this is drawn behind a bonnet [m]
_AHEAD = Vector(1.0, 0.0)


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


def wheel_from_side(ax: Axes, x: float, axle: Axle) -> None:
    """A wheel; blue if steered, with a dark hub if driven, grey and off the ground if lifted."""
    radius, z = axle.wheel_radius, axle.wheel_radius + (_LIFT if axle.lifted else 0.0)
    edge = TRUE if axle.steered else INK
    tyre = GREY if axle.lifted else edge
    for share, colour in ((1.0, tyre), (0.58, "white"), (0.25, INK if axle.driven else "white")):
        ax.add_patch(Circle((x, z), share * radius, facecolor=colour, edgecolor=tyre, zorder=4.0 - share))


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
    half, colour = 0.5 * axle.track, GREY if axle.lifted else INK
    ax.plot((x, x), (-half, half), color=colour, linewidth=2.4 if axle.driven else 1.2, zorder=2.5)
    lock = _left_lock(unit, axle) if axle.steered else 0.0
    for y in (half, -half):
        if axle.steered:
            _wheel_from_above(ax, (x, -y), _AHEAD, axle, ghost=True)
        _wheel_from_above(ax, (x, -y), wheel_plane(axle, y, lock), axle)


def _left_lock(unit: Unit, axle: Axle) -> float:
    """Angle [rad] of a steered axle's middle at the lock of a left turn: axles behind the turning point go right."""
    fixed = [other.x for other in unit.axles if not other.steered]
    centre = axle.ackermann_x if axle.ackermann_x is not None else sum(fixed) / len(fixed) if fixed else 0.0
    return math.copysign(reach(unit, axle), axle.x - centre)


def _wheel_from_above(ax: Axes, middle: tuple[float, float], plane: Vector, axle: Axle, *, ghost: bool = False) -> None:
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (axle.wheel_radius, 0.5 * _TYRE_WIDTH)
    filled = not (ghost or axle.lifted)
    colour = GREY if ghost or axle.lifted else TRUE if axle.steered else INK
    shape = Polygon(
        corners @ np.array([[plane.x, plane.y], [-plane.y, plane.x]]) + middle,
        facecolor=colour if filled else "none",
        edgecolor=colour,
        linewidth=0.8,
        linestyle="-" if filled else (0, (2, 1.5)),
        zorder=3.5 if filled else 3.0,
    )
    ax.add_patch(shape)
