"""How the runs of a study are made, whatever it is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from scenarios.progress import Progress, no_progress
from scenarios.studies.case import Settings
from scenarios.studies.pool import Executor


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """How the runs of a study are made."""

    jobs: int  # worker processes
    timeout: float | None = None  # longest time of a run, which fails then [s]; None: any
    join: float | None = None  # [s] without a sign of life after which a run of another command is taken over
    executor: Executor | None = None  # makes the runs elsewhere
    again: Settings = ()  # runs whose axes have these values are made again
    progress: Progress = no_progress  # of the runs
    remark: Callable[[str], None] = lambda line: None  # receives a line on every damaged run, which is made again
