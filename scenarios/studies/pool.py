"""Worker processes for the runs of a study; every finished run is saved at once and not repeated.

Workers are never forked: a child of a process with an OpenGL context hangs.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, as_completed, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from loky import ProcessPoolExecutor

from scenarios.progress import Progress, no_progress
from scenarios.studies.case import Case, Outcome
from vehicle.engine.compiler import warn_if_interpreted
from vehicle.engine.library_cache import silence

TaskT = TypeVar("TaskT")
OutputT = TypeVar("OutputT")


def run_cases(cases: Sequence[Case], cells: Path, *, jobs: int, progress: Progress = no_progress) -> list[Outcome]:
    """Run all cases that are not saved in the folder ``cells``, and return the outcomes in their order.

    An interrupt keeps the finished runs.

    Raises:
        ValueError: one line, for the first invalid scenario, before any run.
        KeyboardInterrupt: after the running processes have been stopped.
    """
    identities = [case.identity() for case in cases]
    cells.mkdir(parents=True, exist_ok=True)
    missing = {
        identity: case for identity, case in zip(identities, cases, strict=True) if not _file(cells, identity).is_file()
    }
    done, failed = len(cases) - len(missing), dict[str, str]()
    progress(done, len(cases), "from an earlier run" if done else "")
    with workers(min(jobs, len(missing))) as pool:
        waiting = {pool.submit(run_case, case, cells, identity): identity for identity, case in missing.items()}
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                identity = waiting.pop(future)
                if problem := _problem(future):
                    failed[identity] = problem
                done += 1
                progress(done, len(cases), missing[identity].title)
    return [_outcome(case, cells, identity, failed) for identity, case in zip(identities, cases, strict=True)]


def run_case(case: Case, cells: Path, identity: str) -> None:
    """Make one run and save its summary and signals; called in a worker."""
    from scenarios.loop.run import run_any
    from scenarios.options.scenario import load_any_scenario
    from scenarios.results.log import write_log
    from scenarios.results.summary import summary

    result = run_any(load_any_scenario(case.scenario, case.settings), case.seed)
    write_log(result.log, cells / f"{identity}.parquet")
    unfinished = cells / f".{identity}.{os.getpid()}"
    unfinished.write_text(json.dumps(summary(result), allow_nan=False), encoding="utf-8")
    unfinished.rename(_file(cells, identity))  # atomic: a file of that name is complete


def kept_signals(cells: Path, case: Case) -> Path:
    """File of the signals of a finished run."""
    return cells / f"{case.identity()}.parquet"


def _file(cells: Path, identity: str) -> Path:
    return cells / f"{identity}.json"


def _outcome(case: Case, cells: Path, identity: str, failed: dict[str, str]) -> Outcome:
    if identity in failed:
        return Outcome(case=case, numbers={"outcome": f"failed: {failed[identity]}"})
    numbers: dict[str, Any] = json.loads(_file(cells, identity).read_text(encoding="utf-8"))
    return Outcome(case=case, numbers=numbers)


def _problem(future: Future[None]) -> str:
    """The error of a run in one line, empty if there is none; a study continues after an error in a single run."""
    error = future.exception()
    return "" if error is None else f"{type(error).__name__}: {error}".splitlines()[0]


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
    """Worker processes that ignore interrupts; an error or interrupt here stops them at once."""
    warn_if_interpreted()
    # Several processes use the cores better than the threads of the renderer in each of them.
    environment = {"LP_NUM_THREADS": "1"} if count > 1 else {}
    pool = ProcessPoolExecutor(max(1, count), initializer=_start_worker, env=environment)
    try:
        yield pool
    except BaseException:
        pool.shutdown(kill_workers=True)
        raise
    pool.shutdown()


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    silence()


def default_jobs() -> int:
    """Number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
