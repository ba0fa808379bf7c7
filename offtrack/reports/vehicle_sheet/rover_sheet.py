"""Data sheet of a rover: wheel loads, tipping, speeds, traction in each soil, and side view and plan to scale.

The front is on the left and the origin is the body centre R on the ground: the horizontal axis is -x of R. The vertical
axis is the height in the side view and -y of R in the plan.
"""

import math
from collections import defaultdict
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from offtrack.reports.plots import GREY, INK, TRUE
from offtrack.reports.vehicle_sheet import sheet
from vehicle.rover import data_sheet
from vehicle.rover.data_sheet import STANDARD_SLIP, RoverSheet, Traction
from vehicle.rover.description import load_rover, load_soil, rover_sources, soil_names

BELOW_GROUND: Final = 1.15  # depth of the lettering below the ground line, and below the wheels in the plan [in]
_ARROW, _LOAD_TEXT, _AXLES, _LENGTH = 0.30, 0.32, 0.62, 0.84  # depths below the ground line [in]
_BODY, _ROCKER = "#eef2f6", "#aab4be"
_BODY_HEIGHT: Final = 0.5  # of the sketched body, over the height of its floor
_ON_PLAN: Final = 0.45  # half length of the sketched body, over the wheelbase


def _floor(data: RoverSheet) -> float:
    """Height of the sketched body's floor [m]: above the wheels, at least at the centre of gravity."""
    return max(1.9 * data.rover.radius, 0.9 * data.rover.cg_height)


def side_view(ax: Axes, scale: sheet.Scale, data: RoverSheet) -> None:
    """Draw body, rockers, left wheels, centre of gravity, loads of the axles, and dimensions."""
    rover, floor, half = data.rover, _floor(data), 0.5 * data.length
    ax.plot((-half - scale.metres(0.3), half + scale.metres(0.3)), (0.0, 0.0), color=INK, linewidth=1.0, zorder=1.0)
    wheels = sorted((wheel for wheel in rover.wheels if wheel.y > 0.0), key=lambda wheel: -wheel.x)
    stations = [-wheel.x for wheel in wheels]
    carried: dict[float, float] = defaultdict(float)  # by both wheels of an axle on level ground
    for wheel, load in zip(rover.wheels, data.loads, strict=True):
        carried[-wheel.x] += load
    reach = _ON_PLAN * rover.wheelbase
    box = Rectangle((-reach, floor), 2.0 * reach, _BODY_HEIGHT * floor, facecolor=_BODY, edgecolor=INK, zorder=2.4)
    ax.add_patch(box)
    for wheel in wheels:
        x = -wheel.x
        ax.plot((0.0, x), (floor, rover.radius), color=_ROCKER, linewidth=5.0, solid_capstyle="round", zorder=2.0)
        colour = TRUE if wheel.steered else INK
        sheet.wheel_from_side(ax, (x, rover.radius), rover.radius, colour, 0.86, driven=wheel.driven)
        length = scale.metres(_ARROW) * carried[x] / max(carried.values())
        sheet.load_arrow(ax, x, length, -scale.metres(_LOAD_TEXT), f"{carried[x]:.0f}")
    sheet.load_text(ax, -half - scale.metres(0.1), -scale.metres(_LOAD_TEXT), "[N]", ha="right")
    sheet.centre_of_gravity(ax, -rover.cg_x, rover.cg_height, scale.metres(0.1))
    sheet.horizontal_dimension(ax, scale, -scale.metres(_AXLES), [-half, *stations, half])
    sheet.horizontal_dimension(ax, scale, -scale.metres(_LENGTH), [-half, half])
    sheet.vertical_dimension(ax, scale, half + scale.metres(0.25), 0.0, rover.cg_height)


def plan_view(ax: Axes, scale: sheet.Scale, data: RoverSheet) -> None:
    """Draw body and wheels from above, steered wheels also at the angles of a turn on the spot, and dimensions."""
    rover = data.rover
    reach, half_width = _ON_PLAN * rover.wheelbase, 0.5 * rover.tread - rover.width
    body = Rectangle((-reach, -half_width), 2.0 * reach, 2.0 * half_width, facecolor=_BODY, edgecolor=INK, alpha=0.6)
    ax.add_patch(body)
    size = 2.0 * rover.radius, rover.width
    for wheel in rover.wheels:
        x, y = wheel.x, wheel.y
        ax.plot((-x, -x), (0.0, -y), color=_ROCKER, linewidth=2.0, zorder=1.5)
        if wheel.steered:
            angle = math.copysign(min(math.atan2(abs(x), abs(y)), rover.steer_limit), -x * y)
            sheet.wheel_from_above(ax, (-x, -y), size, (math.cos(angle), math.sin(angle)), GREY, filled=False)
        sheet.wheel_from_above(ax, (-x, -y), size, (1.0, 0.0), TRUE if wheel.steered else INK)
    sheet.centre_of_gravity(ax, -rover.cg_x, 0.0, scale.metres(0.1))
    half = 0.5 * data.length + scale.metres(0.25)
    sheet.vertical_dimension(ax, scale, half, -0.5 * rover.tread, 0.5 * rover.tread)
    sheet.vertical_dimension(ax, scale, half + scale.metres(0.3), -0.5 * data.width, 0.5 * data.width)


