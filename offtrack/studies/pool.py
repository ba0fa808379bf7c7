"""Runs of a study in worker processes, or elsewhere, and the options of how they are made.

A run is saved as ``<identity>.json`` (summary, and digests of the files that it opened without being named) and
``<identity>.parquet`` (signals).
"""

import json
import shutil
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from offtrack.studies.case import (
    Case,
    Outcome,
    Provenance,
    Settings,
    identities,
    named_files,
    opened_files,
    provenance,
    watch_files,
)
from scenarios.loop.runner import run
from scenarios.options.scenario import AnyScenario
from scenarios.processes import WorkerDiedError, each_in_a_worker
from scenarios.progress import Progress, no_progress
from scenarios.results.log import write_log
from scenarios.results.run_directory import digest, replacing
from scenarios.results.run_summary import Result
from vehicle.foundation.plant_like import KilledError

_SIGNALS, _FILES = "signals_sha256", "files_sha256"  # keys of digests, added to a summary
_PROVENANCE = "made"  # key of the provenance

Results = Generator[tuple[str, str | BaseException], None, None]


# Makes runs, saves those that succeed in a folder, and yields each name with its problem: empty, an outcome, or the
# exception that ended the run. Closing the generator stops what is running.
Executor = Callable[[Mapping[str, Case], Path], Results]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """How the runs of a study are made."""

    jobs: int  # worker processes
    timeout: float | None = None  # longest time of a run, which fails then [s]; None: any
    executor: Executor | None = None  # makes the runs elsewhere; None: worker processes here
    again: Settings = ()  # runs whose axes have these values are made again
    progress: Progress = no_progress  # of the runs
    remark: Callable[[str], None] = lambda line: None  # receives a line on every damaged run, which is made again
    announce: Callable[[str], None] = lambda line: None  # receives a line on what is to be done, before it begins


def run_cases(
    cases: Sequence[Case], cells: Path, options: RunOptions, *, known: Sequence[str] | None = None
) -> list[Outcome]:
    """Run all cases that are not saved in the folder ``cells``, and return the outcomes in their order.

    ``known`` are the identities of the cases; None: they are computed. An interrupt keeps the finished runs. A run
    whose process dies is tried once more; one that takes longer than the time limit, or dies twice, fails.

    Raises:
        ValueError: one line, for the first invalid scenario, before any run.
        KeyboardInterrupt: after the running processes have been stopped.
    """
    names = identities(cases) if known is None else known
    cells.mkdir(parents=True, exist_ok=True)
    missing = {name: case for name, case in zip(names, cases, strict=True) if not is_saved(cells, name, options.remark)}
    done, failed = len(cases) - len(missing), dict[str, str]()
    options.progress(done, len(cases), "from an earlier run" if done else "")
    if options.executor is not None:
        made = options.executor(missing, cells)
    else:
        tasks = {name: (case, cells, name, name) for name, case in missing.items()}
        jobs = max(1, min(options.jobs, len(tasks)))
        made = each_in_a_worker(run_case, tasks, jobs=jobs, timeout=options.timeout)
    with closing(made) as results:
        for name, result in results:
            if problem := problem_of(result):
                failed[name] = problem
            done += 1
            options.progress(done, len(cases), missing[name].title)
    return [outcome_of(case, cells, name, failed) for name, case in zip(names, cases, strict=True)]


def run_case(case: Case, cells: Path, name: str, identity: str) -> str:
    """Make one run and save its summary and signals under a name; called in a worker.

    ``identity`` is that of the run on this machine when the command began. A run that failed is not saved, so that the
    next command tries again; its outcome is returned.

    Raises:
        ValueError: one line, if a file that it depends on has changed meanwhile.
    """
    watch_files()
    begin = time.monotonic()
    scenario = case.resolved()
    result = made_run(scenario, case.seed)
    if result.traceback:
        return result.outcome
    if case.identity() != identity:
        raise ValueError("what it depends on has changed while the study ran: repeat the command")
    opened = opened_files(named_files([case.scenario, scenario.model_dump(exclude_none=True)]))
    signals = _signals(cells, name)
    with replacing(signals) as path:
        write_log(result.log, path)
    numbers = {**result.summary(), _SIGNALS: digest(signals), _FILES: opened, _PROVENANCE: provenance(begin)}
    with replacing(summary_file(cells, name)) as path:  # the last: a run with a summary is complete
        path.write_text(json.dumps(numbers, allow_nan=False), encoding="utf-8")
    return ""


def made_run(scenario: AnyScenario, seed: int) -> Result:
    """Result of a run; if the process of a part was killed, as for lack of memory, that of a second try."""
    result = run(scenario, seed)
    return run(scenario, seed) if KilledError.__name__ in result.traceback else result


def summary_file(cells: Path, identity: str) -> Path:
    """File of a run's summary: the last that is written of a run."""
    return cells / f"{identity}.json"


def _signals(cells: Path, identity: str) -> Path:
    return cells / f"{identity}.parquet"


def is_saved(cells: Path, identity: str, remark: Callable[[str], None]) -> bool:
    """True if a run is saved completely, and all files that it opened are as they were."""
    path = summary_file(cells, identity)
    if not path.is_file():
        return False
    try:
        numbers = _read(path)
        files = dict(numbers[_FILES])
        damaged = "" if digest(_signals(cells, identity)) == numbers[_SIGNALS] else _signals(cells, identity)
    except (ValueError, KeyError, TypeError, RecursionError):
        damaged, files = path, {}
    if damaged:
        remark(f"{damaged} is damaged: its run is repeated")
    return not damaged and all(digest(Path(file)) == known for file, known in files.items())


def adopt(names: Sequence[str], folder: Path, cells: Path) -> None:
    """Copy those of the runs that another study has saved in its folder."""
    cells.mkdir(exist_ok=True)
    for name in names:
        if not is_saved(cells, name, lambda line: None) and is_saved(folder, name, lambda line: None):
            for path in (_signals, summary_file):  # the summary is the last
                with replacing(path(cells, name)) as unfinished:
                    shutil.copyfile(path(folder, name), unfinished)


def run_seconds(cells: Path, name: str) -> float | None:
    """Wall time that a saved run has taken [s]; None: not known."""
    made = Provenance.of(_read(summary_file(cells, name)).get(_PROVENANCE))
    return made.seconds if made else None


def _read(path: Path) -> dict[str, Any]:
    numbers: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(numbers.get("outcome") if isinstance(numbers, dict) else None, str):
        raise ValueError(f"{path}: is not the summary of a run")
    return numbers


def outcome_of(case: Case, cells: Path, identity: str, failed: Mapping[str, str]) -> Outcome:
    """Outcome of a saved run, or of one that failed: ``failed`` has its line."""
    if identity in failed:
        return Outcome(case=case, numbers={"outcome": failed[identity]})
    saved = _read(summary_file(cells, identity))
    numbers = {key: value for key, value in saved.items() if key not in (_SIGNALS, _FILES, _PROVENANCE)}
    return Outcome(
        case=case, numbers=numbers, signals=_signals(cells, identity), provenance=Provenance.of(saved.get(_PROVENANCE))
    )


def problem_of(result: str | BaseException) -> str:
    """The outcome of a run that failed, empty for others; a study continues after an error in a single run."""
    if isinstance(result, str):
        return result
    kind = "" if isinstance(result, WorkerDiedError) else f"{type(result).__name__}: "
    return f"failed: {kind}{result}".splitlines()[0]
