"""`offtrack vehicle` and `offtrack assess`: show a vehicle's data sheet, and drive it through standard manoeuvres."""

from __future__ import annotations

import inspect
import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table
from rich.text import Text

from offtrack.commands.console import PlainConsole, Quiet, one_line_errors, progress_bar, progress_display
from offtrack.studies.standards.manoeuvre_kinds import KINDS, OTHER_NAMES, STANDARD_SET

if TYPE_CHECKING:
    from offtrack.reports.vehicle_sheet.sheet import SheetTable, VehicleSheet
    from offtrack.studies.standards.assessment import Assessment, AssessmentMatrix
    from offtrack.studies.standards.proving_ground import Conditions


VEHICLE_EXAMPLES = (
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
    from offtrack.reports.vehicle_sheet.library import known_vehicles

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
    from offtrack.reports.vehicle_sheet.library import open_sheet
    from offtrack.reports.vehicle_sheet.sheet import write_sheet
    from scenarios.results.run_directory import results_directory

    with results_directory(out, f"vehicle-{Path(name).stem}") as directory:
        sheet = open_sheet(name)
        write_sheet(sheet, directory)
    if as_json:
        typer.echo(json.dumps(sheet.numbers, indent=2))
    elif not quiet:
        _print_sheet(sheet, directory)


def _print_sheet(sheet: VehicleSheet, directory: Path) -> None:
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


ASSESS_EXAMPLES = (
    "Examples: offtrack assess eu_tractor_semitrailer   offtrack assess my_truck.toml --json   "
    "offtrack assess uk_longer_semitrailer --trailer-steering path_preview   "
    "offtrack assess eu_tractor_semitrailer --manoeuvres turn,aashto_turn --hand both --drawings dxf   "
    "offtrack assess eu_tractor_semitrailer --manoeuvres lane_change,pulse --speed 100 --friction 0.5   "
    "offtrack assess b_double --loads all --manoeuvres all"
)
Hands = Literal["left", "right", "both"]
Drawings = Literal["none", "dxf", "geojson", "both"]


def _listing() -> str:
    """Names of the manoeuvres with a line each."""
    others: dict[str, list[str]] = {}
    for other, key in OTHER_NAMES.items():
        others.setdefault(key, []).append(other)
    lines = (f"{', '.join((key, *others.get(key, ())))}: {kind.line}" for key, kind in KINDS.items())
    return "Manoeuvres:\n\n" + "\n\n".join(lines)


def assess(
    vehicle: Annotated[str, typer.Argument(help="Name of a vehicle (see: offtrack vehicle) or a TOML file.")],
    trailer_steering: Annotated[
        str,
        typer.Option(help="Steering law of the last unit's axles, or package.module:Name; none keeps them straight."),
    ] = "none",
    manoeuvres: Annotated[
        str,
        typer.Option(
            help="Manoeuvres of the list above, comma-separated, or all.",
            show_default=", ".join(STANDARD_SET),
        ),
    ] = "standard",
    loads: Annotated[
        str,
        typer.Option(help="Load cases, comma-separated: unladen, half, full (as in the vehicle file), or all."),
    ] = "full",
    hand: Annotated[Hands, typer.Option(help="Side to which manoeuvres turn first.")] = "left",
    speed: Annotated[
        float | None, typer.Option(help="Speed of the manoeuvres [km/h].", show_default="the standards'")
    ] = None,
    radius: Annotated[
        float | None, typer.Option(help="Radius of the turns [m].", show_default="the standards'")
    ] = None,
    friction: Annotated[
        float | None, typer.Option(help="Friction of the road [-].", show_default="the standards'")
    ] = None,
    drawings: Annotated[
        Drawings, typer.Option(help="Also draw manoeuvres along a path: DXF for CAD, GeoJSON for GIS (extra 'cad').")
    ] = "none",
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output directory of the report; it must not exist yet.", show_default="runs/assess-VEHICLE-N"
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the assessment as JSON and nothing else.")] = False,
) -> None:
    """Drive a vehicle through standard manoeuvres and compare it with the limits of the standards.

    A missed limit is a result, not an error. Manoeuvres under other conditions than the standard's (--speed, --radius,
    --friction) are not compared with limits.
    """
    from offtrack.exchange.drawings import formats_of
    from offtrack.studies.standards.assessment import assess as driven
    from offtrack.studies.standards.assessment import loaded
    from offtrack.studies.standards.assessment_report import write_assessment
    from offtrack.studies.standards.proving_ground import steered_trailer
    from scenarios.results.run_directory import results_directory
    from vehicle.combination.description import load_vehicle
    from vehicle.foundation.own_parts import close_part

    with one_line_errors(), ExitStack() as cleanup:
        chosen = load_vehicle(vehicle)
        directory = cleanup.enter_context(results_directory(out, f"assess-{chosen.name}"))
        kinds = formats_of(drawings)
        close_part(steered_trailer(chosen, trailer_steering))  # refuses what can not be steered
        with progress_display(shown=not (quiet or as_json)) as display:
            assessment = driven(
                chosen,
                trailer_steering=trailer_steering,
                manoeuvres=_words(manoeuvres),
                cases=loaded(chosen, _words(loads)),
                conditions=_conditions(hand, speed, radius, friction),
                progress=progress_bar(display, f"assess {chosen.name}"),
            )
        write_assessment(assessment, directory, kinds)
        if as_json:
            typer.echo(json.dumps(assessment.summary(), indent=2))
        elif not quiet:
            _print_assessment(assessment, directory)


assess.__doc__ = f"{inspect.cleandoc(assess.__doc__ or '')}\n\n{_listing()}"


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",")]


