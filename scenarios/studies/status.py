"""State of a study that is being made: what is finished, running, failed and waiting."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from scenarios.studies.case import identities
from scenarios.studies.claims import Claim, Claims
from scenarios.studies.files import CELLS
from scenarios.studies.join import CLAIMS, FAILED, PLAN, planned
from scenarios.studies.pool import summary_file
from scenarios.studies.provenance import Made
from scenarios.studies.study import Study


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """Counts of runs; those that no command with ``--join`` has claimed count as waiting."""

    runs: int
    finished: int
    failed: Sequence[tuple[str, str]]  # title and reason
    running: Sequence[tuple[str, Claim]]  # title, and whose it is
    mean_seconds: float | None  # of the finished runs
    machines: Sequence[str]

    @property
    def waiting(self) -> int:
        """Number of runs that nobody has begun."""
        return self.runs - self.finished - len(self.failed) - len(self.running)

    @property
    def remaining_seconds(self) -> float | None:
        """Estimate of the time until all are made by those who work now; None: nobody works, or nothing is known."""
        if self.mean_seconds is None or not self.running:
            return None
        return math.ceil((self.waiting + len(self.running)) / len(self.running)) * self.mean_seconds


def status(study: Study, directory: Path) -> Status:
    """State of a study in its directory.

    Raises:
        ValueError: one line, if the directory holds another study.
    """
    cases = study.cases()
    names = planned(cases, directory) if (directory / PLAN).exists() else identities(cases)
    titles = {name: case.title for name, case in zip(names, cases, strict=True)}
    saved = [name for name in titles if summary_file(directory / CELLS, name).exists()]
    failures = directory / FAILED
    failed = [
        (titles[path.name], path.read_text(encoding="utf-8"))
        for path in (sorted(failures.iterdir()) if failures.is_dir() else ())
        if path.name in titles and path.name not in saved
    ]
    claims = Claims(directory / CLAIMS).all() if (directory / CLAIMS).is_dir() else []
    running = [(titles[claim.name], claim) for claim in claims if claim.name in titles and claim.name not in saved]
    provenance = [made for name in saved if (made := _made(summary_file(directory / CELLS, name))) is not None]
    return Status(
        runs=len(cases),
        finished=len(saved),
        failed=failed,
        running=running,
        mean_seconds=sum(made.seconds for made in provenance) / len(provenance) if provenance else None,
        machines=tuple(dict.fromkeys(made.machine for made in provenance)),
    )


def silent_for(claim: Claim) -> float:
    """Time since a claim's last sign of life, by this machine's clock [s]."""
    return max(0.0, time.time() - claim.touched)


def _made(path: Path) -> Made | None:
    try:
        return Made.of(json.loads(path.read_text(encoding="utf-8"))["made"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