_VIEW: Final = 5.2  # largest width of each of the two views [in]
_KEY: Final = "lengths in m   wheels, axles and centre of gravity to scale   body and rockers sketched   steered: blue"


def rover_sheet(name_or_path: str) -> sheet.VehicleSheet:
    """Data sheet of a shipped rover, or of one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit.
    """
    rover = load_rover(name_or_path)
    data = data_sheet.rover_sheet(rover, [load_soil(name) for name in soil_names()])
    note, sources = sheet.sources_note(rover_sources(name_or_path))
    tables = (_wheel_table(data), _motion_table(data), _soil_table(data))
    return sheet.VehicleSheet(
        name=rover.name,
        summary=rover.summary,
        size=f"{rover.mass:.1f} kg, {data.length:.2f} x {data.width:.2f} m over its {len(rover.wheels)} wheels",
        tables=tables,
        warnings=_warnings(data),
        note=note,
        numbers=_numbers(data) | {"warnings": list(_warnings(data)), "sources": sources},
        draw=lambda: _draw(data, tables, note),
    )


def _draw(data: RoverSheet, tables: tuple[sheet.SheetTable, ...], note: str) -> Figure:
    """Sheet with side view and plan next to each other, and tables."""
    scale = sheet.Scale(_VIEW / data.length)
    text = sheet.height_of(tables)
    height = (1.0 + _BODY_HEIGHT) * _floor(data)
    views = max(height, data.width + data.rover.radius) * scale.inches + BELOW_GROUND
    rover = data.rover
    figure = sheet.new_sheet(sheet.TITLE + views + text, name=rover.name, summary=rover.summary, key=_KEY, note=note)
    middle = sheet.MARGIN + 0.5 * data.length * scale.inches
    side = sheet.scaled_axes(figure, scale, left=middle, low=-scale.metres(BELOW_GROUND), bottom=text, height=views)
    side_view(side, scale, data)
    low = -0.5 * data.width - scale.metres(BELOW_GROUND)
    plan = sheet.scaled_axes(figure, scale, left=sheet.WIDTH - middle - 0.3, low=low, bottom=text, height=views)
    plan_view(plan, scale, data)
    sheet.scale_bar(side, scale, -0.5 * data.length, -scale.metres(BELOW_GROUND), 0.1, "0.5 m")
    for table in tables:
        sheet.draw_table(figure, table, text)
    return figure


def _wheel_table(data: RoverSheet) -> sheet.SheetTable:
    slopes = [f"{tipping.direction} {math.degrees(tipping.angle):.0f}°" for tipping in data.tipping]
    rows: sheet.Rows = [("wheel load [N]", "x [m]", "y [m]", "level", *slopes)]
    for k, wheel in enumerate(data.rover.wheels):
        loads = (data.loads[k], *(tipping.loads[k] for tipping in data.tipping))
        name, x, y = wheel.name.replace("_", " "), f"{wheel.x:+.3f}", f"{wheel.y:+.3f}"
        rows.append((name, x, y, *(f"{load:.1f}" for load in loads)))
    offsets = (1.45, 1.95, 2.45, 3.3, 4.25, 5.15)
    return sheet.SheetTable(rows=rows, start=0.5, columns=((0.0, "left"), *((offset, "right") for offset in offsets)))


