"""`offtrack vehicle`, `assess`, `validate` and `reproduce`: data sheets; comparison with standards, theory, papers."""

import dataclasses
import inspect
import json
import math
import platform
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.table import Table
from rich.text import Text

from offtrack.commands import console as ui
from offtrack.commands.new_vehicle import write_new_vehicle
from offtrack.exchange.drawings import formats_of
from offtrack.reports.run_files import write_json
from offtrack.reports.vehicle_sheet.combination_sheet import known_vehicles, open_sheet
from offtrack.reports.vehicle_sheet.sheet import SheetTable, VehicleSheet, write_sheet
from offtrack.studies.reproduce import reproduction as papers
from offtrack.studies.standards.assessment import OTHER_NAMES, STANDARD_SET, Assessment, AssessmentMatrix, loaded
from offtrack.studies.standards.assessment import assess as driven
from offtrack.studies.standards.assessment_report import BY_NAME, levels_table, matrix_table, write_assessment
from offtrack.studies.standards.proving_ground import KINDS, ChosenLaw, Conditions, Hand, steered_trailer
from offtrack.studies.validation.check import CheckSection, tally
from offtrack.studies.validation.suite import TASKS, checks_table, validation_page
from scenarios.assembly.drivers_and_laws import steering_parameters
from scenarios.options.scenario import load_scenario
from scenarios.progress import interrupted_code
from scenarios.results import run_directory
from vehicle.combination.description import load_vehicle
from vehicle.foundation.own_parts import close_part
from vehicle.foundation.user_file import shown

VEHICLE_EXAMPLES = (
    "Examples: offtrack vehicle uk_longer_semitrailer   offtrack vehicle el_dorado_ii --json   "
    "offtrack vehicle new my_truck --like uk_longer_semitrailer --axles 2,3   "
    "offtrack vehicle my_truck.toml --out my_truck_sheet"
)


