"""`offtrack compare` and `offtrack sweep`: make grids of runs; and the options that commands of studies share."""

import dataclasses
import functools
import inspect
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from offtrack.commands import console as ui
from offtrack.studies.case import Outcome, Settings, listed, parameters_beside, seeds_of
from offtrack.studies.draws import Sensitivity, analysed, analysis_json
from offtrack.studies.pool import Executor, RunOptions
from offtrack.studies.run_study import compare_runs, run_study, standing_of
from offtrack.studies.study import TRAILER, Study, axes_of, load_study, settings_of, subject_of
from offtrack.studies.study_page import sensitivity_table
from offtrack.studies.table import Row, shown_quantities, text_of
from scenarios.catalogue import resolve
from scenarios.processes import MOST_JOBS, default_jobs
from vehicle.foundation.quantity import check_number
from vehicle.foundation.user_file import shown

Jobs = Annotated[int | None, typer.Option(help="Number of parallel runs.", show_default="one per core")]
Timeout = Annotated[
    float | None, typer.Option(help="Longest time of a run [s]; one that takes longer fails.", show_default="no limit")
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
    typer.Option(
        help="Output directory; an existing study is resumed.", show_default="runs/COMMAND-NAME-N; the same study's own"
    ),
]
OnlyStatus = Annotated[
    bool, typer.Option("--status", help="Print how many runs are finished, and how long the rest takes; run nothing.")
]
Where = Annotated[
    list[str] | None, typer.Option(metavar="KEY=VALUE", help="Make the runs with this value again. May be repeated.")
]


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of a command that makes the runs of a study; :func:`takes_study_options` gives them to a command."""

    jobs: Jobs = None
    timeout: Timeout = None
    scheduler: Scheduler = None
    job_queue: JobQueue = None
    patience: Patience = 60.0
    where: Where = None
    out: Out = None
    status: OnlyStatus = False
    quiet: ui.Quiet = False
    as_json: ui.AsJson = False

    def check(self) -> None:
        """Refuse numbers beyond their limits, and options that do not go together.

        Raises:
            ValueError: one line.
        """
        check_number("--jobs", self.jobs, 1, MOST_JOBS)
        check_number("--timeout", self.timeout, 1.0, 1e6, "s")
        check_number("--patience", self.patience, 1.0, 1e6, "s")
        if self.scheduler is not None and self.job_queue is not None:
            raise ValueError("--scheduler and --dask-jobqueue: choose one")
        if self.scheduler is not None and self.jobs is not None:
            raise ValueError("--jobs: leave it out with --scheduler: workers make as many runs as they have threads")
        if not re.fullmatch(r"\w+://.+:\d+|.*\.json", self.scheduler or ".json"):
            address = "expected an address such as tcp://host:8786, or a file (.json)"
            raise ValueError(f"--scheduler {shown(str(self.scheduler))}: {address}")
        if self.job_queue is not None and self.jobs is None:
            raise ValueError("--dask-jobqueue: needs --jobs, the number of jobs")

    @contextmanager
    def opened(self, title: str) -> Iterator[RunOptions]:
        """How to make the runs, with a progress bar of this title; a cluster is connected meanwhile.

        Raises:
            ValueError: one line, for a value of ``--where`` that is none, or a cluster that does not answer.
        """
        again, jobs = settings_of(self.where or [], "--where"), self.jobs or default_jobs()
        shown = not (self.quiet or self.as_json)
        with ui.continuable(), ui.progress_display(shown=shown) as bar, self._executor(jobs) as executor:
            yield RunOptions(
                jobs=jobs,
                timeout=self.timeout,
                executor=executor,
                again=again,
                progress=ui.progress_bar(bar, title),
                remark=ui.remark,
                announce=ui.remark if shown else lambda line: None,
            )

    def tell_status(self, title: str, study: Study) -> None:
        """Print how far a study has come."""
        standing = standing_of(title, study, self.out, self.jobs or default_jobs())
        fields = dataclasses.asdict(standing) | {"directory": str(standing.directory)}
        ui.answer(fields, lambda: typer.echo(standing), as_json=self.as_json)

    @contextmanager
    def _executor(self, jobs: int) -> Iterator[Executor | None]:
        """Executor of the cluster; None without one."""
        if self.scheduler is None and self.job_queue is None:
            yield None
            return
        from offtrack.studies.cluster_executor import DaskExecutor, connected, queued

        if self.scheduler is not None:
            open_client = partial(connected, self.scheduler)
        else:
            assert self.job_queue is not None
            open_client = partial(queued, self.job_queue, jobs)
        waits, timeout = self.job_queue is not None, self.timeout
        with DaskExecutor(
            open_client, waits=waits, timeout=timeout, patience=self.patience, remark=ui.remark
        ) as executor:
            yield executor.results


def takes_study_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command with every field of `StudyOptions` as an option, in place of its last parameter, ``options``.

    Wrong options end in one line.
    """
    signature, fields = inspect.signature(command), dataclasses.fields(StudyOptions)
    *own, _ = signature.parameters.values()
    kind = inspect.Parameter.KEYWORD_ONLY
    shared = [inspect.Parameter(one.name, kind, default=one.default, annotation=one.type) for one in fields]
    parameters = [*own, *shared]

    @functools.wraps(command)
    def expanded(**values: Any) -> None:
        options = StudyOptions(**{field.name: values.pop(field.name) for field in fields})
        options.check()
        command(**values, options=options)

    del expanded.__wrapped__  # its signature is not this one's
    expanded.__annotations__ = {one.name: one.annotation for one in parameters}
    # read by inspect.signature, and so by typer; typeshed does not know it
    expanded.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return expanded


