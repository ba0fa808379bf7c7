"""A study from its cases to its tables and report, and its directory.

The directory holds the study file, tables, the report, and the runs in ``cells``; an existing study is resumed.
"""

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv as pa_csv

from offtrack.reports.run_files import read_summary
from offtrack.studies.case import RUN, Case, FinishedCase, Outcome, Provenance, identities
from offtrack.studies.draws import made_in_batches
from offtrack.studies.pool import RunOptions, adopt, is_saved, run_cases, run_seconds, summary_file
from offtrack.studies.rehearsal import rehearse, time_text
from offtrack.studies.study import FILE, Study
from offtrack.studies.study_figures import write_run_pages
from offtrack.studies.study_page import finished_runs_page, names_of_runs, page_link, sensitivity_csv, study_page
from offtrack.studies.table import QUANTITIES, Row, rows_of, shown_quantities, table_csv
from scenarios.results import run_directory


def runs_table(outcomes: Sequence[Outcome]) -> pa.Table:
    """Values on the axes, drawn values, seed, outcome, quantities with a number in any run, and provenance."""
    axes = [key for key, _ in outcomes[0].case.axes] if outcomes else []
    columns: dict[str, list[str | int | float | None]] = {
        key: [dict(outcome.case.axes)[key] for outcome in outcomes] for key in axes
    }
    for key in (key for key, _ in outcomes[0].case.drawn) if outcomes else ():
        columns[key] = [dict(outcome.case.drawn)[key] for outcome in outcomes]
    columns["seed"] = [outcome.case.seed for outcome in outcomes]
    columns["outcome"] = [str(outcome.numbers["outcome"]) for outcome in outcomes]
    for quantity in QUANTITIES:
        numbers = [outcome.number(quantity.path) for outcome in outcomes]
        if any(number is not None for number in numbers):
            columns[quantity.column] = list(numbers)
    for name in Provenance._fields:
        columns[name] = [
            None if outcome.provenance is None else getattr(outcome.provenance, name) for outcome in outcomes
        ]
    return pa.table(columns)


CELLS: Final = "cells"  # folder of the runs
_IDENTITY: Final = ".identity"  # file with the identity of the runs


def check_study_directory(directory: Path, file: str = FILE) -> None:
    """Refuse a directory that is not empty and does not hold a study, which has a file of this name.

    Raises:
        ValueError: one line.
    """
    if os.path.lexists(directory) and not directory.is_dir():
        raise ValueError(f"{directory} is a file or a broken link: choose another name")
    if not directory.is_dir() or (directory / file).is_file():
        return
    if set(directory.iterdir()) - set(run_directory.unfinished_files(directory)):
        raise ValueError(f"directory {directory} is not empty and holds no {file}: choose another")


def study_text(study: Study, directory: Path) -> str:
    """The study as TOML: the file that is in the directory, with its comments, if it describes the same study."""
    try:
        same = study.load(directory / study.file) == study
    except ValueError:
        same = False
    return (directory / study.file).read_text(encoding="utf-8") if same else study.to_toml()


@contextmanager
def opened_study(directory: Path, file: str, content: str, identity: str = "") -> Iterator[None]:
    """Lock the directory of a study, write its file, and remove what killed processes have left.

    With its ``identity`` a study finds its directory again.

    Raises:
        ValueError: one line, if another process works in it.
    """
    directory.mkdir(parents=True, exist_ok=True)
    with run_directory.user_of(directory):
        run_directory.replaced(directory / file, content)
        if identity:
            run_directory.replaced(directory / _IDENTITY, identity)
        for folder in (directory, directory / CELLS):
            for path in run_directory.unfinished_files(folder) if folder.is_dir() else ():
                path.unlink()
        yield


def write_study(title: str, study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row], directory: Path) -> None:
    """Write the table of points and that of runs (CSV, Parquet), pages of runs, and the report of a finished study."""
    run_directory.replaced(directory / "table.csv", table_csv(rows))
    columns: dict[str, list[str | int | float | None]] = {
        key: [dict(row.axes)[key] for row in rows] for key in (dict(rows[0].axes) if rows else {})
    }
    columns |= {"runs": [row.runs for row in rows], "completed": [row.completed for row in rows]}
    columns |= {q.column: [row.numbers[q.path] for row in rows] for q in shown_quantities(rows)}
    with run_directory.replacing(directory / "table.parquet") as unfinished:
        pq.write_table(pa.table(columns), unfinished)
    write_runs_table(runs_table(outcomes), directory)
    if study.draws.sensitivity:
        run_directory.replaced(directory / "sensitivity.csv", sensitivity_csv(study.draws.sensitivity, outcomes))
    links = write_run_pages(outcomes, directory)
    run_directory.replaced(directory / "report.html", study_page(title, study, outcomes, rows, links))