def _conditions(
    hand: Hands, speed: float | None, radius: float | None, friction: float | None
) -> tuple[Conditions, ...]:
    from offtrack.studies.standards.proving_ground import Conditions, Hand

    hands: dict[Hands, tuple[Hand, ...]] = {"left": ("left",), "right": ("right",), "both": ("left", "right")}
    metres_per_second = None if speed is None else speed / 3.6
    return tuple(Conditions(hand=one, speed=metres_per_second, radius=radius, friction=friction) for one in hands[hand])


def _print_assessment(matrix: AssessmentMatrix, directory: Path) -> None:
    console = PlainConsole()
    if len(matrix.cases) > 1:
        console.print(_matrix(matrix))
    else:
        (case,) = matrix.cases
        console.print(_figures(case))
        if case.judgements:
            console.print(_levels(case))
    for warning in matrix.warnings:
        console.print(f"Warning: {warning}", soft_wrap=True, style="yellow")
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)


def _matrix(matrix: AssessmentMatrix) -> Table:
    """All quantities over the cases, with the levels reached; the report names the limits."""
    from offtrack.studies.standards.assessment_report import matrix_table

    shown = matrix_table(matrix, limits=False)
    table = Table(
        title=f"{matrix.vehicle.name}: measured (levels reached; limits: see the report)", title_justify="left"
    )
    for column in shown.columns:
        table.add_column(column.title, justify="right" if column.kind == "number" else "left")
    styles = {"bad": "red", "good": "green"}
    for row in shown.rows:
        cells = [("", cell) if isinstance(cell, str) else (styles.get(cell.emphasis, ""), cell.text) for cell in row]
        bold = len(cells) == 1
        table.add_row(*(Text(text, style="bold" if bold else style) for style, text in cells))
    return table


def _figures(assessment: Assessment) -> Table:
    from offtrack.studies.standards.assessment_report import BY_NAME

    table = Table(title=f"{assessment.vehicle.name}: measured", title_justify="left")
    for column in ("", "quantity", "measured", "linear theory"):
        table.add_column(column, justify="right" if column in ("measured", "linear theory") else "left")
    for manoeuvre in assessment.manoeuvres:
        shown = [name for name, value in manoeuvre.figures.items() if value == value]
        head = manoeuvre.key.replace("_", " ")
        if not shown:
            table.add_row(head, Text(manoeuvre.outcome, style="red"), "–", "", end_section=True)
        for k, name in enumerate(shown):
            theory = BY_NAME[name].text(assessment.linear[name]) if name in assessment.linear else ""
            label, value = BY_NAME[name].label, BY_NAME[name].text(manoeuvre.figures[name])
            table.add_row(head if k == 0 else "", label, value, theory, end_section=k == len(shown) - 1)
    return table


def _levels(assessment: Assessment) -> Table:
    from offtrack.studies.standards.assessment_report import BY_NAME, bounds_text

    table = Table(title=f"{assessment.vehicle.name}: limits of the standards", title_justify="left")
    for column in ("quantity", "measured", "reached", "limits", "standard"):
        table.add_column(column, justify="right" if column == "measured" else "left")
    for judgement in assessment.judgements:
        criterion, quantity = judgement.criterion, BY_NAME[judgement.criterion.quantity]
        bad = judgement.reached in ("none", "missed", "not measured")
        table.add_row(
            quantity.label,
            quantity.text(judgement.measured),
            Text(judgement.reached, style="red" if bad else "green"),
            bounds_text(judgement),
            f"{criterion.standard} ({criterion.source})",
        )
    return table
