"""Data sheets of vehicles by name; that of a combination: loads, reach of steered axles, handling, and drawings."""

import math
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from offtrack.reports.vehicle_sheet.combination_views import BELOW_GROUND, CombinationDrawing, plan_view, side_view
from offtrack.reports.vehicle_sheet.rover_sheet import rover_sheet
from offtrack.reports.vehicle_sheet.sheet import (
    GAP,
    MARGIN,
    TITLE,
    WIDTH,
    Rows,
    Scale,
    SheetTable,
    VehicleSheet,
    draw_table,
    height_of,
    new_sheet,
    scale_bar,
    scaled_axes,
    sources_note,
)
from vehicle.combination.data_sheet import AxleSheet, DataSheet, Handling, UnitSheet, data_sheet, handling_at
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names, vehicle_sources
from vehicle.combination.handling import Capability, longitudinal_capability
from vehicle.combination.variants import FULL, load_cases, with_load
from vehicle.foundation.user_file import nearest, read_toml
from vehicle.rover.description import load_rover, rover_names

_LARGEST_SCALE: Final = 0.85  # [in/m]; a short truck does not fill the sheet
_KEY: Final = "lengths in m   steered: blue, in the plan at the lock of a left turn   driven: dark hub   lifted: grey"


def combination_sheet(name_or_path: str) -> VehicleSheet:
    """Data sheet of a shipped combination, or of one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit.
    """
    vehicle = load_vehicle(name_or_path)
    data = data_sheet(vehicle)
    handling, missing = _handling(vehicle, data)
    loads, without_load = _loads(vehicle, data)
    warnings = (*data.warnings, *missing, *without_load)
    note, sources = sources_note(vehicle_sources(name_or_path))
    capability = longitudinal_capability(vehicle) if data.stands else None
    tables = _tables(data, handling, capability)
    return VehicleSheet(
        name=data.name,
        summary=data.summary,
        size=f"{data.mass / 1e3:.2f} t, {data.length:.2f} x {data.width:.2f} x {data.height:.2f} m",
        tables=(*tables, *([_load_table(loads)] if len(loads) > 1 else [])),
        warnings=warnings,
        note=note,
        numbers=_numbers(data, loads, handling)
        | {"longitudinal": None if capability is None else capability._asdict()}
        | {"warnings": list(warnings), "sources": sources},
        draw=lambda: draw_combination(vehicle, data, tables, note=note),
    )


def _handling(vehicle: Vehicle, data: DataSheet) -> tuple[Handling | None, tuple[str, ...]]:
    """Handling at 80 km/h, or None and a warning with the reason."""
    if not data.stands:
        return None, ("no handling figures: the combination does not stand on all its axles",)
    try:
        return handling_at(vehicle), ()
    except ValueError as error:
        return None, (f"no handling figures: {error}",)


def _loads(vehicle: Vehicle, full: DataSheet) -> tuple[dict[str, DataSheet], tuple[str, ...]]:
    """Data sheets by load case, and a warning if the payload does not fit the unit."""
    try:
        return {
            case: full if case == FULL else data_sheet(with_load(vehicle, case)) for case in load_cases(vehicle)
        }, ()
    except ValueError as error:
        return {FULL: full}, (f"no other load cases: {error}",)


def draw_combination(vehicle: Vehicle, data: DataSheet, tables: tuple[SheetTable, ...], *, note: str = "") -> Figure:
    """Sheet with side view, plan and tables."""
    scale = Scale(min((WIDTH - 2.0 * MARGIN) / data.length, _LARGEST_SCALE))
    drawing = CombinationDrawing(vehicle, data, scale)
    side = data.height * scale.inches + GAP + BELOW_GROUND
    plan = data.width * scale.inches + 2.0 * GAP
    text = height_of(tables)
    figure = new_sheet(TITLE + side + plan + text, name=data.name, summary=data.summary, key=_KEY, note=note)
    left = 0.5 * (WIDTH - data.length * scale.inches)
    low = -scale.metres(BELOW_GROUND)
    side_view(scaled_axes(figure, scale, left=left, low=low, bottom=text + plan, height=side), drawing)
    low = -0.5 * scale.metres(plan)
    ax = scaled_axes(figure, scale, left=left, low=low, bottom=text, height=plan)
    plan_view(ax, drawing)
    scale_bar(ax, scale, 0.0, low, 1.0, "5 m")
    for table in tables:
        draw_table(figure, table, text)
    return figure


