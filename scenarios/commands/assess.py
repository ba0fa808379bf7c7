"""`offtrack assess`: drive a vehicle through standard manoeuvres."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from scenarios.commands.console import PlainConsole, Quiet, one_line_errors, progress_bar, progress_display

if TYPE_CHECKING:
    from scenarios.standards.assessment import Assessment

EXAMPLES = (
    "Examples: offtrack assess eu_tractor_semitrailer   offtrack assess my_truck.toml --json   "
    "offtrack assess uk_longer_semitrailer --trailer-steering path_preview"
)


def assess(
    vehicle: Annotated[str, typer.Argument(help="Name of a vehicle (see: offtrack vehicle) or a TOML file.")],
    trailer_steering: Annotated[
        str,
        typer.Option(help="Steering law of the last unit's axles, or package.module:Name; none keeps them straight."),
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

    The manoeuvres: turn by 90 degrees, European roundabout, lane change of ISO 14791, straight road with cross-fall,
    steer pulse for yaw damping, and tilt for the static rollover threshold. A missed limit is a result, not an error.
    """
    from scenarios.results.run_directory import check_run_directory, next_run_directory
    from scenarios.standards.assessment import assess as driven
    from scenarios.standards.files import write_assessment
    from scenarios.standards.pilots import steered_trailer
    from vehicle.combination.description import load_vehicle

    with one_line_errors():
        chosen = load_vehicle(vehicle)
        directory = out or next_run_directory(f"assess-{chosen.name}")
        check_run_directory(directory)
        steered_trailer(chosen, trailer_steering)  # rejects unknown laws and vehicles without steered axles for the law
        with progress_display(shown=not (quiet or as_json)) as display:
            assessment = driven(
                chosen,
                trailer_steering=trailer_steering,
                progress=progress_bar(display, f"assess {chosen.name}"),
            )
        write_assessment(assessment, directory)
        if as_json:
            typer.echo(json.dumps(assessment.summary(), indent=2))
        elif not quiet:
            _print(assessment, directory)


def _print(assessment: Assessment, directory: Path) -> None:
    console = PlainConsole()
    console.print(_figures(assessment))
    console.print(_levels(assessment))
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)


def _figures(assessment: Assessment) -> Table:
    from scenarios.standards.quantities import BY_NAME

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
    from scenarios.standards.assessment_page import bounds_text
    from scenarios.standards.quantities import BY_NAME

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
