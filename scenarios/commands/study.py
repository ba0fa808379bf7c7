"""`offtrack compare` and `offtrack sweep`: grids of runs with tables and reports."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from rich.table import Table

from scenarios.commands.console import (
    CHECK_FAILED,
    PlainConsole,
    Quiet,
    check_number,
    one_line_errors,
    progress_bar,
    progress_display,
    remark,
)
from scenarios.commands.sensitivity import print_sensitivity, sensitivity_of
from scenarios.processes import MOST_JOBS

if TYPE_CHECKING:
    from scenarios.studies.case import Settings
    from scenarios.studies.pool import Executor
    from scenarios.studies.study import Study
    from scenarios.studies.table import Row

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

TextColumn = tuple[str, list[str]]  # heading and cells
_LONGEST_NAME = 100  # of a directory
Jobs = Annotated[int | None, typer.Option(help="Number of parallel runs.", show_default="one per core")]
Timeout = Annotated[
    float | None,
    typer.Option(help="Longest time of a run [s]; one that takes longer fails.", show_default="any time"),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Make the runs on the Dask cluster with this scheduler, such as tcp://host:8786, or a scheduler file.",
        show_default=False,
    ),
]
JobQueue = Annotated[
    Path | None,
    typer.Option(
        "--dask-jobqueue",
        metavar="FILE.yaml",
        help="Make the runs in --jobs jobs of a queue (SLURM, PBS, …), as a configuration file of dask-jobqueue says.",
        show_default=False,
    ),
]
Patience = Annotated[
    float, typer.Option(help="Time without any worker of Dask after which the rest of the runs is given up [s].")
]
Out = Annotated[
    Path | None,
    typer.Option(help="Output directory; an existing study is resumed.", show_default=False),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print only the rows, as JSON.")]
Join = Annotated[
    bool,
    typer.Option(
        "--join",
        help="Work on the study together with other commands that have --join, also on other machines with the "
        "same output directory; each makes runs that nobody else has begun.",
    ),
]
Lease = Annotated[
    float,
    typer.Option(help="Time without a sign of life after which --join takes over a run of another command [s]."),
]
Status = Annotated[bool, typer.Option("--status", help="Print what is finished, running and waiting; run nothing.")]
Where = Annotated[
    list[str] | None,
    typer.Option(metavar="KEY=VALUE", help="Make the runs with this value again. May be repeated."),
]


class Cluster(NamedTuple):
    """Options of a Dask cluster; none of them: the runs are made here."""

    scheduler: str | None
    job_queue: Path | None
    patience: float  # [s]

    def check(self, jobs: int | None, *, join: bool) -> None:
        """Refuse options that do not go together.

        Raises:
            ValueError: one line.
        """
        check_number("--patience", self.patience, 1.0, 1e6)
        if self.scheduler is not None and self.job_queue is not None:
            raise ValueError("--scheduler and --dask-jobqueue: choose one")
        if join and (self.scheduler or self.job_queue):
            raise ValueError("--join and a Dask cluster: choose one")
        if self.scheduler is not None and jobs is not None:
            raise ValueError("--jobs: leave it out with --scheduler: workers make as many runs as they have threads")
        if self.job_queue is not None and jobs is None:
            raise ValueError("--dask-jobqueue: needs --jobs, the number of jobs")

    @contextmanager
    def executor(self, jobs: int, timeout: float | None) -> Iterator[Executor | None]:
        """Executor of the cluster; None without one."""
        from scenarios.cluster.connection import connected, queued
        from scenarios.cluster.executor import DaskExecutor

        if self.scheduler is not None:
            open_client = partial(connected, self.scheduler)
        elif self.job_queue is not None:
            open_client = partial(queued, self.job_queue, jobs)
        else:
            yield None
            return
        waits = self.job_queue is not None
        with DaskExecutor(open_client, waits=waits, timeout=timeout, patience=self.patience, remark=remark) as executor:
            yield executor


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
    jobs: Jobs = None,
    timeout: Timeout = None,
    scheduler: Scheduler = None,
    job_queue: JobQueue = None,
    patience: Patience = 60.0,
    out: Out = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
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
        _compare_runs([Path(target) for target in targets], out, quiet=quiet, as_json=as_json)
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
    cluster = Cluster(scheduler, job_queue, patience)
    title = f"compare-{_short(scenario)}"
    _run_study(title, study, jobs=jobs, timeout=timeout, cluster=cluster, out=out, quiet=quiet, as_json=as_json)


def sweep(
    study_file: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY.toml",
            help="TOML file: scenario, seeds, table [set] of settings, table [vary] of value lists, by dotted keys; "
            "for values drawn at random [sample], [draw], [limits] and [stop]; [sensitivity] in place of [sample].",
        ),
    ],
    jobs: Jobs = None,
    timeout: Timeout = None,
    scheduler: Scheduler = None,
    job_queue: JobQueue = None,
    patience: Patience = 60.0,
    join: Join = False,
    lease: Lease = 30.0,
    status: Status = False,
    where: Where = None,
    out: Out = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Run every combination of a study's values with every seed, and print a table.

    Finished runs are saved at once: repeat the command to continue an interrupted study. With --join any number of
    commands share the work, for example one on each machine of a cluster (sbatch --array) in one shared folder.
    """
    from scenarios.studies.study import load_study, settings_of

    title = f"sweep-{study_file.stem}"
    with one_line_errors():
        check_number("--lease", lease, 1.0, 1e5)
        study = load_study(study_file)
        again = settings_of(where or [], "--where")
        if status:
            print_status(study, out or Path("runs") / title, as_json=as_json)
            return
    _run_study(
        title,
        study,
        jobs=jobs,
        timeout=timeout,
        cluster=Cluster(scheduler, job_queue, patience),
        join=lease if join else None,
        again=again,
        out=out,
        quiet=quiet,
        as_json=as_json,
    )