def write_runs_table(runs: pa.Table, directory: Path) -> None:
    """Write the table of runs (CSV, Parquet)."""
    for name, write in (("runs.csv", pa_csv.write_csv), ("runs.parquet", pq.write_table)):
        with run_directory.replacing(directory / name) as unfinished:
            write(runs, unfinished)


MakeMore = Callable[[Sequence[Case]], list[Outcome]]  # makes further runs, or takes those that are saved
Finish = Callable[[Path, Sequence[Outcome], MakeMore], None]


class StudyResult(NamedTuple):
    """A finished study."""

    directory: Path
    outcomes: list[Outcome]
    rows: list[Row]


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """How far a study has come."""

    directory: Path
    runs: int
    kept: int  # runs that need not be made again
    seconds: float | None  # likely time of the rest with these jobs; None: not known
    jobs: int

    def __str__(self) -> str:
        rest = self.runs - self.kept
        facts = ["1 run" if self.runs == 1 else f"{self.runs} runs"]
        facts += [f"{self.kept} kept from before"] if self.kept else []
        facts += [f"{rest} left" if self.kept else "", f"{self.jobs} at a time"] if rest else []
        facts += [f"about {time_text(self.seconds)}"] if rest and self.seconds is not None else []
        return f"{', '.join(filter(None, facts))}; in {self.directory}"


def standing_of(title: str, study: Study, directory: Path | None, jobs: int) -> Standing:
    """How far a study has come; nothing is run or written.

    Raises:
        ValueError: one line, for an invalid scenario or directory.
    """
    names = identities(study.cases())
    directory = directory or own_directory(title, study.file, partial(_is_same, study), _sum(names))
    return _standing(directory, names, jobs)


def _standing(directory: Path, names: Sequence[str], jobs: int) -> Standing:
    saved = [name for name in names if is_saved(directory / CELLS, name, lambda line: None)]
    seconds = [time for name in saved if (time := run_seconds(directory / CELLS, name)) is not None]
    rest = len(names) - len(saved)
    each = sum(seconds) / len(seconds) if seconds else None if rest else 0.0
    jobs = max(1, min(jobs, rest))
    whole = None if each is None else each * math.ceil(rest / jobs)
    return Standing(directory=directory, runs=len(names), kept=len(saved), seconds=whole, jobs=jobs)


def own_directory(title: str, file: str, is_same: Callable[[Path], bool], identity: str) -> Path:
    """The directory ``runs/<title>-<n>`` of the same study, or else the next one, which is not there yet.

    Args:
        title: title of the study.
        file: name of the file that a directory of this kind of study has.
        is_same: says of such a file whether it describes this study.
        identity: of the runs, as their scenarios, files and offtrack are now.
    """
    following = run_directory.next_run_directory(title)
    number = int(following.name.rpartition("-")[2])
    for earlier in (following.with_name(f"{title}-{n}") for n in range(number - 1, 0, -1)):
        mark = earlier / _IDENTITY
        if (earlier / file).is_file() and mark.is_file() and mark.read_text(encoding="utf-8") == identity:
            with suppress(ValueError):
                if is_same(earlier / file):
                    return earlier
    return following


def _is_same(study: Study, file: Path) -> bool:
    return study.load(file) == study


def _sum(names: Sequence[str]) -> str:
    return hashlib.sha256(" ".join(names).encode()).hexdigest()


