"""Worker processes, which never outlive the process that started them.

They are never forked: a child of a process with an OpenGL context hangs.
"""

from __future__ import annotations

import ctypes
import os
import re
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, as_completed, wait
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, TypeVar

from vehicle.engine.compiler import warn_if_interpreted
from vehicle.engine.library_cache import silence

if TYPE_CHECKING:
    from loky import ProcessPoolExecutor

TaskT = TypeVar("TaskT")
OutputT = TypeVar("OutputT")

MOST_JOBS: Final = 1024
_BROKEN: Final = "a worker process was killed, perhaps for lack of memory; what is finished is kept"
_TRIES: Final = 2  # of a task whose process dies
_LOOK: Final = 0.5  # between two looks at the clock [s]
_PERIOD: Final = 0.5  # of looking for the parent [s]
_PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h


def as_finished(
    work: Callable[[TaskT], OutputT], tasks: Sequence[TaskT], *, jobs: int
) -> Iterator[tuple[TaskT, OutputT]]:
    """Each task with its output in order of completion, in ``jobs`` processes; one job runs in this process."""
    if jobs <= 1:
        yield from ((task, work(task)) for task in tasks)
        return
    with workers(jobs) as pool:
        futures = {pool.submit(work, task): task for task in tasks}
        for future in as_completed(futures):
            yield futures[future], future.result()


class WorkerDiedError(Exception):
    """A worker process died with a task, or took too long; one line that says how."""


def each_in_a_worker(
    work: Callable[..., OutputT], tasks: Mapping[str, Sequence[object]], *, jobs: int, timeout: float | None = None
) -> Generator[tuple[str, OutputT | BaseException], None, None]:
    """Key of each task with its output, or with the exception that ended it, in order of completion.

    Every process is on its own: one that is killed, runs out of memory or crashes costs its own task alone, which gets
    a second try. A task that kills two processes, or takes longer than ``timeout`` [s], ends in a `WorkerDiedError`.

    Args:
        work: function of a task's arguments.
        tasks: arguments by key.
        jobs: number of processes.
        timeout: longest time of a task [s]; None: any.
    """
    waiting, deaths = deque(tasks), Counter[str]()
    pools: list[ProcessPoolExecutor] = []
    running: dict[Future[OutputT], tuple[str, ProcessPoolExecutor, float]] = {}
    try:
        while waiting or running:
            while waiting and (pools or len(running) < jobs):
                pool = pools.pop() if pools else _lone_worker(jobs)
                try:
                    future = pool.submit(work, *tasks[waiting[0]])
                except BrokenExecutor:  # its process died while it had nothing to do
                    pool.shutdown(kill_workers=True)
                    continue
                running[future] = (waiting.popleft(), pool, time.monotonic())
            done = wait(running, timeout=None if timeout is None else _LOOK, return_when=FIRST_COMPLETED).done
            for future in done:
                key, pool, _ = running.pop(future)
                error = future.exception()
                if isinstance(error, BrokenExecutor):
                    pool.shutdown(kill_workers=True)
                    deaths[key] += 1
                    if deaths[key] < _TRIES:
                        waiting.append(key)
                        continue
                    error = WorkerDiedError(f"its process died twice, at last by {_death(error)}")
                else:
                    pools.append(pool)
                yield key, future.result() if error is None else error
            for future, (key, pool, since) in list(running.items()):
                if timeout is not None and time.monotonic() - since > timeout:
                    del running[future]
                    pool.shutdown(kill_workers=True)
                    yield key, WorkerDiedError(f"took longer than {timeout:g} s")
    except BaseException:
        for _, pool, _ in running.values():
            pool.shutdown(kill_workers=True)
        raise
    finally:
        for pool in pools:
            pool.shutdown()


def _lone_worker(jobs: int) -> ProcessPoolExecutor:
    from loky import ProcessPoolExecutor

    warn_if_interpreted()
    environment = {"LP_NUM_THREADS": "1"} if jobs > 1 else {}
    return ProcessPoolExecutor(1, initializer=_begin, initargs=(os.getpid(),), env=environment)


def _death(error: BaseException) -> str:
    """How a process died: the signal, or its exit code."""
    found = re.findall(r"(SIG[A-Z]+|EXIT)\((-?\d+)\)", str(error))
    if not found:
        return "an unknown cause"
    name, code = found[0]
    memory = ", perhaps for lack of memory" if name == "SIGKILL" else ""
    return f"{name}{memory}" if name != "EXIT" else f"exit code {code}"


@contextmanager
def workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that ignore interrupts; an error or interrupt here, or the end of this process, ends them.

    Raises:
        ChildProcessError: one line, if the result of a worker that was killed is asked for.
    """
    from loky import ProcessPoolExecutor

    warn_if_interpreted()
    # Several processes use the cores better than the threads of the renderer in each of them.
    environment = {"LP_NUM_THREADS": "1"} if count > 1 else {}
    pool = ProcessPoolExecutor(max(1, count), initializer=_begin, initargs=(os.getpid(),), env=environment)
    try:
        yield pool
    except BaseException as error:
        pool.shutdown(kill_workers=True)
        if isinstance(error, BrokenExecutor):
            raise ChildProcessError(f"{_BROKEN}: {error}".splitlines()[0]) from error
        raise
    pool.shutdown()


def default_jobs() -> int:
    """Number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _begin(parent: int) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):  # the parent decides what is kept
        signal.signal(number, signal.SIG_IGN)
    if sys.platform == "linux":  # also while a library's function holds the interpreter and no thread can look
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    silence()
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(_PERIOD)
    os.kill(os.getpid(), signal.SIGKILL)
