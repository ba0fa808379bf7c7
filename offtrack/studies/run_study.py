"""A study from its cases to its tables and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from offtrack.studies.case import Case, Outcome, identities
from offtrack.studies.draws import made_in_batches
from offtrack.studies.files import CELLS, check_study_directory, opened_study, study_text, write_study
from offtrack.studies.pool import RunOptions, run_cases, summary_file
from offtrack.studies.study import Study
from offtrack.studies.table import Row, rows_of

MakeMore = Callable[[Sequence[Case]], list[Outcome]]  # makes further runs, or takes those that are saved
Finish = Callable[[Sequence[Outcome], Sequence[Row], MakeMore], None]


def run_study(
    title: str,
    study: Study,
    directory: Path,
    options: RunOptions,
    *,
    finish: Finish | None = None,
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

        def make_chosen(chosen: Sequence[int]) -> list[Outcome]:
            return make([cases[k] for k in chosen], [names[k] for k in chosen])

        if study.stop is None:
            outcomes = make(cases, names)
        else:
            outcomes = made_in_batches(cases, study.intervals, study.stop, make_chosen)
        rows = rows_of(outcomes)
        if finish is None:
            write_study(title, study, outcomes, rows, directory)
        else:
            finish(outcomes, rows, lambda some: make(some, identities(some)))
    return outcomes, rows