def run_study(
    title: str, study: Study, directory: Path | None, options: RunOptions, *, finish: Finish | None = None
) -> StudyResult:
    """Run what the directory does not hold yet of a study, and write its tables and report.

    Without a directory the study continues its own, ``runs/<title>-<n>``, or begins the next one; runs that studies of
    the same title have made are taken from there. ``finish`` writes what is made of the runs, in place of
    `write_study`.

    Raises:
        ValueError: one line, for an invalid scenario or directory, before anything is written.
        KeyboardInterrupt: after the running processes have been stopped; its text says what is kept.
    """
    if directory is not None:
        check_study_directory(directory, study.file)
    cases = study.cases()
    names = identities(cases)  # refuses invalid scenarios before anything is written
    again = set(options.again)
    if again and not any(again <= set(case.axes) for case in cases):
        pairs = " ".join(map("=".join, options.again))
        raise ValueError(f"--where {pairs}: no run of the study has these values")
    is_own = directory is None
    directory = directory or own_directory(title, study.file, partial(_is_same, study), _sum(names))
    is_new = is_own and not directory.exists()
    siblings = sorted(directory.parent.glob(f"{title}-*/{CELLS}")) if is_new else []
    folders = (directory / CELLS, *siblings)
    present = {name for name in names if any(summary_file(folder, name).is_file() for folder in folders)}
    missing = [case for name, case in zip(names, cases, strict=True) if name not in present]
    seconds = rehearse(missing, options.progress, elsewhere=options.executor is not None)
    if is_new:
        directory = run_directory.new_run_directory(title)
    with opened_study(directory, study.file, study_text(study, directory), _sum(names) if is_own else ""):
        for folder in siblings:
            adopt(names, folder, directory / CELLS)
        standing = _standing(directory, names, options.jobs)
        if standing.seconds is None and seconds is not None:
            standing = replace(standing, seconds=seconds / standing.jobs)
        options.announce(str(standing))
        forgotten = set[str]()

        def make(some: Sequence[Case], known: Sequence[str]) -> list[Outcome]:
            for name, case in zip(known, some, strict=True):
                if again and again <= set(case.axes) and name not in forgotten:
                    summary_file(directory / CELLS, name).unlink(missing_ok=True)
            forgotten.update(known)
            return run_cases(some, directory / CELLS, options, known=known)

        try:
            if study.stop is None:
                outcomes = make(cases, names)
            else:
                outcomes = made_in_batches(
                    cases, study.intervals, study.stop, lambda ks: make([cases[k] for k in ks], [names[k] for k in ks])
                )
        except KeyboardInterrupt:
            kept = sum(summary_file(directory / CELLS, name).is_file() for name in names)
            raise KeyboardInterrupt(f"{kept} of {len(names)} runs are kept in {directory}") from None
        rows = rows_of(outcomes)
        if finish is None:
            write_study(title, study, outcomes, rows, directory)
        else:
            finish(directory, outcomes, lambda some: make(some, identities(some)))
    return StudyResult(directory, outcomes, rows)


_RUNS_FILE: Final = "runs.json"


def compare_runs(title: str, directories: Sequence[Path], out: Path | None) -> StudyResult:
    """Write the table and the report of finished runs to ``out``, or else to a directory as studies have.

    Raises:
        ValueError: one line, if a directory holds no finished run, or ``out`` holds something else.
    """
    named = json.dumps([str(directory.absolute()) for directory in directories], indent=2)
    identity = _sum([run_directory.digest(directory / "summary.json") for directory in directories])
    is_own = out is None
    out = out or own_directory(title, _RUNS_FILE, lambda file: file.read_text(encoding="utf-8") == named, identity)
    check_study_directory(out, _RUNS_FILE)
    names = names_of_runs(directories)
    outcomes = [_outcome(directory, name) for directory, name in zip(directories, names, strict=True)]
    kinds = {"slip" in outcome.numbers for outcome in outcomes}
    if len(kinds) > 1:
        raise ValueError("runs of trailers and of rovers can't be compared with each other")
    rows = rows_of(outcomes)
    text = finished_runs_page(outcomes, rows, [page_link(directory, out) for directory in directories])
    with opened_study(out, _RUNS_FILE, named, identity if is_own else ""):
        run_directory.replaced(out / "table.csv", table_csv(rows))
        run_directory.replaced(out / "report.html", text)
    return StudyResult(out, outcomes, rows)


def _outcome(directory: Path, name: str) -> Outcome:
    numbers = read_summary(directory)
    case = FinishedCase(scenario=str(directory / "scenario.toml"), fixed=(), axes=((RUN, name),), seed=0)
    return Outcome(case=case, numbers=numbers, signals=directory / "signals.parquet")
