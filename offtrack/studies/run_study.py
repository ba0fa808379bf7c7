"""A study from its cases to its tables and report, and its directory.

The directory holds the study file, tables, the report, and the runs in ``cells``; an existing study is resumed.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv as pa_csv

from offtrack.reports.run_files import read_summary
from offtrack.studies.case import RUN, Case, FinishedCase, Outcome, Provenance, identities
from offtrack.studies.draws import made_in_batches
from offtrack.studies.pool import RunOptions, run_cases, summary_file
from offtrack.studies.study import FILE, Study
from offtrack.studies.study_figures import write_run_pages
from offtrack.studies.study_page import finished_runs_page, names_of_runs, page_link, sensitivity_csv, study_page
from offtrack.studies.table import QUANTITIES, Row, rows_of, shown_quantities, table_csv
from scenarios.results.run_directory import replaced, replacing, unfinished_files, user_of


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


def check_study_directory(directory: Path, file: str = FILE) -> None:
    """Refuse a directory that is not empty and does not hold a study, which has a file of this name.

    Raises:
        ValueError: one line.
    """
    if os.path.lexists(directory) and not directory.is_dir():
        raise ValueError(f"{directory} is a file or a broken link: choose another name")
    if not directory.is_dir() or (directory / file).is_file():
        return
    if set(directory.iterdir()) - set(unfinished_files(directory)):
        raise ValueError(f"directory {directory} is not empty and holds no {file}: choose another")


def study_text(study: Study, directory: Path) -> str:
    """The study as TOML: the file that is in the directory, with its comments, if it describes the same study."""
    try:
        same = study.load(directory / study.file) == study
    except ValueError:
        same = False
    return (directory / study.file).read_text(encoding="utf-8") if same else study.to_toml()


@contextmanager
def opened_study(directory: Path, file: str, content: str) -> Iterator[None]:
    """Lock the directory of a study, write its file, and remove what killed processes have left.

    Raises:
        ValueError: one line, if another process works in it.
    """
    directory.mkdir(parents=True, exist_ok=True)
    with user_of(directory):
        replaced(directory / file, content)
        for folder in (directory, directory / CELLS):
            for path in unfinished_files(folder) if folder.is_dir() else ():
                path.unlink()
        yield


def write_study(title: str, study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row], directory: Path) -> None:
    """Write the table of points and that of runs (CSV, Parquet), pages of runs, and the report of a finished study."""
    replaced(directory / "table.csv", table_csv(rows))
    columns: dict[str, list[str | int | float | None]] = {
        key: [dict(row.axes)[key] for row in rows] for key in (dict(rows[0].axes) if rows else {})
    }
    columns |= {"runs": [row.runs for row in rows], "completed": [row.completed for row in rows]}
    columns |= {q.column: [row.numbers[q.path] for row in rows] for q in shown_quantities(rows)}
    with replacing(directory / "table.parquet") as unfinished:
        pq.write_table(pa.table(columns), unfinished)
    runs = runs_table(outcomes)
    for name, write in (("runs.csv", pa_csv.write_csv), ("runs.parquet", pq.write_table)):
        with replacing(directory / name) as unfinished:
            write(runs, unfinished)
    if study.draws.sensitivity:
        replaced(directory / "sensitivity.csv", sensitivity_csv(study.draws.sensitivity, outcomes))
    links = write_run_pages(outcomes, directory)
    replaced(directory / "report.html", study_page(title, study, outcomes, rows, links))


MakeMore = Callable[[Sequence[Case]], list[Outcome]]  # makes further runs, or takes those that are saved
Finish = Callable[[Sequence[Outcome], Sequence[Row], MakeMore], None]


def run_study(
    title: str, study: Study, directory: Path, options: RunOptions, *, finish: Finish | None = None
) -> tuple[list[Outcome], list[Row]]:
    """Run what the directory does not hold yet of a study, and write its tables and report.

    ``finish`` writes what is made of
    the runs, in place of `write_study`.

    Raises:
        ValueError: one line, for an invalid scenario or directory, before anything is written.
        KeyboardInterrupt: after the running processes have been stopped; finished runs are kept.
    """
    check_study_directory(directory, study.file)
    cases = study.cases()
    names = identities(cases)  # refuses invalid scenarios before anything is written
    again = set(options.again)
    if again and not any(again <= set(case.axes) for case in cases):
        pairs = " ".join(map("=".join, options.again))
        raise ValueError(f"--where {pairs}: no run of the study has these values")
    with opened_study(directory, study.file, study_text(study, directory)):
        forgotten = set[str]()

        def make(some: Sequence[Case], known: Sequence[str]) -> list[Outcome]:
            for name, case in zip(known, some, strict=True):
                if again and again <= set(case.axes) and name not in forgotten:
                    summary_file(directory / CELLS, name).unlink(missing_ok=True)
            forgotten.update(known)
            return run_cases(some, directory / CELLS, options, known=known)

        if study.stop is None:
            outcomes = make(cases, names)
        else:
            outcomes = made_in_batches(
                cases, study.intervals, study.stop, lambda ks: make([cases[k] for k in ks], [names[k] for k in ks])
            )
        rows = rows_of(outcomes)
        if finish is None:
            write_study(title, study, outcomes, rows, directory)
        else:
            finish(outcomes, rows, lambda some: make(some, identities(some)))
    return outcomes, rows


_RUNS_FILE: Final = "runs.json"


def compare_runs(directories: Sequence[Path], out: Path) -> list[Row]:
    """Write the table and the report of finished runs; return the rows.

    Raises:
        ValueError: one line, if a directory holds no finished run, or ``out`` holds something else.
    """
    check_study_directory(out, _RUNS_FILE)
    names = names_of_runs(directories)
    outcomes = [_outcome(directory, name) for directory, name in zip(directories, names, strict=True)]
    kinds = {"slip" in outcome.numbers for outcome in outcomes}
    if len(kinds) > 1:
        raise ValueError("runs of trailers and of rovers can't be compared with each other")
    rows = rows_of(outcomes)
    text = finished_runs_page(outcomes, rows, [page_link(directory, out) for directory in directories])
    with opened_study(out, _RUNS_FILE, json.dumps([str(directory.absolute()) for directory in directories], indent=2)):
        replaced(out / "table.csv", table_csv(rows))
        replaced(out / "report.html", text)
    return rows


def _outcome(directory: Path, name: str) -> Outcome:
    numbers = read_summary(directory)
    case = FinishedCase(scenario=str(directory / "scenario.toml"), fixed=(), axes=((RUN, name),), seed=0)
    return Outcome(case=case, numbers=numbers, signals=directory / "signals.parquet")