def vehicle(
    name: Annotated[
        str | None,
        typer.Argument(help="Vehicle or rover: a name or a TOML file; or new. Without it, the known names are listed."),
    ] = None,
    new_name: Annotated[
        str | None, typer.Argument(metavar="NEW_NAME", help="Name of the new vehicle, after new.", show_default=False)
    ] = None,
    like: Annotated[str, typer.Option(help="Of new: vehicle to begin with.")] = "eu_tractor_semitrailer",
    axles: Annotated[
        str | None,
        typer.Option(metavar="2,3", help="Of new: number of axles of each unit.", show_default="as --like"),
    ] = None,
    out: Annotated[Path | None, ui.new_directory("runs/vehicle-NAME-N; of new NAME.toml")] = None,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Check a vehicle or rover file, print its data sheet and draw it to scale (side view and plan).

    A vehicle's sheet has axle loads, steering reach and handling; a rover's sheet has wheel loads, tipping angles and
    its traction in every soil.

    offtrack vehicle new NAME writes NAME.toml: every key with its unit, limits and usual value, ready to run.
    """
    if name == "new":
        if new_name is None:
            raise ValueError("vehicle new: name the vehicle, such as my_truck")
        write_new_vehicle(new_name, like, axles, out)
        return
    if new_name is not None or axles is not None:
        raise ValueError(f"vehicle {shown(name or '')}: a second name and --axles belong to: offtrack vehicle new NAME")
    if name is None:
        _list_vehicles(as_json=as_json)
        return
    with run_directory.results_directory(out, f"vehicle-{Path(name).stem}") as directory:
        sheet = open_sheet(name)
        write_sheet(sheet, directory)
    ui.answer(sheet.numbers, lambda: _print_sheet(sheet, directory), quiet=quiet, as_json=as_json)


def _list_vehicles(*, as_json: bool) -> None:
    known = known_vehicles()
    plain = {name: summary for group in known.values() for name, summary in group.items()}
    rows: list[tuple[str | Text, str]] = []
    for kind, summaries in known.items():
        rows += [(Text(kind, style="bold"), ""), *((f"  {name}", summary) for name, summary in summaries.items())]
    ui.answer(plain, lambda: ui.PlainConsole().print(ui.listing(rows)), as_json=as_json)


def _print_sheet(sheet: VehicleSheet, directory: Path) -> None:
    console = ui.PlainConsole()
    for line in (f"{sheet.name}: {sheet.summary}", sheet.size):
        console.print(line, soft_wrap=True)
    for table in sheet.tables:
        _print_table(console, table)
    for warning in sheet.warnings:
        console.print(f"Warning: {warning}", soft_wrap=True, style="yellow")
    console.print(f"{sheet.note}.", soft_wrap=True)
    console.print(f"Sheet: {directory / 'sheet.svg'}, sheet.png", soft_wrap=True)


def _print_table(console: ui.PlainConsole, sheet_table: SheetTable) -> None:
    head, *rows = sheet_table.rows
    columns = zip(head, sheet_table.columns, strict=True)
    table = ui.table_of(*((">" if align == "right" else "") + title for title, (_, align) in columns))
    for row in rows:
        table.add_row(*row)
    console.print(table)


ASSESS_EXAMPLES = (
    "Examples: offtrack assess eu_tractor_semitrailer   offtrack assess my_truck.toml --json   "
    "offtrack assess uk_longer_semitrailer --trailer-steering path_preview --set steering.gain=0.5   "
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
            help="Manoeuvres of the list above, comma-separated, or all.", show_default=", ".join(STANDARD_SET)
        ),
    ] = "standard",
    loads: Annotated[
        str, typer.Option(help="Load cases, comma-separated: unladen, half, full (as in the vehicle file), or all.")
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
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="KEY=VALUE of the steering law: steering.…, policy.path; may be repeated."),
    ] = None,
    drawings: Annotated[
        Drawings, typer.Option(help="Also draw manoeuvres along a path: DXF for CAD, GeoJSON for GIS (extra 'cad').")
    ] = "none",
    out: Annotated[Path | None, ui.new_directory("runs/assess-VEHICLE-N")] = None,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Drive a vehicle through standard manoeuvres and compare it with the limits of the standards.

    A missed limit is a result, not an error. Manoeuvres under other conditions than the standard's (--speed, --radius,
    --friction) are not compared with limits.
    """
    with ExitStack() as cleanup:
        chosen = load_vehicle(vehicle)
        directory = cleanup.enter_context(run_directory.results_directory(out, f"assess-{chosen.name}"))
        kinds = formats_of(drawings)
        trailer_steering = _chosen_law(vehicle, trailer_steering, settings or ())
        close_part(steered_trailer(chosen, trailer_steering))  # refuses what can not be steered
        with ui.progress_display(shown=not (quiet or as_json)) as display:
            assessment = driven(
                chosen,
                trailer_steering=trailer_steering,
                manoeuvres=_words(manoeuvres),
                cases=loaded(chosen, _words(loads)),
                conditions=_conditions(hand, speed, radius, friction),
                progress=ui.progress_bar(display, f"assess {chosen.name}"),
            )
        write_assessment(assessment, directory, kinds)
        show = partial(_print_assessment, assessment, directory)
        ui.answer(assessment.summary() if as_json else None, show, quiet=quiet, as_json=as_json)


assess.__doc__ = f"{inspect.cleandoc(assess.__doc__ or '')}\n\n{_listing()}"


def _chosen_law(vehicle: str, name: str, settings: Sequence[str]) -> str:
    """The law with its parameters."""
    for setting in settings:
        if setting.partition(".")[0] not in ("steering", "policy"):
            raise ValueError(f"--set {shown(setting)}: a steering law has only the keys steering.… and policy.path")
    if name == "none" or not (settings or name == "policy"):
        if settings:
            raise ValueError(f"--set {shown(settings[0])}: name a law, such as --trailer-steering path_preview")
        return name
    scenario = load_scenario("roundabout", [f"vehicle={vehicle}", f"trailer_steering={name}", *settings])
    return ChosenLaw(name, steering_parameters(scenario))


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",")]


def _conditions(
    hand: Hands, speed: float | None, radius: float | None, friction: float | None
) -> tuple[Conditions, ...]:
    hands: dict[Hands, tuple[Hand, ...]] = {"left": ("left",), "right": ("right",), "both": ("left", "right")}
    metres_per_second = None if speed is None else speed / 3.6
    return tuple(Conditions(hand=one, speed=metres_per_second, radius=radius, friction=friction) for one in hands[hand])


def _print_assessment(matrix: AssessmentMatrix, directory: Path) -> None:
    console = ui.PlainConsole()
    if len(matrix.cases) > 1:
        title = f"{matrix.vehicle.name}: measured (levels reached; limits: see the report)"
        console.print(ui.page_table(matrix_table(matrix, limits=False), title))
    else:
        (case,) = matrix.cases
        console.print(_figures(case))
        if case.judgements:
            console.print(ui.page_table(levels_table(case), f"{case.vehicle.name}: limits of the standards"))
    for line in dict.fromkeys(
        line for case in matrix.cases for line in case.disagreements(lambda key: BY_NAME[key].label)
    ):
        console.print(f"Note: {line}", soft_wrap=True)
    for warning in matrix.warnings:
        console.print(f"Warning: {warning}", soft_wrap=True, style="yellow")
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)


def _figures(assessment: Assessment) -> Table:
    columns = ("", "quantity", ">measured", ">linear theory")
    table = ui.table_of(*columns, title=f"{assessment.vehicle.name}: measured")
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


