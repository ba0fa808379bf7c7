"""Worker processes, which never outlive the process that started them.

They are never forked: a child of a process with an OpenGL context hangs.
"""

import atexit
import ctypes
import gc
import logging
import os
import re
import resource
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, ThreadPoolExecutor, wait
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Final, TypeVar

if TYPE_CHECKING:
    from loky import ProcessPoolExecutor

TaskT = TypeVar("TaskT")
OutputT = TypeVar("OutputT")

MOST_JOBS: Final = 1024
_TRIES: Final = 2  # of a task whose process dies
_LOOK: Final = 0.5  # between two calls meanwhile [s]
_ALLOCATIONS: Final = 50_000  # of containers, between two searches for garbage
_LEAST_MEMORY: Final = 1.2e9  # of addresses, most of them those of libraries [bytes]
_IDLE: Final = 60.0  # after which a spare worker ends [s]
_PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h


class WorkerDiedError(Exception):
    """A worker process died with a task, or took too long; one line that says how."""


def each_in_a_worker(
    work: Callable[..., OutputT],
    tasks: Mapping[str, Sequence[object]],
    *,
    jobs: int,
    timeout: float | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> Generator[tuple[str, OutputT | BaseException], None, None]:
    """Key of each task with its output, or with the exception that ended it, in order of completion.

    Every process is on its own: one that is killed, runs out of memory or crashes costs its own task alone, which gets
    a second try. A task that kills two processes, or takes longer than ``timeout`` [s], ends in a `WorkerDiedError`.

    Args:
        work: function of a task's arguments.
        tasks: arguments by key.
        jobs: number of processes.
        timeout: longest time of a task [s]; None: any.
        meanwhile: called twice a second while tasks are running.
    """
    spare, threads = SpareWorkers(together=jobs), ThreadPoolExecutor(jobs)
    try:
        running = {threads.submit(spare.call, work, *task, timeout=timeout): key for key, task in tasks.items()}
        while running:
            for future in wait(running, timeout=_LOOK if meanwhile else None, return_when=FIRST_COMPLETED).done:
                error = future.exception()
                yield running.pop(future), future.result() if error is None else error
            if meanwhile is not None:
                meanwhile()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        spare.stop()


def as_finished(
    work: Callable[[TaskT], OutputT], tasks: Sequence[TaskT], *, jobs: int
) -> Iterator[tuple[TaskT, OutputT]]:
    """Each task with its output in order of completion, in ``jobs`` processes; one job runs in this process.

    An exception of a task ends them all.

    Raises:
        ChildProcessError: one line, if a task kills two processes.
    """
    if jobs <= 1:
        yield from ((task, work(task)) for task in tasks)
        return
    with closing(each_in_a_worker(work, {str(k): (task,) for k, task in enumerate(tasks)}, jobs=jobs)) as results:
        for key, result in results:
            if isinstance(result, WorkerDiedError):
                raise ChildProcessError(f"a worker process: {result}; what is finished is kept") from result
            if isinstance(result, BaseException):
                raise result
            yield tasks[int(key)], result


class SpareWorkers:
    """Processes that wait for the tasks of this process's threads; each has one task at a time.

    They end when nothing has been asked of them for some time, and with this process.
    """

    def __init__(self, *, together: int = 2) -> None:
        """No process yet; ``together`` work at the same time."""
        self._together = together
        self._free: list[ProcessPoolExecutor] = []
        self._busy: list[ProcessPoolExecutor] = []
        self._lock, self._ended = threading.RLock(), False

    def call(self, work: Callable[..., OutputT], *arguments: object, timeout: float | None = None) -> OutputT:
        """Output of a task; a process that dies costs it one more try.

        Raises:
            WorkerDiedError: if it kills two processes, or takes longer than ``timeout`` [s].
        """
        deaths = 0
        while True:
            with self._lock:  # a pool that is stopped while its process starts would do the task all the same
                if self._ended:
                    raise WorkerDiedError("its process was stopped")
                pool = self._free.pop() if self._free else _pool(self._together)
                self._busy.append(pool)
                try:
                    future = pool.submit(_tidied, work, *arguments)
                except (BrokenExecutor, RuntimeError):  # its process died while it had nothing to do
                    self._left(pool, usable=False)
                    continue
            finished = bool(wait([future], timeout=timeout).done)
            error = future.exception() if finished else None
            usable = finished and not self._ended and not isinstance(error, BrokenExecutor)
            self._left(pool, usable=usable)
            if usable:
                output: OutputT = future.result()
                return output
            if not finished:
                raise WorkerDiedError(f"took longer than {timeout:g} s")
            deaths += 1
            if deaths == _TRIES:
                raise WorkerDiedError(f"its process died twice, at last by {_death(error)}")

    def stop(self) -> None:
        """End all processes, also in the middle of a task."""
        with self._lock:
            self._ended, free, busy = True, list(self._free), list(self._busy)
            self._free.clear()
        for pool in busy:
            pool.shutdown(kill_workers=True)
        for pool in free:
            pool.shutdown()

    def _left(self, pool: "ProcessPoolExecutor", *, usable: bool) -> None:
        with self._lock:
            self._busy.remove(pool)
            usable = usable and not self._ended
            if usable:
                self._free.append(pool)
        if not usable:
            pool.shutdown(kill_workers=True)


def _pool(together: int) -> "ProcessPoolExecutor":
    """A pool of one process, which ends after some time without a task; ``together`` pools work at the same time."""
    from loky import ProcessPoolExecutor

    from vehicle.engine.compiler import warn_if_interpreted

    warn_if_interpreted()
    # Several processes use the cores better than the threads of the renderer in each of them.
    environment = {"LP_NUM_THREADS": os.environ.get("LP_NUM_THREADS", "1")} if together > 1 else {}
    return ProcessPoolExecutor(1, timeout=_IDLE, initializer=_begin, initargs=(os.getpid(),), env=environment)


def _death(error: BaseException | None) -> str:
    """How a process died: the signal, or its exit code."""
    found = re.findall(r"(SIG[A-Z]+|EXIT)\((-?\d+)\)", str(error))
    if not found:
        return "an unknown cause"
    name, code = found[0]
    memory = ", perhaps for lack of memory" if name == "SIGKILL" else ""
    return f"{name}{memory}" if name != "EXIT" else f"exit code {code}"


def is_alive(process: int) -> bool:
    """True if there is another process of this number on this machine."""
    if process == os.getpid():  # an earlier one of this number is meant
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass
    return True


def check_memory() -> None:
    """Refuse to begin with too little memory, in which libraries crash or wait forever.

    Raises:
        ValueError: one line.
    """
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < _LEAST_MEMORY:
        raise ValueError(
            f"memory is limited to {limit / 1e9:.2g} GB (ulimit -v): a run needs {_LEAST_MEMORY / 1e9:g} GB"
        )


def save_time() -> None:
    """Settings of a process of offtrack's own, which a user's program must not get: less waiting and searching.

    Matrices and images are small, so that threads of OpenBLAS and OpenCV, imported later, mostly wait for each other; a
    number of the user's own counts. A run makes little that refers to itself in a circle: Python looks for it seldom.
    """
    for variable in ("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(variable, "1")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it says that it can't keep its list of fonts
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")  # of loky's, which says what it cleans after a kill
    gc.set_threshold(_ALLOCATIONS)
    atexit.register(gc.freeze)  # with the process everything goes, and need not be searched


def default_jobs() -> int:
    """Number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _tidied(work: Callable[..., OutputT], *arguments: object) -> OutputT:
    """Output of a task in a worker, which returns the memory that the task has freed.

    loky takes what a worker holds beyond its first task for a leak, and restarts it with a warning. The C library keeps
    freed memory: 180 MB after a run with cameras.
    """
    try:
        return work(*arguments)
    finally:
        with suppress(AttributeError):  # another library than glibc
            ctypes.CDLL(None).malloc_trim(0)


def _begin(parent: int) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # the parent decides what is kept
        signal.signal(number, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has ended already
        os.kill(os.getpid(), signal.SIGKILL)
    save_time()
    from vehicle.foundation.user_cache import silence  # imports NumPy, when the worker can end with its parent

    silence()