def print_status(study: Study, directory: Path, *, as_json: bool) -> None:
    """Print the state of a study in its directory.

    Raises:
        ValueError: one line, if the directory holds none, or another one.
    """
    from scenarios.studies.files import check_study_directory
    from scenarios.studies.status import silent_for, status

    if not directory.is_dir():
        raise ValueError(f"{directory}: there is no study yet: leave out --status, or name its --out")
    check_study_directory(directory, study.file)
    now = status(study, directory)
    if as_json:
        numbers = {
            "runs": now.runs,
            "finished": now.finished,
            "failed": [{"run": run, "reason": reason} for run, reason in now.failed],
            "running": [
                {"run": run, "host": claim.host, "process": claim.process, "silent_s": round(silent_for(claim), 1)}
                for run, claim in now.running
            ],
            "waiting": now.waiting,
            "spared": now.spared,
            "mean_s": now.mean_seconds,
            "remaining_s": now.remaining_seconds,
            "machines": list(now.machines),
        }
        typer.echo(json.dumps(numbers, indent=2))
        return
    console = PlainConsole()
    table = Table(title=f"{directory}: {now.runs} runs", title_justify="left")
    for heading in ("finished", "running", "waiting", "failed", "mean [s]", "remaining [s]"):
        table.add_column(heading, justify="right")
    seconds = ["-" if value is None else f"{value:.1f}" for value in (now.mean_seconds, now.remaining_seconds)]
    table.add_row(*map(str, (now.finished, len(now.running), now.waiting, len(now.failed))), *seconds)
    console.print(table)
    if study.stop:
        line = f"[stop] spares {now.spared} draws so far, and may spare more of those that wait"
        console.print(line, markup=False, soft_wrap=True)
    for run, claim in now.running:
        line = f"running: {run} on {claim.host}, process {claim.process}, last sign {silent_for(claim):.0f} s ago"
        console.print(line, soft_wrap=True)
    for run, reason in now.failed:
        console.print(f"failed: {run}: {reason.removeprefix('failed: ')}", soft_wrap=True)
    if len(now.machines) > 1:
        console.print(f"made on {', '.join(now.machines)}", soft_wrap=True)


