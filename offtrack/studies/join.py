"""Runs of a study by several commands at once, on one machine or many, in a folder that they share.

Each command claims runs that nobody has, makes them in its worker processes, and watches the others until all runs are
made. The first command writes the plan, ``plan.json``: the names of all runs, and what their numbers depend on apart
from the machine. A command with other files or another version of offtrack is refused.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from offtrack.studies.case import Case, Outcome, identities, made
from offtrack.studies.claims import LEASE, Claims
from offtrack.studies.files import CELLS
from offtrack.studies.pool import is_saved, outcome_of, problem_of, run_case, summary_file
from scenarios.processes import each_in_a_worker
from scenarios.progress import Progress, no_progress
from scenarios.results.atomic_files import replaced

CLAIMS: Final = "claims"  # folder beside the runs
FAILED: Final = "failed"  # folder of runs that failed: a line in each file
PLAN: Final = "plan.json"  # names of the runs, beside them

Task = tuple[str, Sequence[object]]


def planned(cases: Sequence[Case], directory: Path) -> list[str]:
    """Names of all runs in the study's plan; the first command writes it.

    Raises:
        ValueError: one line, if the plan is another study's, or was made with other files or another offtrack.
    """
    portable = identities(cases, portable=True)
    path = directory / PLAN
    if not path.exists():
        plan = {"runs": identities(cases), "portable": portable, "made": made(time.monotonic())}
        unfinished = path.with_name(f".{PLAN}.{os.getpid()}.{random.getrandbits(32):08x}")
        unfinished.write_text(json.dumps(plan), encoding="utf-8")
        try:
            os.link(unfinished, path)
        except FileExistsError:
            pass  # another command was first
        finally:
            unfinished.unlink()
    read = _plan(path)
    if read["portable"] != portable:
        host = dict(read.get("made") or {}).get("host", "another machine")
        raise ValueError(
            f"{path}: was begun on {host} with another study, other files or another version of offtrack: use the same "
            "everywhere, or choose another --out"
        )
    return [str(name) for name in read["runs"]]


def _plan(path: Path) -> dict[str, Any]:
    try:
        plan = json.loads(path.read_text(encoding="utf-8"))
        if len(plan["runs"]) == len(plan["portable"]):
            return dict(plan)
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise ValueError(f"{path}: is damaged: remove it, or choose another --out")


def forget(directory: Path, name: str) -> None:
    """Forget a run, finished or failed, so that it is made again."""
    summary_file(directory / CELLS, name).unlink(missing_ok=True)
    (directory / FAILED / name).unlink(missing_ok=True)


def forget_failures(directory: Path) -> None:
    """Forget what failed while commands worked together: the study was run again as a whole."""
    for path in (directory / FAILED).glob("*"):
        path.unlink(missing_ok=True)


def join_cases(
    cases: Sequence[Case],
    names: Sequence[str],
    cells: Path,
    *,
    jobs: int,
    lease: float = LEASE,
    timeout: float | None = None,
    progress: Progress = no_progress,
    remark: Callable[[str], None] = lambda line: None,
) -> list[Outcome]:
    """Make runs that nobody has claimed until all are made, here or elsewhere, and return all outcomes.

    Args:
        cases: all runs of the study.
        names: their names in the plan.
        cells: folder of the finished runs; claims and failures are in folders beside it.
        jobs: number of worker processes.
        lease: time without a sign of life after which a claim is taken over [s].
        timeout: longest time of a run [s]; None: any.
        progress: of all runs, also of those that others make.
        remark: receives a line on every damaged run, which is made again.

    Raises:
        KeyboardInterrupt: after the running processes have been stopped; claims are given up.
    """
    cells.mkdir(parents=True, exist_ok=True)
    failures = cells.parent / FAILED
    failures.mkdir(exist_ok=True)
    here = dict(zip(names, zip(cases, identities(cases), strict=True), strict=True))
    for name in names:
        if summary_file(cells, name).exists() and not is_saved(cells, name, remark):
            summary_file(cells, name).unlink(missing_ok=True)
    claims, mine = Claims(cells.parent / CLAIMS, lease), set[str]()

    def is_open(name: str) -> bool:
        return not summary_file(cells, name).exists() and not (failures / name).exists()

    def shown(title: str) -> None:
        progress(sum(not is_open(name) for name in names), len(names), title)

    def source() -> Iterator[Task | None]:
        order = random.sample(list(names), len(names))  # commands that start together reach for different runs
        while left := [name for name in order if name not in mine and is_open(name)]:
            for name in left:
                if not claims.take(name):
                    continue
                if not is_open(name):  # finished between the look and the claim
                    claims.release(name)
                    continue
                mine.add(name)
                case, identity = here[name]
                yield name, (case, cells, name, identity)
                break
            else:
                shown("others are at work")
                yield None

    shown("")
    with claims.kept(), closing(each_in_a_worker(run_case, source(), jobs=jobs, timeout=timeout)) as results:
        for name, result in results:
            if problem := problem_of(result):
                replaced(failures / name, problem)
            claims.release(name)
            shown(here[name][0].title)
    failed = {path.name: path.read_text(encoding="utf-8") for path in failures.iterdir() if path.name in here}
    failed = {name: line for name, line in failed.items() if not summary_file(cells, name).exists()}
    return [outcome_of(case, cells, name, failed) for name, case in zip(names, cases, strict=True)]
