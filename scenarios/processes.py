"""Worker processes, which never outlive the process that started them.

They are never forked: a child of a process with an OpenGL context hangs.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, as_completed
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