def validate(
    out: Annotated[Path | None, ui.new_directory("runs/validate-N")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Run fewer cases: about half a minute.")] = False,
    as_json: ui.AsJson = False,
) -> None:
    """Compare the vehicle model with closed forms, published tables and independent models.

    Prints every number with its target, tolerance and source, and writes a page with plots. The exit code is 1 if a
    number is out of tolerance.
    """
    with run_directory.results_directory(out, "validate") as directory:
        begin = time.perf_counter()
        sections = []
        with ui.progress_display(shown=not as_json) as progress:
            report = ui.progress_bar(progress, "validation")
            for done, (title, work) in enumerate(TASKS.items()):
                report(done, len(TASKS), title)
                sections.append(work(quick))
        facts = _run_information(time.perf_counter() - begin, quick)
        with run_directory.appearing_at_once(directory) as folder:
            (folder / "validation.html").write_text(validation_page(sections, facts), encoding="utf-8")
            write_json(folder / "validation.json", _plain(sections))
        ui.answer(_plain(sections), lambda: _print_sections(sections, directory), as_json=as_json)
    if tally(sections)["failed"]:
        raise typer.Exit(ui.CHECK_FAILED)


def _run_information(seconds: float, quick: bool) -> dict[str, str]:
    versions = ", ".join(f"{name} {version(name)}" for name in ("casadi", "numpy", "scipy"))
    return {
        "offtrack": version("offtrack"),
        "python": platform.python_version(),
        "libraries": versions,
        "cases": "quick: fewer cases" if quick else "all",
        "computing time": f"{seconds:.0f} s",
    }


def _plain(sections: Sequence[CheckSection]) -> dict[str, Any]:
    """All checks and the number of each verdict, for JSON."""
    checks = [
        {"section": part.title, "verdict": check.verdict, **dataclasses.asdict(check), "value": _finite(check.value)}
        for part in sections
        for check in part.checks
    ]
    return {**tally(sections), "checks": checks}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None  # JSON has no NaN


def _print_sections(sections: Sequence[CheckSection], directory: Path) -> None:
    console = ui.PlainConsole()
    for part in sections:
        table, sources = checks_table(part)
        console.print(ui.page_table(table, part.title, box=None, pad_edge=False))
        for k, source in enumerate(sources, start=1):
            console.print(f"  [{k}] {source}", style="dim")
        console.print()
    counts = tally(sections)
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    console.print(verdicts, style="bold red" if counts["failed"] else "bold green")
    console.print(f"Page: {directory / 'validation.html'}", soft_wrap=True)


REPRODUCE_EXAMPLES = "Examples: offtrack reproduce reina2008-table3   offtrack reproduce all --quick --out papers"


def reproduce(
    name: Annotated[
        str,
        typer.Argument(
            help="One of reina2008-table2, -table3, -table3-plus, -fig6, -fig8; "
            "desaxe2018-fig6 to -fig9, -fig13 to -fig16; or all."
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Use fewer images and shorter drives: a few minutes each.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output directory for picture, data and numbers; it must not exist yet. With all: a folder in it for "
            "each.",
            show_default="runs/NAME-N",
        ),
    ] = None,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Reproduce a paper's table or figure and print it with the published numbers.

    Ctrl-C stops it. Finished results are kept, and an unfinished figure shows its finished drives. With all and --out,
    the same command makes those that are missing.
    """
    names = papers.names_of(name)
    several, shown = len(names) > 1, not (quiet or as_json)
    directories = [(out / one if out and several else out) or run_directory.next_run_directory(one) for one in names]
    settings = {"quick": quick}
    earlier = {
        one: papers.earlier_reproduction(one, directory, settings) if several else None
        for one, directory in zip(names, directories, strict=True)
    }
    for one, directory in zip(names, directories, strict=True):
        if not earlier[one]:
            run_directory.check_run_directory(directory)
    results: list[dict[str, Any]] = []
    for one, directory in zip(names, directories, strict=True):
        kept = earlier[one]
        if kept:
            ui.remark(f"{one}: finished earlier, in {directory}")
            results.append(kept)
            continue
        with ui.progress_display(shown=shown) as display:
            reproduction = papers.maker(one)(quick, ui.progress_bar(display, one))
        papers.write_reproduction(reproduction, directory, settings)
        results.append(reproduction.as_plain())
        if shown:
            _print_reproduction(reproduction, directory)
        if reproduction.interrupted:
            break
    if as_json:
        typer.echo(json.dumps(results if several else results[0], indent=2, ensure_ascii=False))
    if results[-1]["interrupted"]:
        ui.remark(f"interrupted; what is finished is in {directory}")
        raise typer.Exit(interrupted_code())


def _print_reproduction(result: papers.Reproduction, directory: Path) -> None:
    title = f"{result.title} ({result.source})"
    table = ui.table_of("quantity", ">published", ">own", "unit", title=title)
    for one in result.comparisons:
        table.add_row(one.quantity, one.published or "–", one.own_text, one.unit)
    console = ui.PlainConsole()
    console.print(table)
    for note in result.notes:
        console.print(note, style="dim")
    console.print(f"Picture, data and numbers: {directory}", soft_wrap=True)
