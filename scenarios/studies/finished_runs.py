"""Comparison of finished runs."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from scenarios.results.files import replaced
from scenarios.studies.case import RUN, FinishedCase, Outcome
from scenarios.studies.files import check_study_directory, opened_study
from scenarios.studies.study_page import finished_runs_page
from scenarios.studies.table import Row, rows_of, table_csv
from vehicle.user_file import FileKind, read_text

_FILE: Final = "runs.json"


def compare_runs(directories: Sequence[Path], out: Path) -> list[Row]:
    """Write the table and the report of finished runs; return the rows.

    Raises:
        ValueError: one line, if a directory holds no finished run, or ``out`` holds something else.
    """
    check_study_directory(out, _FILE)
    names = names_of_runs(directories)
    outcomes = [_outcome(directory, name) for directory, name in zip(directories, names, strict=True)]
    kinds = {"slip" in outcome.numbers for outcome in outcomes}
    if len(kinds) > 1:
        raise ValueError("runs of trailers and of rovers can't be compared with each other")
    rows = rows_of(outcomes)
    page = finished_runs_page(outcomes, rows, [page_link(directory, out) for directory in directories])
    with opened_study(out, _FILE, json.dumps([str(directory.absolute()) for directory in directories], indent=2)):
        replaced(out / "table.csv", table_csv(rows))
        replaced(out / "report.html", page)
    return rows


def page_link(directory: Path, folder: Path) -> str:
    """Address of a run's own page from a folder; empty if there is none."""
    report = directory / "report.html"
    return Path(os.path.relpath(report, folder)).as_posix() if report.is_file() else ""


def names_of_runs(directories: Sequence[Path]) -> list[str]:
    """Short names that differ: the last parts of the paths, as many as it takes.

    Raises:
        ValueError: one line, if a run is named twice.
    """
    paths = [directory.absolute() for directory in directories]
    if len(set(paths)) < len(paths):
        raise ValueError("a run is named twice")
    count = 1
    while len({path.parts[-count:] for path in paths}) < len(paths):
        count += 1
    return [os.path.join(*path.parts[-count:]) for path in paths]


def _outcome(directory: Path, name: str) -> Outcome:
    for file in ("summary.json", "scenario.toml", "signals.parquet"):
        if not (directory / file).is_file():
            raise ValueError(f"{directory}: is no finished run: it has no {file}")
    try:
        numbers: Any = json.loads(read_text(directory / "summary.json", FileKind.RECORD))
    except json.JSONDecodeError as error:
        raise ValueError(f"{directory / 'summary.json'}: not JSON: {error.msg}") from None
    if not isinstance(numbers, dict) or "outcome" not in numbers:
        raise ValueError(f"{directory / 'summary.json'}: is no summary of a run")
    case = FinishedCase(scenario=str(directory / "scenario.toml"), fixed=(), axes=((RUN, name),), seed=0)
    return Outcome(case=case, numbers=numbers, signals=directory / "signals.parquet")
