"""`offtrack vehicle`: check the file of a vehicle or rover, print its data sheet and draw it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from scenarios.commands.console import PlainConsole, one_line_errors

if TYPE_CHECKING:
    from scenarios.vehicle_sheet.paper import SheetTable
    from scenarios.vehicle_sheet.sheet import VehicleSheet

EXAMPLES = (
    "Examples: offtrack vehicle uk_longer_semitrailer   offtrack vehicle el_dorado_ii --json   "
    "offtrack vehicle my_truck.toml --out my_truck_sheet"
)


def vehicle(
    name: Annotated[
        str | None,
        typer.Argument(help="Vehicle or rover: a name or a TOML file. Without it, the known names are listed."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Output directory; it must not exist yet.", show_default="runs/vehicle-NAME-N"),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print no tables.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the data sheet as JSON and nothing else.")] = False,
) -> None:
    """Check a vehicle or rover file, print its data sheet and draw it to scale (side view and plan).

    A vehicle's sheet has axle loads, steering reach and handling; a rover's sheet has wheel loads, tipping angles and
    its traction in every soil.
    """
    with one_line_errors():
        if name is None:
            _list_vehicles(as_json=as_json)
        else:
            _show(name, out, quiet=quiet, as_json=as_json)


def _list_vehicles(*, as_json: bool) -> None:
    from scenarios.vehicle_sheet.library import known_vehicles

    known = known_vehicles()
    if as_json:
        typer.echo(json.dumps({name: summary for group in known.values() for name, summary in group.items()}, indent=2))
        return
    table = Table(box=None, show_header=False, pad_edge=False)
    for kind, summaries in known.items():
        table.add_row(Text(kind, style="bold"), "")
        for name, summary in summaries.items():
            table.add_row(f"  {name}", summary)
    PlainConsole().print(table)


def _show(name: str, out: Path | None, *, quiet: bool, as_json: bool) -> None:
    from scenarios.results.run_directory import results_directory
    from scenarios.vehicle_sheet.library import open_sheet
    from scenarios.vehicle_sheet.sheet import write_sheet

    with results_directory(out, f"vehicle-{Path(name).stem}") as directory:
        sheet = open_sheet(name)
        write_sheet(sheet, directory)
    if as_json:
        typer.echo(json.dumps(sheet.numbers, indent=2))
    elif not quiet:
        _print(sheet, directory)


def _print(sheet: VehicleSheet, directory: Path) -> None:
    console = PlainConsole()
    for line in (f"{sheet.name}: {sheet.summary}", sheet.size):
        console.print(line, soft_wrap=True)
    for table in sheet.tables:
        _print_table(console, table)
    for warning in sheet.warnings:
        console.print(f"Warning: {warning}", soft_wrap=True, style="yellow")
    console.print(f"{sheet.note}.", soft_wrap=True)
    console.print(f"Sheet: {directory / 'sheet.svg'}, sheet.png", soft_wrap=True)


def _print_table(console: PlainConsole, sheet_table: SheetTable) -> None:
    head, *rows = sheet_table.rows
    table = Table()
    for title, (_, align) in zip(head, sheet_table.columns, strict=True):
        table.add_column(title, justify=align)
    for row in rows:
        table.add_row(*row)
    console.print(table)
