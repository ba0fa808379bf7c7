"""Runs of studies in the process of the tests: a worker takes two seconds of processor time to start."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import pytest

MODULES = ("offtrack.studies.pool", "offtrack.studies.join", "offtrack.studies.tuning")


def make_runs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the runs of studies in this process; files that they open without being named are not watched."""
    for module in MODULES:
        monkeypatch.setattr(f"{module}.each_in_a_worker", _each_here)
    for module in ("offtrack.studies.pool", "offtrack.studies.tuning"):
        monkeypatch.setattr(f"{module}.watch_files", lambda: None)
        monkeypatch.setattr(f"{module}.opened_files", lambda named: {})


def _each_here(
    work: Callable[..., Any],
    tasks: Mapping[str, Sequence[object]] | Iterator[tuple[str, Sequence[object]] | None],
    *,
    jobs: int,
    timeout: float | None = None,
) -> Iterator[tuple[str, Any]]:
    """As ``each_in_a_worker``, one task after the other."""
    for task in iter(tasks.items()) if isinstance(tasks, Mapping) else tasks:
        if task is None:
            time.sleep(0.02)
            continue
        key, arguments = task
        try:
            output = work(*arguments)
        except Exception as error:
            output = error
        yield key, output
