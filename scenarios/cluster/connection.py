"""Clients of Dask clusters: one that runs already, or one that a job queue starts."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import re
import shlex
import shutil
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from vehicle.parameter_file import nearest
from vehicle.user_file import FileKind, read_text, shown

if TYPE_CHECKING:
    from distributed import Client

_ANSWER: Final = 15.0  # of a scheduler [s]
_JOB_QUEUES: Final = {  # classes of dask-jobqueue by their names in its configuration
    "slurm": "dask_jobqueue:SLURMCluster",
    "pbs": "dask_jobqueue:PBSCluster",
    "sge": "dask_jobqueue:SGECluster",
    "lsf": "dask_jobqueue:LSFCluster",
    "moab": "dask_jobqueue:MoabCluster",
    "oar": "dask_jobqueue:OARCluster",
    "htcondor": "dask_jobqueue:HTCondorCluster",
    "local": "dask_jobqueue.local:LocalCluster",
}


@contextmanager
def connected(scheduler: str) -> Iterator[Client]:
    """Client of the scheduler at an address, or of that which a scheduler file (.json) names.

    Raises:
        ValueError: one line, if nobody answers.
    """
    check_installed("distributed")
    from distributed import Client

    if not (scheduler.endswith(".json") or re.fullmatch(r"\w+://.+:\d+", scheduler)):
        raise ValueError(
            f"--scheduler {shown(scheduler)}: expected an address such as tcp://host:8786, or a file (.json)"
        )
    with _quiet():
        place = {"scheduler_file": scheduler} if scheduler.endswith(".json") else {"address": scheduler}
        try:
            client = Client(**place, timeout=_ANSWER, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            reason = str(error).splitlines()[0] if str(error) else "no answer"
            raise ValueError(
                f"--scheduler {shown(scheduler)}: no Dask scheduler answers there ({shown(reason)}); "
                "start one with 'dask scheduler', and workers with 'dask worker'"
            ) from None
        with client:
            yield client


@contextmanager
def queued(file: Path, jobs: int) -> Iterator[Client]:
    """Client of a cluster of its own, whose workers are ``jobs`` jobs of a queue that the file describes.

    Raises:
        ValueError: one line, for a wrong file, or if no job can be submitted.
    """
    check_installed("distributed", "dask_jobqueue")
    kind, keywords = job_queue(file)
    from distributed import Client

    module, _, name = _JOB_QUEUES[kind].partition(":")
    with _quiet():
        try:
            cluster = getattr(importlib.import_module(module), name)(**keywords)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{file}: {kind}: {shown(str(error).splitlines()[0])}") from None
        with ExitStack() as stack:
            stack.callback(_close, cluster)
            _submit(cluster, jobs, f"{file}: {kind}")
            yield stack.enter_context(Client(cluster, timeout=_ANSWER, set_as_default=False))


def _submit(cluster: Any, jobs: int, where: str) -> None:
    """Submit jobs.

    Raises:
        ValueError: one line, if none can be submitted.
    """
    command = [*shlex.split(cluster.job_cls.submit_command or ""), ""][0]
    if command and shutil.which(command) is None:
        raise ValueError(f"{where}: no job can be submitted here: there is no command {command}")
    cluster.scale(jobs=jobs)
    cluster.sync(cluster._correct_state)  # until all have been submitted; their errors are only logged
    if not any(job.status.name == "running" for job in cluster.workers.values()):
        raise ValueError(f"{where}: the queue refuses the jobs: try {command or 'one'} by hand")


def _close(cluster: Any) -> None:
    with suppress(AssertionError):  # of jobs that could not be submitted
        cluster.close()


def job_queue(file: Path) -> tuple[str, dict[str, Any]]:
    """Kind of a job queue and the keywords of its cluster, from a configuration file of dask-jobqueue.

    Raises:
        ValueError: one line, naming file and key.
    """
    import yaml

    try:
        table: Any = yaml.safe_load(read_text(file, FileKind.STUDY))
    except yaml.YAMLError as error:
        raise ValueError(f"{file}: not YAML: {shown(str(error).splitlines()[0])}") from None
    queues = table.get("jobqueue") if isinstance(table, dict) else None
    if not isinstance(queues, dict) or len(queues) != 1:
        raise ValueError(f"{file}: expected 'jobqueue:' with one queue below it, such as 'slurm:'")
    ((kind, keywords),) = queues.items()
    if kind not in _JOB_QUEUES:
        raise ValueError(f"{file}: jobqueue.{shown(str(kind))}{nearest(str(kind), _JOB_QUEUES)}")
    if not isinstance(keywords, dict) or not all(isinstance(key, str) for key in keywords):
        raise ValueError(f"{file}: jobqueue.{kind} must be a table of cores, memory and so on")
    return kind, {key.replace("-", "_"): value for key, value in keywords.items()}


def check_installed(*modules: str) -> None:
    """Refuse to go on without the extra.

    Raises:
        ValueError: one line.
    """
    if any(importlib.util.find_spec(module) is None for module in modules):
        raise ValueError("a Dask cluster needs further packages; install them with: pip install 'offtrack[cluster]'")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's log, which tells of every lost worker, from the terminal."""
    names = [
        name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "asyncio", "tornado")
    ]
    before = {name: logging.getLogger(name).level for name in names}
    try:
        for name in names:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)
