"""A study from its cases to its tables and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from scenarios.progress import Progress, no_progress
from scenarios.studies.case import Case, Outcome, Settings, identities
from scenarios.studies.files import CELLS, check_study_directory, opened_study, study_text, write_study
from scenarios.studies.join import PLAN, forget, forget_failures, join_cases, planned
from scenarios.studies.pool import Executor, run_cases
from scenarios.studies.stopping import made_in_batches
from scenarios.studies.study import Study
from scenarios.studies.table import Row, rows_of

MakeMore = Callable[[Sequence[Case]], list[Outcome]]  # makes further runs, or takes those that are saved
Finish = Callable[[Sequence[Outcome], Sequence[Row], MakeMore], None]


def run_study(
    title: str,
    study: Study,
    directory: Path,
    *,
    jobs: int,
    timeout: float | None = None,
    join: float | None = None,
    executor: Executor | None = None,
    again: Settings = (),
    progress: Progress = no_progress,
    remark: Callable[[str], None] = lambda line: None,
    finish: Finish | None = None,
) -> tuple[list[Outcome], list[Row]]:
    """Run what the directory does not hold yet of a study, and write its tables and report.

    A run that takes longer than ``timeout`` [s] fails; None: any time. With ``join``, other commands may work in the
    directory at the same time; it is the time without a sign of life after which their runs are taken over [s]. An
    ``executor`` makes the runs elsewhere. Runs whose axes have the values ``again`` are made again. ``finish`` writes
    what is made of the runs, in place of `write_study`.

    Raises:
        ValueError: one line, for an invalid scenario or directory, before anything is written.
        KeyboardInterrupt: after the running processes have been stopped; finished runs are kept.
    """
    check_study_directory(directory, study.file)
    cases = study.cases()
    known = identities(cases)  # refuses invalid scenarios before anything is written
    if again and not any(set(again) <= set(case.axes) for case in cases):
        raise ValueError(f"--where {' '.join('='.join(pair) for pair in again)}: no run of the study has these values")
    if join is not None and (directory / PLAN).exists():
        planned(cases, directory)  # refuses another study before its file is replaced
    with opened_study(directory, study.file, study_text(study, directory), shared=join is not None):
        names = known if join is None else planned(cases, directory)
        for name, case in zip(names, cases, strict=True):
            if again and set(again) <= set(case.axes):
                forget(directory, name)

        def make(chosen: Sequence[int]) -> list[Outcome]:
            return make_named([cases[k] for k in chosen], [names[k] for k in chosen])

        def make_more(some: Sequence[Case]) -> list[Outcome]:
            return make_named(some, identities(some, portable=join is not None))

        def make_named(some: Sequence[Case], own: Sequence[str]) -> list[Outcome]:
            if join is None:
                return run_cases(
                    some,
                    directory / CELLS,
                    jobs=jobs,
                    known=own,
                    timeout=timeout,
                    executor=executor,
                    progress=progress,
                    remark=remark,
                )
            return join_cases(
                some,
                own,
                directory / CELLS,
                jobs=jobs,
                lease=join,
                timeout=timeout,
                progress=progress,
                remark=remark,
            )

        if study.stop is None:
            outcomes = make(range(len(cases)))
        else:
            outcomes = made_in_batches(cases, study.intervals, study.stop, make)
        if join is None:
            forget_failures(directory)
        rows = rows_of(outcomes)
        if finish is None:
            write_study(title, study, outcomes, rows, directory)
        else:
            finish(outcomes, rows, make_more)
    return outcomes, rows