def _compare_runs(runs: Sequence[Path], out: Path | None, *, quiet: bool, as_json: bool) -> None:
    from scenarios.studies.finished_runs import compare_runs

    with one_line_errors():
        if len(runs) < 2:
            raise ValueError(f"{runs[0]}: is a directory: give two or more finished runs, or a scenario")
        directory = out or Path("runs") / f"compare-{'-'.join(run.resolve().name for run in runs)}"[:_LONGEST_NAME]
        rows = compare_runs(runs, directory)
    if as_json:
        typer.echo(json.dumps([_plain(row) for row in rows], indent=2))
    elif not quiet:
        _print(rows, directory)


def _short(scenario: str) -> str:
    return Path(scenario).stem if scenario.endswith(".toml") else scenario


def _run_study(
    title: str,
    study: Study,
    *,
    jobs: int | None,
    timeout: float | None,
    out: Path | None,
    quiet: bool,
    as_json: bool,
    cluster: Cluster,
    join: float | None = None,
    again: Settings = (),
) -> None:
    """Run the study, write its directory and print its table."""
    from scenarios.processes import default_jobs
    from scenarios.studies.run_study import run_study

    directory = out or Path("runs") / title
    with one_line_errors():
        check_number("--jobs", jobs, 1, MOST_JOBS)
        check_number("--timeout", timeout, 1.0, 1e6)
        cluster.check(jobs, join=join is not None)
        with (
            progress_display(shown=not (quiet or as_json)) as bar,
            cluster.executor(jobs or default_jobs(), timeout) as executor,
        ):
            progress = progress_bar(bar, title)
            outcomes, rows = run_study(
                title,
                study,
                directory,
                jobs=jobs or default_jobs(),
                timeout=timeout,
                join=join,
                executor=executor,
                again=again,
                progress=progress,
                remark=remark,
            )
    design = study.draws.sensitivity
    if as_json:
        analyses = sensitivity_of(design, outcomes) if design else {}
        typer.echo(json.dumps([_plain(row) | analyses.get(row.axes, {}) for row in rows], indent=2))
    elif not quiet:
        _print(rows, directory)
        if design:
            print_sensitivity(design, outcomes)
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
    columns = [(key.rpartition(".")[2], [dict(row.axes)[key] for row in rows]) for key in varied]
    columns.append(("done", [f"{row.completed}/{row.runs}" for row in rows]))
    numbers = [(f"{q.label} [{q.unit}]", [text_of(q, row.numbers[q.path]) for row in rows]) for q in quantities]
    console = PlainConsole()
    fitting = _fitting(columns, numbers, console.width)
    table = Table(padding=(0, 0))
    for k, (heading, cells) in enumerate([*columns, *fitting]):
        table.add_column(heading, justify="left" if k < len(varied) else "right", width=_least(heading, cells))
    for row in zip(*(cells for _, cells in (*columns, *fitting)), strict=True):
        table.add_row(*row)
    console.print(table)
    if left_out := [heading for heading, _ in numbers[len(fitting) :]]:
        console.print(f"Left out, as the terminal is narrow: {', '.join(left_out)}", soft_wrap=True)
    for ending in dict.fromkeys(ending for row in rows for ending in row.endings):
        count = sum(row.runs - row.completed for row in rows if ending in row.endings)
        console.print(f"{ending}: {count} runs", soft_wrap=True)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)


def _fitting(columns: Sequence[TextColumn], numbers: Sequence[TextColumn], width: int) -> Sequence[TextColumn]:
    """As many of the numbers, from the first on, as fit beside the other columns on a terminal; at least one."""
    for count in range(len(numbers), 1, -1):
        shown = [*columns, *numbers[:count]]
        if sum(_least(heading, cells) + 1 for heading, cells in shown) + 1 <= width:
            return numbers[:count]
    return numbers[:1]


def _least(heading: str, cells: Sequence[str]) -> int:
    """Least width of a column that cuts neither a number nor a word of its heading."""
    return max(map(len, (*heading.split(), *cells)))
