"""Options that the commands of studies share: how their runs are made, and where they are kept."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from offtrack.commands.console import Quiet, one_line_errors, progress_bar, progress_display, remark
from scenarios.processes import MOST_JOBS

if TYPE_CHECKING:
    from offtrack.studies.case import Settings
    from offtrack.studies.pool import Executor, RunOptions

_JOIN = ("join", "lease", "status", "where")  # options of commands that others may join
Jobs = Annotated[int | None, typer.Option(help="Number of parallel runs.", show_default="one per core")]
Timeout = Annotated[
    float | None,
    typer.Option(help="Longest time of a run [s]; one that takes longer fails.", show_default="no limit"),
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
AsJson = Annotated[bool, typer.Option("--json", help="Print only the results, as JSON.")]
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


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of a command that makes the runs of a study; :func:`takes_study_options` gives them to a command."""

    jobs: Jobs = None
    timeout: Timeout = None
    scheduler: Scheduler = None
    job_queue: JobQueue = None
    patience: Patience = 60.0
    join: Join = False
    lease: Lease = 30.0
    status: Status = False
    where: Where = None
    out: Out = None
    quiet: Quiet = False
    as_json: AsJson = False

    def check(self) -> None:
        """Refuse numbers beyond their limits, and options that do not go together.

        Raises:
            ValueError: one line.
        """
        from vehicle.foundation.quantity import check_number

        check_number("--jobs", self.jobs, 1, MOST_JOBS)
        check_number("--timeout", self.timeout, 1.0, 1e6, "s")
        check_number("--lease", self.lease, 1.0, 1e5, "s")
        check_number("--patience", self.patience, 1.0, 1e6, "s")
        if self.scheduler is not None and self.job_queue is not None:
            raise ValueError("--scheduler and --dask-jobqueue: choose one")
        if self.join and (self.scheduler or self.job_queue):
            raise ValueError("--join and a Dask cluster: choose one")
        if self.scheduler is not None and self.jobs is not None:
            raise ValueError("--jobs: leave it out with --scheduler: workers make as many runs as they have threads")
        if self.job_queue is not None and self.jobs is None:
            raise ValueError("--dask-jobqueue: needs --jobs, the number of jobs")

    def directory(self, title: str) -> Path:
        """Directory of the study."""
        return self.out or Path("runs") / title

    @property
    def again(self) -> Settings:
        """Values of runs that are made again.

        Raises:
            ValueError: one line, if they are no keys with values.
        """
        from offtrack.studies.study import settings_of

        return settings_of(self.where or [], "--where")

    @contextmanager
    def opened(self, title: str) -> Iterator[RunOptions]:
        """How to make the runs, with a progress bar of this title; a cluster is connected meanwhile.

        Raises:
            ValueError: one line, for a value of ``--where`` that is none, or a cluster that does not answer.
        """
        from offtrack.studies.pool import RunOptions
        from scenarios.processes import default_jobs

        again, jobs = self.again, self.jobs or default_jobs()
        with progress_display(shown=not (self.quiet or self.as_json)) as bar, self._executor(jobs) as executor:
            yield RunOptions(
                jobs=jobs,
                timeout=self.timeout,
                join=self.lease if self.join else None,
                executor=executor,
                again=again,
                progress=progress_bar(bar, title),
                remark=remark,
            )

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
        with DaskExecutor(open_client, waits=waits, timeout=timeout, patience=self.patience, remark=remark) as executor:
            yield executor


def takes_study_options(command: Callable[..., None], *, joined: bool = True) -> Callable[..., None]:
    """The command with every field of `StudyOptions` as an option, in place of its last parameter, ``options``.

    ``joined``: other commands may join it; else it has no options for that. Wrong options end in one line.
    """
    signature = inspect.signature(command, eval_str=True)
    *own, _ = signature.parameters.values()
    hints = get_type_hints(StudyOptions, include_extras=True)
    fields = [field for field in dataclasses.fields(StudyOptions) if joined or field.name not in _JOIN]
    parameters = [*own, *map(partial(_parameter, hints), fields)]

    @functools.wraps(command)
    def expanded(**values: Any) -> None:
        options = StudyOptions(**{field.name: values.pop(field.name) for field in fields})
        with one_line_errors():
            options.check()
        command(**values, options=options)

    del expanded.__wrapped__  # its signature is not this one's
    expanded.__annotations__ = {one.name: one.annotation for one in parameters}
    # read by inspect.signature, and so by typer; typeshed does not know it
    expanded.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return expanded


def _parameter(hints: dict[str, Any], field: dataclasses.Field[Any]) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(field.name, kind, default=field.default, annotation=hints[field.name])
