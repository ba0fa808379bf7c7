"""`offtrack tune`: tune the parameters of a trailer steering law or rover driver on runs."""

from __future__ import annotations

import importlib.util
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tomli_w
import typer
from rich.table import Table

from offtrack.commands.console import (
    PlainConsole,
    Quiet,
    ScenarioName,
    one_line_errors,
    progress_bar,
    progress_display,
    remark,
)
from scenarios.processes import MOST_JOBS
from vehicle.foundation.user_file import FileKind, read_text

if TYPE_CHECKING:
    from offtrack.studies.tuning import Trial, Tuning

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
    from offtrack.studies.files import CELLS, check_study_directory, opened_study
    from offtrack.studies.pool import run_cases
    from offtrack.studies.study import subject_of
    from offtrack.studies.trial_storage import JOURNAL, check_storage
    from offtrack.studies.tuning import (
        chosen,
        finished,
        former,
        in_database,
        objective_means,
        optimise,
        with_parameters,
    )
    from offtrack.studies.tuning_page import tuning_page
    from scenarios.processes import default_jobs
    from scenarios.results.atomic_files import replaced
    from vehicle.foundation.quantity import check_number

    with one_line_errors():
        check_number("--trials", trials, 1, 100_000)
        check_number("--jobs", jobs, 1, MOST_JOBS)
        check_number("--seed", seed, 0, 2**31)
        if importlib.util.find_spec("optuna") is None:
            raise ValueError("tuning needs Optuna; install it with: pip install 'offtrack[tune]'")
        subject = subject_of(scenario)
        controller = controller or subject.part
        sets = ((vary or [], seeds), (judge_vary or vary or [], judge_seeds))
        names = objectives or ",".join(subject.objectives)
        tuning = _tuning(scenario, controller, names, ranges or [], settings or [], sets)
        directory = out or Path("runs") / f"tune-{Path(scenario).stem}-{controller.rpartition(':')[2]}"
        if not (directory / JOURNAL).is_file():
            check_study_directory(directory, _FILE)
        description = _description(tuning)
        _check_same(directory / _FILE, description)
        if storage is not None:
            check_storage(storage)
            tuning = in_database(tuning, storage)
        unusable = former(tuning, directory)
        with opened_study(directory, _FILE, description):
            if unusable:
                remark(f"{unusable} earlier trials are not used: the law, a file or offtrack has changed since")
            workers = jobs or default_jobs()
            with progress_display(shown=not (quiet or as_json)) as bar:
                progress = progress_bar(bar, f"tune {controller}")
                results = optimise(tuning, directory, trials=trials, jobs=workers, seed=seed, progress=progress)
                progress(trials, trials)
                best, judged = chosen(results), {}
                candidates = {"defaults": {}, "tuned": best.parameters}
                judging = progress_bar(bar, "judge")
                for done, (name, parameters) in enumerate(candidates.items()):
                    judging(done, len(candidates))
                    cases = with_parameters(tuning.judged_on, parameters).cases()
                    outcomes = run_cases(cases, directory / CELLS, jobs=workers, remark=remark)
                    judged[name] = objective_means(tuning.objectives, outcomes)
                judging(len(candidates), len(candidates))
            _write(tuning, finished(tuning, directory), best, directory)
            replaced(directory / "report.html", tuning_page(tuning, results, best, judged))
    if as_json:
        typer.echo(json.dumps(_plain(tuning, best, judged), indent=2))
    elif not quiet:
        _print(tuning, best, judged, directory)