TextColumn = tuple[str, list[str]]  # heading and cells


def plain(row: Row) -> dict[str, object]:
    """A row as JSON has it."""
    return {
        "axes": dict(row.axes),
        "runs": row.runs,
        "completed": row.completed,
        "endings": list(row.endings),
        **row.numbers,
    }


def print_rows(rows: Sequence[Row], directory: Path) -> None:
    """Print a table of a study's points with their numbers, as many as the terminal is wide."""
    quantities = shown_quantities(rows)
    varied = [key for key, _ in rows[0].axes if len({dict(row.axes)[key] for row in rows}) > 1]
    same = [f"{key} = {value}" for key, value in rows[0].axes if key not in varied]
    columns = [(key.rpartition(".")[2], [dict(row.axes)[key] for row in rows]) for key in varied]
    columns.append(("done", [f"{row.completed}/{row.runs}" for row in rows]))
    numbers = [(f"{q.label} [{q.unit}]", [text_of(q, row.numbers[q.path]) for row in rows]) for q in quantities]
    console = ui.PlainConsole()
    shown = fitting(columns, numbers, console.width)
    table = Table(padding=(0, 0))
    for k, (heading, cells) in enumerate([*columns, *shown]):
        table.add_column(heading, justify="left" if k < len(varied) else "right", width=least_width(heading, cells))
    for row in zip(*(cells for _, cells in (*columns, *shown)), strict=True):
        table.add_row(*row)
    if same:
        console.print(f"All runs: {', '.join(same)}", soft_wrap=True)
    console.print(table)
    if left_out := [heading for heading, _ in numbers[len(shown) :]]:
        console.print(f"Left out, as the terminal is narrow: {', '.join(left_out)}", soft_wrap=True)
    for ending in dict.fromkeys(ending for row in rows for ending in row.endings):
        count = sum(row.runs - row.completed for row in rows if ending in row.endings)
        console.print(f"{ending}: {count} runs", soft_wrap=True)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)


def fitting(columns: Sequence[TextColumn], numbers: Sequence[TextColumn], width: int) -> Sequence[TextColumn]:
    """As many of the numbers, from the first on, as fit beside the other columns on a terminal; at least one."""
    for count in range(len(numbers), 1, -1):
        shown = [*columns, *numbers[:count]]
        if sum(least_width(heading, cells) + 1 for heading, cells in shown) + 1 <= width:
            return numbers[:count]
    return numbers[:1]


def least_width(heading: str, cells: Sequence[str]) -> int:
    """Least width of a column that cuts neither a number nor a word of its heading."""
    return max(map(len, (*heading.split(), *cells)))


def sensitivity_of(design: Sensitivity, outcomes: Sequence[Outcome]) -> dict[Settings, dict[str, Any]]:
    """The entry ``sensitivity`` of each point's row in JSON."""
    points: dict[Settings, dict[str, Any]] = {}
    for analysis in analysed(design, outcomes):
        points.setdefault(analysis.axes, {"sensitivity": []})["sensitivity"].append(
            analysis_json(analysis, design.method)
        )
    return points


