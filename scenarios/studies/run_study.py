"""A study from its cases to its tables and report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scenarios.progress import Progress, no_progress
from scenarios.studies.case import Outcome, identities
from scenarios.studies.files import CELLS, check_study_directory, opened_study, study_text, write_study
from scenarios.studies.pool import run_cases
from scenarios.studies.study import FILE, Study
from scenarios.studies.table import Row, rows_of


def run_study(
    title: str,
    study: Study,
    directory: Path,
    *,
    jobs: int,
    timeout: float | None = None,
    progress: Progress = no_progress,
    remark: Callable[[str], None] = lambda line: None,
) -> tuple[list[Outcome], list[Row]]:
    """Run what the directory does not hold yet of a study, and write its tables and report.

    A run that takes longer than ``timeout`` [s] fails; None: any time.

    Raises:
        ValueError: one line, for an invalid scenario or directory, before anything is written.
        KeyboardInterrupt: after the running processes have been stopped; finished runs are kept.
    """
    check_study_directory(directory)
    cases = study.cases()
    known = identities(cases)  # refuses invalid scenarios before anything is written
    with opened_study(directory, FILE, study_text(study, directory)):
        outcomes = run_cases(
            cases, directory / CELLS, jobs=jobs, known=known, timeout=timeout, progress=progress, remark=remark
        )
        rows = rows_of(outcomes)
        write_study(title, study, outcomes, rows, directory)
    return outcomes, rows
