"""Worker processes for the runs of a study; every finished run is kept at once and never repeated.

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

Given = TypeVar("Given")
Made = TypeVar("Made")


def run_cases(cases: Sequence[Case], cells: Path, *, jobs: int, progress: Progress = no_progress) -> list[Outcome]:
    """The outcomes in the order of the cases; an interrupt leaves those that are finished in the folder ``cells``.

    Raises:
        ValueError: one line, for the first case whose scenario is not valid, before any run.
        KeyboardInterrupt: once the running processes have been stopped.
    """
    identities = [case.identity() for case in cases]
    cells.mkdir(parents=True, exist_ok=True)
    missing = {identity: case for identity, case in zip(identities, cases, strict=True) if not _kept(cells, identity)}
    done, failed = len(cases) - len(missing), dict[str, str]()
    progress(done, len(cases), "kept from before" if done else "")
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
    """Makes one run and keeps its summary and signals; called in a worker."""
    from scenarios.loop.run import run_any
    from scenarios.options.scenario import load_any_scenario
    from scenarios.results.log import write_log
    from scenarios.results.summary import summary

    result = run_any(load_any_scenario(case.scenario, case.settings), case.seed)
    write_log(result.log, cells / f"{identity}.parquet")
    unfinished = cells / f".{identity}.{os.getpid()}"
    unfinished.write_text(json.dumps(summary(result), allow_nan=False), encoding="utf-8")
    unfinished.rename(_file(cells, identity))  # what has its name is whole


def kept_signals(cells: Path, case: Case) -> Path:
    """Where the signals of a finished run lie."""
    return cells / f"{case.identity()}.parquet"


def _file(cells: Path, identity: str) -> Path:
    return cells / f"{identity}.json"


def _kept(cells: Path, identity: str) -> bool:
    return _file(cells, identity).is_file()


def _outcome(case: Case, cells: Path, identity: str, failed: dict[str, str]) -> Outcome:
    if identity in failed:
        return Outcome(case=case, numbers={"outcome": f"failed: {failed[identity]}"})
    numbers: dict[str, Any] = json.loads(_file(cells, identity).read_text(encoding="utf-8"))
    return Outcome(case=case, numbers=numbers)


def _problem(future: Future[None]) -> str:
    """One line about why a run came to nothing; empty if it came to something.

    A study goes on where one of its runs meets what only running shows, an own controller's error for example.
    """
    error = future.exception()
    return "" if error is None else f"{type(error).__name__}: {error}".splitlines()[0]


def as_finished(work: Callable[[Given], Made], given: Sequence[Given], *, jobs: int) -> Iterator[tuple[Given, Made]]:
    """What is made of each, as it is finished: here one after the other, or in so many processes."""
    if jobs <= 1:
        yield from ((one, work(one)) for one in given)
        return
    with workers(jobs) as pool:
        at_work = {pool.submit(work, one): one for one in given}
        for future in as_completed(at_work):
            yield at_work[future], future.result()


@contextmanager
def workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes, which leave an interrupt to this one; it ends them without waiting for their work."""
    # Several processes use the cores better than the threads of the renderer in each of them.
    alone = {"LP_NUM_THREADS": "1"} if count > 1 else {}
    pool = ProcessPoolExecutor(max(1, count), initializer=_deaf_to_interrupts, env=alone)
    try:
        yield pool
    except BaseException:
        pool.shutdown(kill_workers=True)
        raise
    pool.shutdown()


def _deaf_to_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def default_jobs() -> int:
    """As many processes as this one may use cores."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
