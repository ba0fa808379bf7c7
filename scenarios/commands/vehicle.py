"""`offtrack vehicle`: a vehicle file checked, its data sheet printed and drawn."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from scenarios.commands.console import one_line_errors

if TYPE_CHECKING:
    from vehicle.combination.data_sheet import AxleSheet, DataSheet, Handling, UnitSheet
    from vehicle.combination.description import Vehicle

EXAMPLES = "Examples: offtrack vehicle uk_longer_semitrailer   offtrack vehicle my_truck.toml --out my_truck_sheet"


def vehicle(
    name: Annotated[
        str | None, typer.Argument(help="Name of a vehicle or a TOML file; without it the known vehicles are listed.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Directory of the sheet; must not exist yet.", show_default="runs/vehicle-NAME-N"),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No table.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the data sheet as JSON, and nothing else.")] = False,
) -> None:
    """Check a vehicle file, show loads, reach and handling, and draw it to scale (side view and plan)."""
    with one_line_errors():
        if name is None:
            _list_vehicles(as_json=as_json)
        else:
            _show(name, out, quiet=quiet, as_json=as_json)


def _list_vehicles(*, as_json: bool) -> None:
    from vehicle.combination.description import load_vehicle, vehicle_names

    known = {name: load_vehicle(name).summary for name in vehicle_names()}
    if as_json:
        typer.echo(json.dumps(known, indent=2))
        return
    table = Table(box=None, show_header=False, pad_edge=False)
    for row in known.items():
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)


def _show(name: str, out: Path | None, *, quiet: bool, as_json: bool) -> None:
    from scenarios.results.run import appearing_at_once, check_run_directory, next_run_directory
    from scenarios.vehicle_sheet.sheet import draw_sheet
    from vehicle.combination.data_sheet import data_sheet
    from vehicle.combination.description import load_vehicle, vehicle_sources

    chosen, sources = load_vehicle(name), vehicle_sources(name)
    directory = out or next_run_directory(f"vehicle-{Path(name).stem}")
    check_run_directory(directory)
    sheet = data_sheet(chosen)
    handling, missing = _handling(chosen, sheet)
    warnings = (*sheet.warnings, *missing)
    assumed = sum(source.startswith("assumed") for source in sources.values())
    note = f"{len(sources)} numbers of the file state their source, {assumed} of them as assumed"
    numbers = _as_json(sheet, handling, warnings) | {"sources": {"stated": len(sources), "assumed": assumed}}
    with appearing_at_once(directory) as folder:
        draw_sheet(chosen, sheet, handling, folder, note=note)
        (folder / "facts.json").write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    if as_json:
        typer.echo(json.dumps(numbers, indent=2))
    elif not quiet:
        _print(sheet, handling, warnings, note, directory)


def _handling(chosen: Vehicle, sheet: DataSheet) -> tuple[Handling | None, tuple[str, ...]]:
    """The handling at 80 km/h, or why there is none."""
    from vehicle.combination.data_sheet import handling_at

    if not sheet.stands:
        return None, ("no handling figures: the combination does not stand on all its axles",)
    try:
        return handling_at(chosen), ()
    except ValueError as error:
        return None, (f"no handling figures: {error}",)


def _print(sheet: DataSheet, handling: Handling | None, warnings: tuple[str, ...], note: str, directory: Path) -> None:
    from scenarios.vehicle_sheet.sheet import axle_rows, handling_rows, steering_rows, unit_rows

    console = Console()
    size = f"{sheet.mass / 1e3:.2f} t, {sheet.length:.2f} x {sheet.width:.2f} x {sheet.height:.2f} m"
    for line in (f"{sheet.name}: {sheet.summary}", size):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    for rows, columns in ((axle_rows(sheet), "lrrl"), (unit_rows(sheet), "lrr")):
        _print_table(console, rows[0], rows[1:], columns)
    _print_table(console, ("steering and handling", ""), [*steering_rows(sheet), *handling_rows(handling)], "lr")
    for warning in warnings:
        console.print(f"Warning: {warning}", soft_wrap=True, highlight=False, markup=False, style="yellow")
    console.print(f"{note}.", soft_wrap=True, highlight=False)
    console.print(f"Sheet: {directory / 'sheet.svg'}, sheet.png", soft_wrap=True, highlight=False)


def _print_table(console: Console, head: tuple[str, ...], rows: list[Any], columns: str) -> None:
    table = Table()
    for title, side in zip(head, columns, strict=True):
        table.add_column(Text(title), justify="right" if side == "r" else "left")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))  # units in brackets are no markup
    console.print(table)


def _as_json(sheet: DataSheet, handling: Handling | None, warnings: tuple[str, ...]) -> dict[str, Any]:
    return {
        "name": sheet.name,
        "summary": sheet.summary,
        "mass_kg": sheet.mass,
        "length_m": sheet.length,
        "width_m": sheet.width,
        "height_m": sheet.height,
        "units": [_unit(unit) for unit in sheet.units],
        "handling": None if handling is None else _handling_numbers(handling),
        "warnings": list(warnings),
    }


def _unit(unit: UnitSheet) -> dict[str, Any]:
    from vehicle.combination.description import GRAVITY

    return {
        "name": unit.name,
        "mass_kg": unit.mass,
        "body_length_m": unit.body_length,
        "behind_front_m": unit.behind_front,
        "coupling_load_kg": None if unit.coupling_load is None else unit.coupling_load / GRAVITY,
        "smallest_circle_m": unit.smallest_circle,
        "axles": [_axle(axle) for axle in unit.axles],
    }


def _axle(axle: AxleSheet) -> dict[str, Any]:
    from vehicle.combination.description import GRAVITY

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
    from vehicle.combination.description import GRAVITY

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
