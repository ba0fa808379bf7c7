"""A study from its cases to its tables and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from offtrack.studies.case import Case, Outcome, Settings, identities
from offtrack.studies.draws import made_in_batches
from offtrack.studies.files import CELLS, check_study_directory, opened_study, study_text, write_study
from offtrack.studies.join import PLAN, forget, forget_failures, join_cases, planned
from offtrack.studies.pool import RunOptions, run_cases
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

    With ``options.join``, other commands may work in the directory at the same time. ``finish`` writes what is made of
    the runs, in place of `write_study`.

    Raises:
        ValueError: one line, for an invalid scenario or directory, before anything is written.
        KeyboardInterrupt: after the running processes have been stopped; finished runs are kept.
    """
    check_study_directory(directory, study.file)
    cases = study.cases()
    again, join = options.again, options.join
    known = identities(cases)  # refuses invalid scenarios before anything is written
    if again and not any(set(again) <= set(case.axes) for case in cases):
        raise ValueError(f"--where {' '.join('='.join(pair) for pair in again)}: no run of the study has these values")
    if join is not None and (directory / PLAN).exists():
        planned(cases, directory)  # refuses another study before its file is replaced
    with opened_study(directory, study.file, study_text(study, directory), shared=join is not None):
        names = known if join is None else planned(cases, directory)
        _forget(cases, names, directory, again)
        forgotten = set(names)

        def make(chosen: Sequence[int]) -> list[Outcome]:
            return _made([cases[k] for k in chosen], [names[k] for k in chosen], directory, options)

        def make_more(some: Sequence[Case]) -> list[Outcome]:
            own = identities(some, portable=join is not None)
            new = {name: case for name, case in zip(own, some, strict=True) if name not in forgotten}
            _forget(list(new.values()), list(new), directory, again)
            forgotten.update(new)
            return _made(some, own, directory, options)

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


def _forget(cases: Sequence[Case], names: Sequence[str], directory: Path, again: Settings) -> None:
    """Forget the runs whose axes have the values ``again``, so that they are made again; no values: none."""
    for name, case in zip(names, cases, strict=True):
        if again and set(again) <= set(case.axes):
            forget(directory, name)


def _made(cases: Sequence[Case], names: Sequence[str], directory: Path, options: RunOptions) -> list[Outcome]:
    """Outcomes of runs that are saved in the directory or made now, alone or together with other commands."""
    if options.join is None:
        return run_cases(
            cases,
            directory / CELLS,
            jobs=options.jobs,
            known=names,
            timeout=options.timeout,
            executor=options.executor,
            progress=options.progress,
            remark=options.remark,
        )
    return join_cases(
        cases,
        names,
        directory / CELLS,
        jobs=options.jobs,
        lease=options.join,
        timeout=options.timeout,
        progress=options.progress,
        remark=options.remark,
    )