def _motion_table(data: RoverSheet) -> sheet.SheetTable:
    rover = data.rover
    rows: sheet.Rows = [
        ("dimensions and motion", ""),
        ("wheel radius, width", f"{rover.radius:.3f} m, {rover.width:.3f} m"),
        ("height of the centre of gravity", f"{rover.cg_height:.2f} m"),
        *((f"tips {tipping.direction} from", f"{math.degrees(tipping.angle):.1f}°") for tipping in data.tipping),
        ("driven wheels", f"{sum(wheel.driven for wheel in rover.wheels)} of {len(rover.wheels)}"),
        ("top speed without load", f"{data.top_speed:.2f} m/s"),
        ("thrust of all motors at stall", f"{data.stall_thrust:.0f} N"),
        *_steering_rows(data),
        ("entrapped from a sinkage of", f"{1e3 * rover.sinkage_limit:.0f} mm"),
    ]
    return sheet.SheetTable(rows=rows, start=6.0, columns=((0.0, "left"), (2.95, "right")))


def _steering_rows(data: RoverSheet) -> sheet.Rows:
    rover = data.rover
    if data.turning_radius is None:
        return [
            ("steering", "skid, by wheel speeds"),
            ("effective track of skid turns", f"{rover.effective_track:.2f} m"),
        ]
    count = sum(wheel.steered for wheel in rover.wheels)
    which = "all wheels" if count == len(rover.wheels) else f"{count} of {len(rover.wheels)} wheels"
    return [
        (f"steering, {which}", f"±{rover.steer_limit_deg:.0f}°, {rover.steer_rate_limit_deg:.0f}°/s"),
        ("smallest turning radius", f"{data.turning_radius:.2f} m" if data.turning_radius else "turns on the spot"),
    ]


def _soil_table(data: RoverSheet) -> sheet.SheetTable:
    rows: sheet.Rows = [
        ("soil", "sinkage [mm]", f"pull at {STANDARD_SLIP:.0%} [N]", "climbs up to", "stuck at slip"),
    ]
    for one in data.traction:
        trapped = "never" if one.entrapped_from is None else f"{one.entrapped_from:.0%}"
        sinkage, pull, climb = _text(one.sinkage, 1e3), _text(one.pull), f"{math.degrees(one.steepest_climb):.1f}°"
        rows.append((one.soil.replace("_", " "), sinkage, pull, climb, trapped))
    offsets = (2.25, 3.4, 4.3, 5.4)
    return sheet.SheetTable(rows=rows, start=9.3, columns=((0.0, "left"), *((offset, "right") for offset in offsets)))


def _text(value: float | None, factor: float = 1.0) -> str:
    return "–" if value is None else f"{factor * value:.1f}"


def _warnings(data: RoverSheet) -> tuple[str, ...]:
    trapped = [one.soil for one in data.traction if one.sinkage is None or one.entrapped_from == 0.0]
    return tuple(f"{soil} does not carry the rover: it is entrapped where it stands" for soil in trapped)


def _numbers(data: RoverSheet) -> dict[str, object]:
    rover = data.rover
    return {
        "name": rover.name,
        "summary": rover.summary,
        "mass_kg": rover.mass,
        "length_m": data.length,
        "width_m": data.width,
        "cg_x_m": rover.cg_x,
        "cg_height_m": rover.cg_height,
        "wheel_radius_m": rover.radius,
        "wheel_width_m": rover.width,
        "wheels": [
            {
                "name": wheel.name,
                "x_m": wheel.x,
                "y_m": wheel.y,
                "driven": wheel.driven,
                "steered": wheel.steered,
                "load_n": data.loads[k],
                "tipping_load_n": {tipping.direction: tipping.loads[k] for tipping in data.tipping},
            }
            for k, wheel in enumerate(rover.wheels)
        ],
        "tips_at_deg": {tipping.direction: math.degrees(tipping.angle) for tipping in data.tipping},
        "top_speed_m_s": data.top_speed,
        "stall_thrust_n": data.stall_thrust,
        "steered": rover.steered,
        "steer_limit_deg": rover.steer_limit_deg if rover.steered else None,
        "steer_rate_limit_deg_s": rover.steer_rate_limit_deg if rover.steered else None,
        "turning_radius_m": data.turning_radius,
        "effective_track_m": None if rover.steered else rover.effective_track,
        "sinkage_limit_m": rover.sinkage_limit,
        "soils": {one.soil: _soil_numbers(one) for one in data.traction},
    }


def _soil_numbers(one: Traction) -> dict[str, object]:
    return {
        "summary": one.summary,
        "sinkage_m": one.sinkage,
        "drawbar_pull_n": one.pull,
        "drawbar_pull_slip": STANDARD_SLIP,
        "largest_pull_n": one.largest_pull,
        "largest_pull_slip": one.largest_pull_slip,
        "entrapped_from_slip": one.entrapped_from,
        "steepest_climb_deg": math.degrees(one.steepest_climb),
    }
