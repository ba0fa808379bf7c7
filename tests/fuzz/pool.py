"""Runs of cases in worker processes, with limits of time and memory; what dies, hangs or grows is a find."""

import shutil
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, NamedTuple

from scenarios.processes import each_in_a_worker
from tests.fuzz.case import LARGEST, SLOWEST, Case, Result, find, tree
from tests.fuzz.child import result_of

HANG: Final = 300.0  # after that a case is stopped; the machine may be busy [s]


class Tried(NamedTuple):
    case: Case
    result: Result
    wrong: str | None  # what was found, in one line
    folder: Path


def try_all(
    cases: Iterable[Case],
    folder: Path,
    specimens: Path,
    *,
    children: int,
    report: Callable[[Tried], None],
    until: float = float("inf"),
    hang: float = HANG,
) -> None:
    """Try cases in several processes until there are no more or the time ``until`` (monotonic) has come.

    Folders of finds stay, the others are removed.
    """
    tasks = {f"{k:05d}": (case, folder / f"{k:05d}", specimens) for k, case in enumerate(cases)}
    results = each_in_a_worker(tried, tasks, jobs=children, timeout=hang)
    for name, done in results:
        case, place, _ = tasks[name]
        one = Tried(case, Result(error=str(done)), str(done), place) if isinstance(done, BaseException) else done
        if one.wrong is None:
            shutil.rmtree(place)
        report(one)
        if time.monotonic() > until:
            results.close()


def tried(case: Case, folder: Path, specimens: Path) -> Tried:
    """Try a case in ``folder``; one that was only slow or large, as with first imports, gets a second chance."""
    for _ in range(2):
        shutil.rmtree(folder, ignore_errors=True)
        case.place(specimens, folder)
        before = tree(folder)
        result = result_of(case, folder)
        wrong = find(result, before, tree(folder), own=case.own)
        if wrong is None or (result.memory <= LARGEST and result.seconds <= SLOWEST):
            break
    return Tried(case, result, wrong, folder)