def _tables(data: DataSheet, handling: Handling | None, capability: Capability | None) -> tuple[SheetTable, ...]:
    answers = [
        ("steering, handling and drive", ""),
        *_steering_rows(data),
        *_handling_rows(handling),
        *_longitudinal_rows(capability),
    ]
    return (
        SheetTable(
            rows=_axle_rows(data),
            start=MARGIN,
            columns=((0.0, "left"), (2.15, "right"), (2.85, "right"), (3.05, "left")),
        ),
        SheetTable(rows=_unit_rows(data), start=6.6, columns=((0.0, "left"), (1.9, "right"), (2.7, "right"))),
        SheetTable(rows=answers, start=10.3, columns=((0.0, "left"), (3.7, "right"))),
    )


def _axle_rows(data: DataSheet) -> Rows:
    rows: Rows = [("axle", "behind front [m]", "load [t]", "")]
    for unit in data.units:
        for k, axle in enumerate(unit.axles, start=1):
            group = f" ({axle.group})" if axle.group else ""
            steered = [] if axle.reach is None else [f"steered ±{math.degrees(axle.reach):.1f}°{group}"]
            kinds = [*steered, *(["driven"] if axle.driven else []), *(["lifted"] if axle.lifted else [])]
            load = "–" if axle.lifted else _tonnes(axle.load)
            rows.append((f"{unit.name} {k}", f"{axle.behind_front:.2f}", load, ", ".join(kinds)))
    return rows


def _unit_rows(data: DataSheet) -> Rows:
    rows: Rows = [("unit", "mass [t]", "coupling [t]")]
    for unit in data.units:
        coupling = "" if unit.coupling_load is None else _tonnes(unit.coupling_load)
        rows.append((unit.name, f"{unit.mass / 1e3:.2f}", coupling))
    return [*rows, ("combination", f"{data.mass / 1e3:.2f}", "")]


def _load_table(loads: dict[str, DataSheet]) -> SheetTable:
    """Mass and axle loads in every load case; printed, not drawn."""
    rows: Rows = [("load case", "mass [t]", "axle loads, front to rear, unit by unit [t]")]
    for case, data in loads.items():
        units = (" ".join(f"{axle.load / GRAVITY / 1e3:.1f}" for axle in unit.axles) for unit in data.units)
        rows.append((case, f"{data.mass / 1e3:.2f}", " | ".join(units)))
    return SheetTable(rows=rows, start=MARGIN, columns=((0.0, "left"), (1.9, "right"), (2.1, "left")))


def _tonnes(load: float) -> str:
    return f"{load / GRAVITY / 1e3:.2f}"


def _steering_rows(data: DataSheet) -> Rows:
    """Smallest circles that the steered axles allow."""
    return [
        (
            "outer front corner at full lock" if i == 0 else f"{unit.name} follows its hitch down to",
            f"{unit.smallest_circle:.2f} m radius",
        )
        for i, unit in enumerate(data.units)
        if unit.smallest_circle is not None
    ]


def _handling_rows(handling: Handling | None) -> Rows:
    if handling is None:
        return []
    gradient = math.degrees(handling.understeer_gradient) * GRAVITY
    at = f"at {handling.speed * 3.6:.0f} km/h"
    amplification = handling.rearward_amplification
    return [
        (f"understeer gradient {at}", f"{gradient:+.2f} °/g"),
        ("characteristic speed", _speed(handling.characteristic_speed, "none, it oversteers")),
        ("critical speed", _speed(handling.critical_speed, "none up to 250 km/h")),
        (f"yaw damping ratio {at}, no lags", f"{handling.yaw_damping:.2f}"),
        *([] if amplification is None else [(f"rearward amplification {at}, no lags", f"{amplification:.2f}")]),
        ("static rollover threshold, level turn", f"{handling.rollover_threshold / GRAVITY:.2f} g"),
    ]


