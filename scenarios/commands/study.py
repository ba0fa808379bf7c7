"""`offtrack compare` and `offtrack sweep`: grids of runs with tables and reports."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from scenarios.commands.console import (
    CHECK_FAILED,
    PlainConsole,
    Quiet,
    ScenarioName,
    check_number,
    one_line_errors,
    progress_bar,
    progress_display,
    remark,
)
from scenarios.processes import MOST_JOBS

if TYPE_CHECKING:
    from scenarios.studies.study import Study
    from scenarios.studies.table import Row

COMPARE_EXAMPLES = (
    "Examples: offtrack compare roundabout --controllers none,command_steer,path_preview --off-tracking truth   "
    "offtrack compare roundabout-low-friction --controllers path_preview,mpc --off-tracking truth,viso_ot "
    "--vary surface.friction=0.8,0.5,0.3,0.2 --seeds 1-5   "
    "offtrack compare rover-slope --slip-estimators truth,ftrace_plus"
)
SWEEP_EXAMPLES = "Example of a STUDY.toml: the study.toml that offtrack compare writes."

Jobs = Annotated[int | None, typer.Option(help="Number of parallel runs.", show_default="one per core")]
Out = Annotated[
    Path | None,
    typer.Option(help="Output directory; an existing study is resumed.", show_default=False),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print only the rows, as JSON.")]


def compare(
    scenario: ScenarioName,
    controllers: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated trailer steering laws; for a rover, values of slip_compensation.",
            show_default="none,command_steer,path_preview; none,heading,crab",
        ),
    ] = None,
    estimators: Annotated[
        str,
        typer.Option(
            "--off-tracking", "--slip-estimators", help="Comma-separated off-tracking sources, or slip estimators."
        ),
    ] = "truth",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the scenario in all runs. May be repeated."),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE,VALUE,…", help="Further axis of the grid. May be repeated."),
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds, as 1-5 or 1,2,7; every combination is run with each.")] = "1",
    jobs: Jobs = None,
    out: Out = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Compare trailer steering laws, or a rover's slip compensations, and print a table.

    Finished runs are saved at once: repeat the command to continue an interrupted study. A law that does not use the
    off-tracking runs with the first source only.
    """
    from scenarios.catalogue import resolve
    from scenarios.studies.case import listed, seeds_of
    from scenarios.studies.study import Study, settings_of
    from scenarios.studies.subject import TRAILER, subject_of

    with one_line_errors():
        subject = subject_of(scenario)
        chosen = subject.controllers if controllers is None else listed(controllers, "--controllers")
        sources = listed(estimators, "--off-tracking")
        for law in chosen if subject is TRAILER else ():
            resolve("--controllers", law, subject.parts)
        for source in sources:
            resolve("--off-tracking", source, subject.estimators)
        axes = {subject.compared: chosen, subject.estimator: sources}
        axes |= {key: listed(values, f"--vary {key}") for key, values in settings_of(vary or [], "--vary")}
        study = Study(scenario=scenario, fixed=settings_of(settings or [], "--set"), axes=axes, seeds=seeds_of(seeds))
    _run_study(f"compare-{_short(scenario)}", study, jobs=jobs, out=out, quiet=quiet, as_json=as_json)


def sweep(
    study_file: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY.toml",
            help="TOML file: scenario, seeds, table [set] of settings, table [vary] of value lists, by dotted keys.",
        ),
    ],
    jobs: Jobs = None,
    out: Out = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Run every combination of a study's values with every seed, and print a table."""
    from scenarios.studies.study import load_study

    with one_line_errors():
        study = load_study(study_file)
    _run_study(f"sweep-{study_file.stem}", study, jobs=jobs, out=out, quiet=quiet, as_json=as_json)


def _short(scenario: str) -> str:
    return Path(scenario).stem if scenario.endswith(".toml") else scenario


def _run_study(title: str, study: Study, *, jobs: int | None, out: Path | None, quiet: bool, as_json: bool) -> None:
    """Run the study, write its directory and print its table."""
    from scenarios.processes import default_jobs
    from scenarios.studies.run_study import run_study

    directory = out or Path("runs") / title
    with one_line_errors():
        check_number("--jobs", jobs, 1, MOST_JOBS)
        with progress_display(shown=not (quiet or as_json)) as bar:
            progress = progress_bar(bar, title)
            outcomes, rows = run_study(
                title, study, directory, jobs=jobs or default_jobs(), progress=progress, remark=remark
            )
    if as_json:
        typer.echo(json.dumps([_plain(row) for row in rows], indent=2))
    elif not quiet:
        _print(rows, directory)
    if any(str(outcome.numbers["outcome"]).startswith("failed") for outcome in outcomes):
        raise typer.Exit(CHECK_FAILED)


def _plain(row: Row) -> dict[str, object]:
    return {
        "axes": dict(row.axes),
        "runs": row.runs,
        "completed": row.completed,
        "endings": list(row.endings),
        **row.numbers,
    }


def _print(rows: Sequence[Row], directory: Path) -> None:
    from scenarios.studies.table import shown_quantities, text_of

    quantities = shown_quantities(rows)
    varied = [key for key, _ in rows[0].axes if len({dict(row.axes)[key] for row in rows}) > 1]
    table = Table(padding=(0, 1) if PlainConsole().width > 100 else (0, 0))
    for key in varied:  # 80 columns may break headings but must not cut names
        table.add_column(key.rpartition(".")[2], min_width=max(len(dict(row.axes)[key]) for row in rows))
    table.add_column("done", justify="right", min_width=3)
    for quantity in quantities:
        table.add_column(f"{quantity.label} [{quantity.unit}]", justify="right", min_width=5)
    for row in rows:
        axes = dict(row.axes)
        table.add_row(
            *(axes[key] for key in varied),
            f"{row.completed}/{row.runs}",
            *(text_of(quantity, row.numbers[quantity.path]) for quantity in quantities),
        )
    console = PlainConsole()
    console.print(table)
    for ending in dict.fromkeys(ending for row in rows for ending in row.endings):
        count = sum(row.runs - row.completed for row in rows if ending in row.endings)
        console.print(f"{ending}: {count} runs", soft_wrap=True)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)
