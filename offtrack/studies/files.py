"""Directory of a study: study file, tables, report, and the runs in ``cells``; an existing study is resumed."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv as pa_csv

from offtrack.studies.case import Made, Outcome
from offtrack.studies.study import FILE, Study
from offtrack.studies.table import QUANTITIES, Row, shown_quantities, table_csv
from scenarios.results.atomic_files import replaced, replacing, unfinished_files, user_of


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
    for name in Made._fields:
        columns[name] = [None if outcome.made is None else getattr(outcome.made, name) for outcome in outcomes]
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
    from offtrack.studies.run_pages import write_run_pages  # matplotlib, which workers need not import
    from offtrack.studies.study_page import sensitivity_csv, study_page

    replaced(directory / "table.csv", table_csv(rows))
    _write_parquet(rows, directory / "table.parquet")
    runs = runs_table(outcomes)
    for name, write in (("runs.csv", pa_csv.write_csv), ("runs.parquet", pq.write_table)):
        with replacing(directory / name) as unfinished:
            write(runs, unfinished)
    if study.draws.sensitivity:
        replaced(directory / "sensitivity.csv", sensitivity_csv(study.draws.sensitivity, outcomes))
    links = write_run_pages(outcomes, directory)
    replaced(directory / "report.html", study_page(title, study, outcomes, rows, links))


def _write_parquet(rows: Sequence[Row], path: Path) -> None:
    columns: dict[str, list[str | int | float | None]] = {
        key: [dict(row.axes)[key] for row in rows] for key in (dict(rows[0].axes) if rows else {})
    }
    columns |= {"runs": [row.runs for row in rows], "completed": [row.completed for row in rows]}
    columns |= {q.column: [row.numbers[q.path] for row in rows] for q in shown_quantities(rows)}
    with replacing(path) as unfinished:
        pq.write_table(pa.table(columns), unfinished)