def _longitudinal_rows(capability: Capability | None) -> Rows:
    if capability is None:
        return []
    holding = capability.holding_grade
    return [
        ("startability", f"{100.0 * capability.startability:.1f} %"),
        ("gradeability at 10 km/h", f"{100.0 * capability.gradeability:.1f} %"),
        ("speed on a grade of 1 %", f"{capability.speed_on_1_percent_kmh:.0f} km/h"),
        ("100 m from rest", f"{capability.acceleration_100_m_s:.1f} s"),
        *([] if holding is None else [("endurance brake holds 30 km/h on", f"-{100.0 * holding:.1f} %")]),
    ]


def _speed(speed: float | None, otherwise: str) -> str:
    return otherwise if speed is None else f"{speed * 3.6:.0f} km/h"


def _numbers(data: DataSheet, loads: dict[str, DataSheet], handling: Handling | None) -> dict[str, object]:
    return {
        "name": data.name,
        "summary": data.summary,
        "mass_kg": data.mass,
        "length_m": data.length,
        "width_m": data.width,
        "height_m": data.height,
        "units": [_unit(unit) for unit in data.units],
        "loads": {case: _load(sheet) for case, sheet in loads.items()},
        "handling": None if handling is None else _handling_numbers(handling),
    }


def _load(data: DataSheet) -> dict[str, object]:
    axles = {unit.name: [axle.load / GRAVITY for axle in unit.axles] for unit in data.units}
    return {"mass_kg": data.mass, "axle_loads_kg": axles}


def _unit(unit: UnitSheet) -> dict[str, object]:
    return {
        "name": unit.name,
        "mass_kg": unit.mass,
        "body_length_m": unit.body_length,
        "behind_front_m": unit.behind_front,
        "coupling_load_kg": None if unit.coupling_load is None else unit.coupling_load / GRAVITY,
        "smallest_circle_m": unit.smallest_circle,
        "axles": [_axle(axle) for axle in unit.axles],
    }


def _axle(axle: AxleSheet) -> dict[str, object]:
    return {
        "x_m": axle.x,
        "behind_front_m": axle.behind_front,
        "load_kg": axle.load / GRAVITY,
        "steered": axle.steered,
        "driven": axle.driven,
        "lifted": axle.lifted,
        "reach_deg": None if axle.reach is None else math.degrees(axle.reach),
        "group": axle.group,
    }


def _handling_numbers(handling: Handling) -> dict[str, float | None]:
    def kmh(speed: float | None) -> float | None:
        return None if speed is None else speed * 3.6

    return {
        "speed_kmh": kmh(handling.speed),
        "understeer_gradient_deg_per_g": math.degrees(handling.understeer_gradient) * GRAVITY,
        "characteristic_speed_kmh": kmh(handling.characteristic_speed),
        "critical_speed_kmh": kmh(handling.critical_speed),
        "yaw_damping": handling.yaw_damping,
        "rearward_amplification": handling.rearward_amplification,
        "rollover_threshold_g": handling.rollover_threshold / GRAVITY,
    }


def known_vehicles() -> dict[str, dict[str, str]]:
    """Summaries of the shipped vehicles and rovers by kind and name."""
    return {
        "vehicles": {name: load_vehicle(name).summary for name in vehicle_names()},
        "rovers": {name: load_rover(name).summary for name in rover_names()},
    }


def open_sheet(name_or_path: str) -> VehicleSheet:
    """Data sheet of a shipped vehicle or rover, or of one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    return rover_sheet(name_or_path) if is_rover(name_or_path) else combination_sheet(name_or_path)


def is_rover(name_or_path: str) -> bool:
    """True for a rover, False for a combination.

    Raises:
        ValueError: one line, if it is no name of one and no ``.toml`` file that can be read.
    """
    if name_or_path.endswith(".toml"):
        return "sinkage_limit" in read_toml(Path(name_or_path))
    vehicles, rovers = vehicle_names(), rover_names()
    if name_or_path not in (*vehicles, *rovers):
        raise ValueError(f"unknown vehicle or rover '{name_or_path}'{nearest(name_or_path, (*vehicles, *rovers))}")
    return name_or_path in rovers
