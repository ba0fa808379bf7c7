"""Runs of a study on a Dask cluster: connection of its client, and the executor that makes the runs.

Workers return the files of their runs, which are saved here. A run whose worker is lost is made by another one.
"""

import importlib
import logging
import queue
import shlex
import shutil
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from offtrack.studies.case import Case
from offtrack.studies.pool import Results, summary_file
from scenarios.extras import check_extra
from scenarios.processes import WorkerDiedError
from scenarios.results.run_directory import replacing
from vehicle.foundation.user_file import FileKind, nearest, read_text, shown

if TYPE_CHECKING:
    from distributed import Client, Future

    from offtrack.studies.cluster_workshop import Delivery, Order, Shipment, Workshop


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
def connected(scheduler: str) -> "Iterator[Client]":
    """Client of the scheduler at an address, or of that which a scheduler file (.json) names.

    Raises:
        ValueError: one line, if nobody answers.
    """
    check_extra("cluster", "a Dask cluster needs", "distributed")
    from distributed import Client

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
def queued(file: Path, jobs: int) -> "Iterator[Client]":
    """Client of a cluster of its own, whose workers are ``jobs`` jobs of a queue that the file describes.

    Raises:
        ValueError: one line, for a wrong file, or if no job can be submitted.
    """
    check_extra("cluster", "a Dask cluster needs", "distributed", "dask_jobqueue")
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
    """Submit jobs."""
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
        table: Any = yaml.safe_load(read_text(file, FileKind.PARAMETERS))
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


_LOOK: Final = 1.0  # between two looks at the cluster [s]
_TRIES: Final = 2  # of a run that Dask gives up, after it was lost with several workers
_REGISTRATIONS: Final = 10  # with the workers, until one succeeds in which none is lost


class DaskExecutor(ExitStack):
    """Makes runs on a Dask cluster, which it reaches when there is something to do, and leaves at its end."""

    def __init__(
        self,
        connect: "Callable[[], AbstractContextManager[Client]]",
        *,
        timeout: float | None,
        patience: float,
        waits: bool,
        remark: Callable[[str], None],
    ) -> None:
        """Reach nothing yet.

        Args:
            connect: context with the client of the cluster.
            timeout: longest time of a run [s]; None: any.
            patience: time without any worker after which the rest is given up [s].
            waits: wait for the first worker as long as it takes, as for a job in a queue.
            remark: receives a line when no worker is left.
        """
        super().__init__()
        self._connect, self._waits, self._timeout = connect, waits, timeout
        self._patience, self._remark = patience, remark
        self._client: Client | None = None

    def results(self, cases: Mapping[str, Case], cells: Path) -> Results:
        """Make runs; a run that is lost with its worker is made again elsewhere.

        Raises:
            ValueError: one line, if the cluster does not answer, has no worker, or its workers do not fit.
        """
        if not cases:
            return
        from offtrack.studies.cluster_workshop import packed

        client = self._connected()
        shipment, orders = packed(cases)
        with self._workshops(client, shipment) as plugin:
            yield from self._results(client, orders, plugin, cells)

    def _connected(self) -> "Client":
        from offtrack.studies.cluster_workshop import check_software

        if self._client is None:
            self._client = self.enter_context(self._connect())
            try:
                self._client.wait_for_workers(1, None if self._waits else self._patience)
            except TimeoutError:
                raise ValueError(f"the Dask cluster has no worker, after {self._patience:g} s") from None
            check_software(self._client)
        return self._client

    @contextmanager
    def _workshops(self, client: "Client", shipment: "Shipment") -> Iterator[str]:
        """Name of the plugin that makes this study's runs on all workers, also on those that come later."""
        from offtrack.studies.cluster_workshop import Workshop

        workshop = Workshop(shipment, self._timeout)
        _register(client, workshop)
        try:
            yield workshop.name
        finally:
            with suppress(Exception):  # the cluster may be gone
                client.unregister_worker_plugin(workshop.name)

    def _results(self, client: "Client", orders: "list[Order]", plugin: str, cells: Path) -> Results:
        from distributed import KilledWorker

        from offtrack.studies.cluster_workshop import fulfilled

        ended = queue.SimpleQueue[Any]()
        waiting: dict[Future, Order] = {}
        tries = Counter[str]()

        def submit(order: "Order") -> None:
            tries[order.name] += 1
            future = client.submit(fulfilled, order, plugin, key=f"{plugin}-{order.name}-{tries[order.name]}")
            waiting[future] = order
            future.add_done_callback(ended.put)

        try:
            for order in orders:
                submit(order)
            without = _Without(client, self._patience, self._remark)
            while waiting:
                try:
                    future = ended.get(timeout=_LOOK)
                except queue.Empty:
                    if reason := without.reason():
                        yield from ((order.name, WorkerDiedError(reason)) for order in waiting.values())
                        return
                    continue
                order = waiting.pop(future)
                result = _result(future)
                future.release()
                if isinstance(result, KilledWorker) and tries[order.name] < _TRIES:
                    submit(order)
                elif isinstance(result, KilledWorker):
                    yield order.name, WorkerDiedError("it was lost with its workers again and again")
                elif isinstance(result, BaseException):
                    yield order.name, result
                else:
                    yield order.name, _saved(order.name, result, cells)
        finally:
            if waiting:
                with suppress(Exception):  # the cluster may be gone
                    client.cancel(list(waiting), force=True)


def _register(client: "Client", workshop: "Workshop") -> None:
    """Give the workers of a cluster their part; one that is lost meanwhile must not end the study."""
    for attempt in range(1, _REGISTRATIONS + 1):
        try:
            client.register_plugin(workshop, name=workshop.name)
            return
        except OSError:
            if attempt == _REGISTRATIONS or client.status != "running":
                raise
            time.sleep(_LOOK)


class _Without:
    """Watch over a cluster that has no workers."""

    def __init__(self, client: "Client", patience: float, remark: Callable[[str], None]) -> None:
        self._client, self._patience, self._remark = client, patience, remark
        self._since: float | None = None

    def reason(self) -> str:
        """Why there is nothing to wait for any longer; empty as long as there is."""
        if self._client.status != "running":
            return "the Dask scheduler has ended"
        try:
            count = len(self._client.nthreads())
        except (OSError, TimeoutError):
            return "the Dask scheduler has ended"
        if count:
            self._since = None
        elif self._since is None:
            self._since = time.monotonic()
            self._remark(f"no worker is left in the Dask cluster: waiting {self._patience:g} s for another")
        elif time.monotonic() - self._since > self._patience:
            return f"no worker was left in the Dask cluster for {self._patience:g} s"
        return ""


def _result(future: "Future") -> "Delivery | BaseException":
    if future.status == "error":
        error = future.exception()
        return error if isinstance(error, BaseException) else RuntimeError(str(error))
    if future.status != "finished":
        return WorkerDiedError("the Dask scheduler has ended")
    try:
        result: Delivery = future.result()
    except Exception as error:  # lost at the last moment
        return error
    return result


def _saved(name: str, delivery: "Delivery", cells: Path) -> str:
    """Save the files of a run, the summary last; returns the run's problem."""
    for file in sorted(delivery.files, key=lambda file: file == summary_file(cells, name).name):
        with replacing(cells / file) as unfinished:
            unfinished.write_bytes(delivery.files[file])
    return delivery.problem