def print_sensitivity(design: Sensitivity, outcomes: Sequence[Outcome]) -> None:
    """Print the table of the page: a row for each point, quantity and key."""
    console, analyses = ui.PlainConsole(), analysed(design, outcomes)
    console.print(ui.page_table(sensitivity_table(design, analyses, brief=True), "Sensitivity", padding=(0, 0)))
    left_out = dict.fromkeys(title for analysis in analyses for title in analysis.left_out)
    for title in list(left_out)[:10]:
        console.print(f"left out: {title}", soft_wrap=True)
    if len(left_out) > 10:
        console.print(f"left out: {len(left_out) - 10} more, see the report", soft_wrap=True)


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
_REASONS = 10  # at most so many are printed


@takes_study_options
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
        str | None,
        typer.Option(
            "--off-tracking",
            "--slip-estimators",
            help="Comma-separated off-tracking sources, or slip estimators.",
            show_default="truth",
        ),
    ] = None,
    settings: ui.SettingsOfAll = None,
    vary: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE,VALUE,…", help="Further axis of the grid. May be repeated.")
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds, as 1-5 or 1,2,7; every combination is run with each.")] = "1",
    *,
    options: StudyOptions,
) -> None:
    """Compare trailer steering laws, a rover's slip compensations, or finished runs, and print a table.

    Finished runs are saved at once: repeat the command to continue an interrupted study. A law that does not use the
    off-tracking runs with the first source only.
    """
    if len(targets) > 1 or Path(targets[0]).is_dir():
        _compare_runs([Path(target) for target in targets], options)
        return
    (scenario,) = targets
    subject, fixed = subject_of(scenario), settings_of(settings or [], "--set")
    given = {subject.compared: ("--controllers", controllers), subject.estimator: ("--off-tracking", estimators)}
    axes = {key: listed(text, option) for key, (option, text) in given.items() if text is not None}
    varied = axes_of(vary or [])
    if twice := set(axes) & set(varied):
        raise ValueError(f"--vary {min(twice)}: is {given[min(twice)][0]} as well: choose one")
    # what is set for all runs takes the place of what is usually compared
    usual = {subject.compared: subject.controllers, subject.estimator: ("truth",)}
    usual = {key: (dict(fixed)[key],) if key in dict(fixed) else values for key, values in usual.items()}
    axes = usual | axes | varied
    for law in axes[subject.compared] if subject is TRAILER else ():
        resolve("--controllers", parameters_beside(law)[0], subject.parts)
    for source in axes[subject.estimator]:
        resolve("--off-tracking", source, subject.estimators)
    study = Study(scenario=scenario, fixed=fixed, axes=axes, seeds=seeds_of(seeds))
    _run_study(f"compare-{Path(scenario).stem if scenario.endswith('.toml') else scenario}", study, options)


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

    Finished runs are saved at once: repeat the command to continue an interrupted study. --scheduler and
    --dask-jobqueue make the runs on the machines of a Dask cluster or of a job queue.
    """
    title = f"sweep-{study_file.stem}"
    study = load_study(study_file)
    _run_study(title, study, options)


def _compare_runs(runs: Sequence[Path], options: StudyOptions) -> None:
    if len(runs) < 2:
        raise ValueError(f"{runs[0]}: is a directory: give two or more finished runs, or a scenario")
    title = f"compare-{'-'.join(run.resolve().name for run in runs)}"[:_LONGEST_NAME]
    made = compare_runs(title, runs, options.out)
    show, numbers = partial(print_rows, made.rows, made.directory), [plain(row) for row in made.rows]
    ui.answer(numbers, show, quiet=options.quiet, as_json=options.as_json)


def _run_study(title: str, study: Study, options: StudyOptions) -> None:
    """Run the study, write its directory and print its table."""
    if options.status:
        options.tell_status(title, study)
        return
    with options.opened(title) as run_options:
        directory, outcomes, rows = run_study(title, study, options.out, run_options)
    design = study.draws.sensitivity
    if options.as_json:
        analyses = sensitivity_of(design, outcomes) if design else {}
        typer.echo(json.dumps([plain(row) | analyses.get(row.axes, {}) for row in rows], indent=2))
    elif not options.quiet:
        print_rows(rows, directory)
        if design:
            print_sensitivity(design, outcomes)
    endings = Counter(str(outcome.numbers["outcome"]) for outcome in outcomes)
    if failed := {ending: count for ending, count in endings.most_common() if ending.startswith("failed")}:
        if options.quiet or options.as_json:
            for ending, count in list(failed.items())[:_REASONS]:
                ui.remark(f"{ending}: {count} runs")
        raise typer.Exit(ui.CHECK_FAILED)
