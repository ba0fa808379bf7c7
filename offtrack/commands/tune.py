"""`offtrack tune`: tune the parameters of a trailer steering law or rover driver on runs."""

from __future__ import annotations

import importlib.util
import json
import os
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from offtrack.commands.console import (
    PlainConsole,
    Quiet,
    ScenarioName,
    check_number,
    one_line_errors,
    progress_bar,
    progress_display,
    remark,
)
from offtrack.studies.pool import RunOptions, run_cases
from offtrack.studies.run_study import CELLS, check_study_directory, opened_study
from offtrack.studies.study import subject_of
from offtrack.studies.tuning import (
    Trial,
    Tuning,
    chosen,
    description,
    objective_means,
    tuning_of,
    with_parameters,
    write_result,
)
from offtrack.studies.tuning_page import tuning_page
from scenarios.processes import MOST_JOBS, default_jobs
from scenarios.results.atomic_files import replaced
from vehicle.foundation.user_file import FileKind, read_text

EXAMPLES = (
    "Examples: offtrack tune roundabout --controller path_preview --trials 40   "
    "offtrack tune rover-slope --set slip_estimator=truth --trials 10   "
    "offtrack tune roundabout-low-friction --controller path_preview --trials 100 "
    "--objectives off_tracking.true_rms_m,steer.max_rate_deg_s --vary surface.friction=0.8,0.2 "
    "--judge-vary surface.friction=0.5,0.3   Then: offtrack run runs/tune-roundabout-path_preview/tuned.toml"
)
_FILE = "tuning.toml"  # identifies the task of a directory


def tune(
    scenario: ScenarioName,
    controller: Annotated[
        str | None,
        typer.Option(
            help="Trailer steering law or rover driver, or package.module:Name.", show_default="path_preview; path"
        ),
    ] = None,
    trials: Annotated[int, typer.Option(help="Total number of finished trials, including earlier ones.")] = 40,
    objectives: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated summary metrics to minimise.",
            show_default="true_rms_m and true_max_m of off_tracking; slip.cross_track_rms_m",
        ),
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar="NAME=LOW:HIGH",
            help="Parameter to tune, with its range; by default those that the law declares. May be repeated.",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change a key of the scenario in all runs, e.g. off_tracking=truth. May be repeated.",
        ),
    ] = None,
    vary: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE,…", help="Axis of the grid of tuning runs. May be repeated.")
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds of the tuning runs.")] = "101,102",
    judge_vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE,…", help="Axis of the grid of judging runs. May be repeated.", show_default="as --vary"
        ),
    ] = None,
    judge_seeds: Annotated[str, typer.Option(help="Seeds of the judging runs.")] = "1-3",
    jobs: Annotated[int | None, typer.Option(help="Number of parallel trials.", show_default="one per core")] = None,
    seed: Annotated[int, typer.Option(help="Random seed of the search.")] = 1,
    storage: Annotated[
        str | None,
        typer.Option(
            envvar="OFFTRACK_STORAGE",
            metavar="URL",
            help="Keep the trials in a database that machines share, postgresql://USER@HOST/DATABASE, in place of the "
            "journal. The same command on each machine, with its own --out, works on the same trials.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Output directory; an existing study is resumed.", show_default="runs/tune-SCENARIO-LAW"),
    ] = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the result, as JSON.")] = False,
) -> None:
    """Tune the parameters of a trailer steering law or rover driver on some runs, and judge them on others.

    Finished trials are saved at once: repeat the command to continue an interrupted search. Writes tuned.toml (a
    scenario to run), journal.log (without --storage), trials.csv, and report.html with the trade-off between the
    objectives.
    """
    with one_line_errors():
        check_number("--trials", trials, 1, 100_000)
        check_number("--jobs", jobs, 1, MOST_JOBS)
        check_number("--seed", seed, 0, 2**31)
        if importlib.util.find_spec("optuna") is None:
            raise ValueError("tuning needs Optuna; install it with: pip install 'offtrack[tune]'")
        from offtrack.studies.trials import JOURNAL, database, finished, former, in_database, optimise

        subject = subject_of(scenario)
        controller = controller or subject.part
        sets = ((vary or [], seeds), (judge_vary or vary or [], judge_seeds))
        names = objectives or ",".join(subject.objectives)
        tuning = tuning_of(scenario, controller, names, ranges or [], settings or [], sets)
        directory = out or Path("runs") / f"tune-{Path(scenario).stem}-{controller.rpartition(':')[2]}"
        if not (directory / JOURNAL).is_file():
            check_study_directory(directory, _FILE)
        if os.path.lexists(directory / _FILE) and read_text(directory / _FILE, FileKind.RECORD) != description(tuning):
            raise ValueError(
                f"{directory / _FILE} belongs to another tuning task: choose another --out, or the same options"
            )
        if storage is not None:
            database(storage)  # refuses one that does not answer
            tuning = in_database(tuning, storage)
        unusable = former(tuning, directory)
        with opened_study(directory, _FILE, description(tuning)):
            if unusable:
                remark(f"{unusable} earlier trials are not used: the law, a file or offtrack has changed since")
            workers = jobs or default_jobs()
            with progress_display(shown=not (quiet or as_json)) as bar:
                progress = progress_bar(bar, f"tune {controller}")
                results = optimise(tuning, directory, trials=trials, jobs=workers, seed=seed, progress=progress)
                progress(trials, trials)
                best, compared = chosen(results), {}
                candidates = {"defaults": {}, "tuned": best.parameters}
                comparing = progress_bar(bar, "compare")
                for done, (name, parameters) in enumerate(candidates.items()):
                    comparing(done, len(candidates))
                    cases = with_parameters(tuning.judged_on, parameters).cases()
                    outcomes = run_cases(cases, directory / CELLS, RunOptions(jobs=workers, remark=remark))
                    compared[name] = objective_means(tuning.objectives, outcomes)
                comparing(len(candidates), len(candidates))
            write_result(tuning, finished(tuning, directory), best, directory)
            replaced(directory / "report.html", tuning_page(tuning, results, best, compared))
    if as_json:
        typer.echo(json.dumps(_plain(tuning, best, compared), indent=2))
    elif not quiet:
        _print(tuning, best, compared, directory)


def _plain(tuning: Tuning, best: Trial, compared: dict[str, tuple[float, ...]]) -> dict[str, Any]:
    return {
        "law": tuning.law,
        "parameters": dict(best.parameters),
        "tuned_on": dict(zip(tuning.objectives, best.values, strict=True)),
        "judged": {name: dict(zip(tuning.objectives, values, strict=True)) for name, values in compared.items()},
    }


def _print(tuning: Tuning, best: Trial, compared: dict[str, tuple[float, ...]], directory: Path) -> None:
    table = Table(title=f"{tuning.law} on the judging runs", title_justify="left")
    table.add_column("")
    for name in tuning.objectives:
        table.add_column(name, justify="right")
    for name, values in compared.items():
        table.add_row(name, *(f"{value:.4g}" for value in values))
    console = PlainConsole()
    console.print(table)
    for name, value in best.parameters.items():
        console.print(f"{subject_of(tuning.tuned_on.scenario).parameters}.{name} = {value:.4g}")
    console.print(f"Run it: offtrack run {directory / 'tuned.toml'}", soft_wrap=True)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)
