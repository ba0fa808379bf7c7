"""Side view and plan of a rover to scale, with its wheel loads and dimensions, on matplotlib axes.

The front is on the left and the origin is the body centre R on the ground: the horizontal axis is -x of R. The vertical
axis is the height in the side view and -y of R in the plan.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle

from scenarios.report.plots import GREY, INK, TRUE
from scenarios.vehicle_sheet.paper import (
    LOAD,
    Scale,
    centre_of_gravity,
    horizontal_dimension,
    vertical_dimension,
)
from vehicle.rover.data_sheet import RoverSheet
from vehicle.rover.description import Rover

BELOW_GROUND: Final = 1.15  # depth of the lettering below the ground line, and below the wheels in the plan [in]
_ARROW, _LOAD_TEXT, _AXLES, _LENGTH = 0.30, 0.32, 0.62, 0.84  # depths below the ground line [in]
_BODY, _ROCKER = "#eef2f6", "#aab4be"
_BODY_HEIGHT: Final = 0.5  # of the sketched body, over the height of its floor
_ON_PLAN: Final = 0.45  # half length of the sketched body, over the wheelbase


def height_above_ground(data: RoverSheet) -> float:
    """Height of the drawn rover [m]."""
    return (1.0 + _BODY_HEIGHT) * _floor(data)


def _floor(data: RoverSheet) -> float:
    """Height of the sketched body's floor [m]: above the wheels, at least at the centre of gravity."""
    return max(1.9 * data.rover.radius, 0.9 * data.rover.cg_height)


def side_view(ax: Axes, scale: Scale, data: RoverSheet) -> None:
    """Draw body, rockers, left wheels, centre of gravity, loads of the axles, and dimensions."""
    rover, floor, half = data.rover, _floor(data), 0.5 * data.length
    ax.plot((-half - scale.metres(0.3), half + scale.metres(0.3)), (0.0, 0.0), color=INK, linewidth=1.0, zorder=1.0)
    wheels = sorted((wheel for wheel in rover.wheels if wheel.y > 0.0), key=lambda wheel: -wheel.x)
    stations = [-wheel.x for wheel in wheels]
    reach = _ON_PLAN * rover.wheelbase
    box = Rectangle((-reach, floor), 2.0 * reach, _BODY_HEIGHT * floor, facecolor=_BODY, edgecolor=INK, zorder=2.4)
    ax.add_patch(box)
    for wheel in wheels:
        x = -wheel.x
        ax.plot((0.0, x), (floor, rover.radius), color=_ROCKER, linewidth=5.0, solid_capstyle="round", zorder=2.0)
        edge = TRUE if wheel.steered else INK
        for share, colour in ((1.0, edge), (0.86, "white"), (0.2, INK if wheel.driven else "white")):
            disc = Circle((x, rover.radius), share * rover.radius, facecolor=colour, edgecolor=edge, zorder=4.0 - share)
            ax.add_patch(disc)
        _axle_load(ax, scale, data, x)
    ax.text(-half - scale.metres(0.1), -scale.metres(_LOAD_TEXT), "[N]", ha="right", va="top", fontsize=8.0, color=LOAD)
    centre_of_gravity(ax, -rover.cg_x, rover.cg_height, scale.metres(0.1))
    horizontal_dimension(ax, scale, -scale.metres(_AXLES), [-half, *stations, half])
    horizontal_dimension(ax, scale, -scale.metres(_LENGTH), [-half, half])
    vertical_dimension(ax, scale, half + scale.metres(0.25), 0.0, rover.cg_height)


def _axle_load(ax: Axes, scale: Scale, data: RoverSheet, x: float) -> None:
    """Load of both wheels of an axle on level ground."""
    carried: dict[float, float] = defaultdict(float)
    for wheel, load in zip(data.rover.wheels, data.loads, strict=True):
        carried[-wheel.x] += load
    load = carried[x]
    arrow = {"arrowstyle": "-|>", "color": LOAD, "linewidth": 1.6, "shrinkA": 0.0, "shrinkB": 0.0}
    length = scale.metres(_ARROW) * load / max(carried.values())
    ax.annotate("", (x, 0.0), (x, -length), arrowprops=arrow)
    ax.text(x, -scale.metres(_LOAD_TEXT), f"{load:.0f}", ha="center", va="top", fontsize=8.0, color=LOAD)


def plan_view(ax: Axes, scale: Scale, data: RoverSheet) -> None:
    """Draw body and wheels from above, steered wheels also at the angles of a turn on the spot, and dimensions."""
    rover = data.rover
    reach, half_width = _ON_PLAN * rover.wheelbase, 0.5 * rover.tread - rover.width
    body = Rectangle((-reach, -half_width), 2.0 * reach, 2.0 * half_width, facecolor=_BODY, edgecolor=INK, alpha=0.6)
    ax.add_patch(body)
    for wheel in rover.wheels:
        x, y = wheel.x, wheel.y
        ax.plot((-x, -x), (0.0, -y), color=_ROCKER, linewidth=2.0, zorder=1.5)
        if wheel.steered:
            angle = math.copysign(min(math.atan2(abs(x), abs(y)), rover.steer_limit), -x * y)
            _wheel_from_above(ax, rover, (-x, -y), angle, GREY, ghost=True)
        _wheel_from_above(ax, rover, (-x, -y), 0.0, TRUE if wheel.steered else INK)
    centre_of_gravity(ax, -rover.cg_x, 0.0, scale.metres(0.1))
    half = 0.5 * data.length + scale.metres(0.25)
    vertical_dimension(ax, scale, half, -0.5 * rover.tread, 0.5 * rover.tread)
    vertical_dimension(ax, scale, half + scale.metres(0.3), -0.5 * data.width, 0.5 * data.width)


def _wheel_from_above(
    ax: Axes, rover: Rover, middle: tuple[float, float], angle: float, colour: str, *, ghost: bool = False
) -> None:
    """A wheel at an angle [rad]; a ghost is dashed."""
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (rover.radius, 0.5 * rover.width)
    c, s = math.cos(angle), math.sin(angle)
    shape = Polygon(
        corners @ np.array([[c, s], [-s, c]]) + middle,
        facecolor="none" if ghost else colour,
        edgecolor=colour,
        linewidth=0.8,
        linestyle=(0, (2, 1.5)) if ghost else "-",
        zorder=3.6 if ghost else 3.0,
    )
    ax.add_patch(shape)
