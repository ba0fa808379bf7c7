"""The directory of a study: study file, table, report, and the runs in ``cells``. An existing study is resumed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from scenarios.studies.case import Outcome
from scenarios.studies.study import FILE, Study
from scenarios.studies.study_page import study_page
from scenarios.studies.table import Row, shown_quantities, table_csv


def check_study_directory(directory: Path) -> None:
    """Refuse a directory that is not empty and does not hold a study.

    Raises:
        ValueError: one line.
    """
    if directory.exists() and not directory.is_dir():
        raise ValueError(f"{directory} is a file: choose another name")
    if directory.is_dir() and any(directory.iterdir()) and not (directory / FILE).is_file():
        raise ValueError(f"directory {directory} is not empty and holds no {FILE}: choose another")


def opened_study(study: Study, directory: Path) -> Path:
    """Write the study file, and return the folder for the runs."""
    cells = directory / "cells"
    cells.mkdir(parents=True, exist_ok=True)
    replaced(directory / FILE, study.to_toml())
    return cells


def write_study(title: str, study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row], directory: Path) -> None:
    """Write the table (CSV, Parquet) and the report of a finished study."""
    replaced(directory / "table.csv", table_csv(rows))
    _write_parquet(rows, directory / "table.parquet")
    replaced(directory / "report.html", study_page(title, study, outcomes, rows, directory / "cells"))


def replaced(path: Path, text: str) -> None:
    """Write a text file atomically: complete or not at all."""
    unfinished = path.with_name(f".{path.name}.unfinished")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(path)


def _write_parquet(rows: Sequence[Row], path: Path) -> None:
    columns: dict[str, list[str | int | float | None]] = {
        key: [dict(row.axes)[key] for row in rows] for key in (dict(rows[0].axes) if rows else {})
    }
    columns |= {"runs": [row.runs for row in rows], "completed": [row.completed for row in rows]}
    columns |= {q.column: [row.numbers[q.path] for row in rows] for q in shown_quantities(rows)}
    unfinished = path.with_name(f".{path.name}.unfinished")
    pq.write_table(pa.table(columns), unfinished)
    unfinished.replace(path)
