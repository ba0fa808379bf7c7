"""Runs of studies in the process of the tests: a worker takes two seconds of processor time to start."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import pytest

MODULES = ("offtrack.studies.pool", "offtrack.studies.trials")


def make_runs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the runs of studies in this process; files that they open without being named are not watched."""
    for module in MODULES:
        monkeypatch.setattr(f"{module}.each_in_a_worker", _each_here)
        monkeypatch.setattr(f"{module}.watch_files", lambda: None)
        monkeypatch.setattr(f"{module}.opened_files", lambda named: {})


def _each_here(
    work: Callable[..., Any],
    tasks: Mapping[str, Sequence[object]],
    *,
    jobs: int,
    timeout: float | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> Iterator[tuple[str, Any]]:
    """As ``each_in_a_worker``, one task after the other."""
    for key, arguments in tasks.items():
        try:
            output = work(*arguments)
        except Exception as error:
            output = error
        yield key, output