def _tuning(
    scenario: str,
    controller: str,
    objectives: str,
    ranges: list[str],
    settings: list[str],
    sets: tuple[tuple[list[str], str], tuple[list[str], str]],
) -> Tuning:
    """The tuning task of the options; ``sets`` holds axes and seeds of the tuning set and the judging set.

    Raises:
        ValueError: one line, for the first invalid option.
    """
    from offtrack.studies.case import identities, listed, seeds_of
    from offtrack.studies.study import Study, settings_of, subject_of
    from offtrack.studies.table import QUANTITIES
    from offtrack.studies.tuning import Tuning, defaults_of, ranges_of
    from scenarios.catalogue import resolve
    from vehicle.foundation.parameter_file import nearest

    subject = subject_of(scenario)
    law = resolve("--controller", controller, subject.parts)
    searched = ranges_of(controller, law, ranges)
    fixed = (*settings_of(settings, "--set"), (subject.tuned, controller))
    studies = []
    for axes, seeds in sets:
        values = {key: listed(text, f"--vary {key}") for key, text in settings_of(axes, "--vary")}
        study = Study(scenario=scenario, fixed=fixed, axes=values, seeds=seeds_of(seeds))
        identities(study.cases())  # refuses invalid scenarios
        studies.append(study)
    names = listed(objectives, "--objectives")
    paths = tuple(quantity.path for quantity in QUANTITIES)
    for name in names:
        if name not in paths:
            raise ValueError(f"--objectives {name}: no such summary metric{nearest(name, paths)}")
    known = defaults_of(law)
    return Tuning(
        law=controller,
        ranges=searched,
        defaults={name: known[name] for name in searched if name in known},
        objectives=names,
        tuned_on=studies[0],
        judged_on=studies[1],
        identity=studies[0].identity(),
    )


def _description(tuning: Tuning) -> str:
    """Text that identifies the task of a journal."""
    table: dict[str, Any] = {
        "law": tuning.law,
        "objectives": list(tuning.objectives),
        "range": {name: [range_.low, range_.high] for name, range_ in tuning.ranges.items()},
    }
    return tomli_w.dumps(table) + f"\n# tuned on\n{_commented(tuning.tuned_on.to_toml())}"


def _commented(text: str) -> str:
    return "".join(f"# {line}\n" for line in text.splitlines())


def _check_same(path: Path, description: str) -> None:
    """Refuse a directory with the trials of another tuning task.

    Raises:
        ValueError: one line.
    """
    if os.path.lexists(path) and read_text(path, FileKind.RECORD) != description:
        raise ValueError(f"{path} belongs to another tuning task: choose another --out, or the same options")


def _write(tuning: Tuning, trials: list[Trial], best: Trial, directory: Path) -> None:
    from offtrack.studies.tuning import with_parameters
    from scenarios.options.scenario import load_any_scenario
    from scenarios.results.atomic_files import replaced

    case = with_parameters(tuning.judged_on, best.parameters).cases()[0]
    fixed = [f"{key}={value}" for key, value in case.fixed]
    replaced(directory / "tuned.toml", load_any_scenario(case.scenario, fixed).to_toml())
    lines = [",".join(["trial", *tuning.ranges, *tuning.objectives])]
    for trial in trials:
        numbers = [*(trial.parameters[name] for name in tuning.ranges), *trial.values]
        lines.append(",".join([str(trial.number), *map(repr, numbers)]))
    replaced(directory / "trials.csv", "\n".join(lines) + "\n")


def _plain(tuning: Tuning, best: Trial, judged: dict[str, tuple[float, ...]]) -> dict[str, Any]:
    return {
        "law": tuning.law,
        "parameters": dict(best.parameters),
        "tuned_on": dict(zip(tuning.objectives, best.values, strict=True)),
        "judged": {name: dict(zip(tuning.objectives, values, strict=True)) for name, values in judged.items()},
    }


def _print(tuning: Tuning, best: Trial, judged: dict[str, tuple[float, ...]], directory: Path) -> None:
    from offtrack.studies.study import subject_of

    table = Table(title=f"{tuning.law} on the judging runs", title_justify="left")
    table.add_column("")
    for name in tuning.objectives:
        table.add_column(name, justify="right")
    for name, values in judged.items():
        table.add_row(name, *(f"{value:.4g}" for value in values))
    console = PlainConsole()
    console.print(table)
    for name, value in best.parameters.items():
        console.print(f"{subject_of(tuning.tuned_on.scenario).parameters}.{name} = {value:.4g}")
    console.print(f"Run it: offtrack run {directory / 'tuned.toml'}", soft_wrap=True)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)
