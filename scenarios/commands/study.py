"""`offtrack compare` and `offtrack sweep`: grids of runs with tables and reports."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenarios.commands.console import CHECK_FAILED, one_line_errors
from scenarios.commands.sensitivity import print_sensitivity, sensitivity_of
from scenarios.commands.study_options import StudyOptions, takes_study_options
from scenarios.commands.study_status import print_status
from scenarios.commands.study_table import plain, print_rows

if TYPE_CHECKING:
    from scenarios.studies.study import Study

COMPARE_EXAMPLES = (
    "Examples: offtrack compare roundabout --controllers none,command_steer,path_preview --off-tracking truth   "
    "offtrack compare roundabout-low-friction --controllers path_preview,mpc --off-tracking truth,viso_ot "
    "--vary surface.friction=0.8,0.5,0.3,0.2 --seeds 1-5   "
    "offtrack compare roundabout --controllers path_preview@tuned.toml,path_preview,mpc   "
    "offtrack compare rover-slope --slip-estimators truth,ftrace_plus   "
    "offtrack compare runs/roundabout-1 runs/roundabout-2"
)
SWEEP_EXAMPLES = (
    'Example of a STUDY.toml:   scenario = "roundabout"   seeds = [1, 2, 3]   [set]   off_tracking = "truth"   '
    'surface.cross_fall = 0.025   [vary]   trailer_steering = ["path_preview", "mpc"]   surface.friction = [0.8, 0.3]'
)

_LONGEST_NAME = 100  # of a directory


@partial(takes_study_options, joined=False)
def compare(
    targets: Annotated[
        list[str],
        typer.Argument(
            metavar="SCENARIO | RUN RUN…",
            help="Name of a scenario (see: offtrack scenarios) or a TOML file; or two or more directories of finished "
            "runs, which are compared as they are.",
        ),
    ],
    controllers: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated trailer steering laws; for a rover, values of slip_compensation. "
            "LAW@FILE.toml is a law with the parameters of a file, such as the tuned.toml of offtrack tune.",
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
    *,
    options: StudyOptions,
) -> None:
    """Compare trailer steering laws, a rover's slip compensations, or finished runs, and print a table.

    Finished runs are saved at once: repeat the command to continue an interrupted study. A law that does not use the
    off-tracking runs with the first source only.
    """
    from scenarios.catalogue import resolve
    from scenarios.studies.case import listed, seeds_of
    from scenarios.studies.part_parameters import parameters_beside
    from scenarios.studies.study import Study, settings_of
    from scenarios.studies.subject import TRAILER, subject_of

    if len(targets) > 1 or Path(targets[0]).is_dir():
        _compare_runs([Path(target) for target in targets], options)
        return
    (scenario,) = targets
    with one_line_errors():
        subject = subject_of(scenario)
        chosen = subject.controllers if controllers is None else listed(controllers, "--controllers")
        sources = listed(estimators, "--off-tracking")
        for law in chosen if subject is TRAILER else ():
            resolve("--controllers", parameters_beside(law)[0], subject.parts)
        for source in sources:
            resolve("--off-tracking", source, subject.estimators)
        axes = {subject.compared: chosen, subject.estimator: sources}
        axes |= {key: listed(values, f"--vary {key}") for key, values in settings_of(vary or [], "--vary")}
        study = Study(scenario=scenario, fixed=settings_of(settings or [], "--set"), axes=axes, seeds=seeds_of(seeds))
    _run_study(f"compare-{_short(scenario)}", study, options)


@takes_study_options
def sweep(
    study_file: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY.toml",
            help="TOML file: scenario, seeds, table [set] of settings, table [vary] of value lists, by dotted keys; "
            "for values drawn at random [sample], [draw], [limits] and [stop]; [sensitivity] in place of [sample].",
        ),
    ],
    *,
    options: StudyOptions,
) -> None:
    """Run every combination of a study's values with every seed, and print a table.

    Finished runs are saved at once: repeat the command to continue an interrupted study. With --join any number of
    commands share the work, for example one on each machine of a cluster (sbatch --array) in one shared folder.
    """
    from scenarios.studies.study import load_study

    title = f"sweep-{study_file.stem}"
    with one_line_errors():
        study = load_study(study_file)
        if options.status:
            print_status(study, options.directory(title), as_json=options.as_json)
            return
    _run_study(title, study, options)


def _compare_runs(runs: Sequence[Path], options: StudyOptions) -> None:
    from scenarios.studies.finished_runs import compare_runs

    with one_line_errors():
        if len(runs) < 2:
            raise ValueError(f"{runs[0]}: is a directory: give two or more finished runs, or a scenario")
        directory = options.directory(f"compare-{'-'.join(run.resolve().name for run in runs)}"[:_LONGEST_NAME])
        rows = compare_runs(runs, directory)
    if options.as_json:
        typer.echo(json.dumps([plain(row) for row in rows], indent=2))
    elif not options.quiet:
        print_rows(rows, directory)


def _short(scenario: str) -> str:
    return Path(scenario).stem if scenario.endswith(".toml") else scenario


def _run_study(title: str, study: Study, options: StudyOptions) -> None:
    """Run the study, write its directory and print its table."""
    from scenarios.studies.run_study import run_study

    directory = options.directory(title)
    with one_line_errors(), options.opened(title) as run_options:
        outcomes, rows = run_study(title, study, directory, run_options)
    design = study.draws.sensitivity
    if options.as_json:
        analyses = sensitivity_of(design, outcomes) if design else {}
        typer.echo(json.dumps([plain(row) | analyses.get(row.axes, {}) for row in rows], indent=2))
    elif not options.quiet:
        print_rows(rows, directory)
        if design:
            print_sensitivity(design, outcomes)
    if any(str(outcome.numbers["outcome"]).startswith("failed") for outcome in outcomes):
        raise typer.Exit(CHECK_FAILED)
