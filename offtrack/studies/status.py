"""State of a study that is being made: what is finished, running, failed and waiting."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from offtrack.studies.case import Case, Made, identities
from offtrack.studies.claims import Claim, Claims
from offtrack.studies.draws import spared
from offtrack.studies.files import CELLS
from offtrack.studies.join import CLAIMS, FAILED, PLAN, planned
from offtrack.studies.pool import outcome_of, summary_file
from offtrack.studies.study import Study


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """Counts of runs; those that no command with ``--join`` has claimed count as waiting."""

    runs: int
    finished: int
    failed: Sequence[tuple[str, str]]  # title and reason
    running: Sequence[tuple[str, Claim]]  # title, and whose it is
    mean_seconds: float | None  # of the finished runs
    machines: Sequence[str]
    spared: int = 0  # draws that need not be made, as the probabilities of their points are known

    @property
    def waiting(self) -> int:
        """Number of runs that nobody has begun; with ``stop``, at most so many."""
        return self.runs - self.spared - self.finished - len(self.failed) - len(self.running)

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
    reasons = {name: text for name, text in _failures(directory / FAILED) if name in titles and name not in saved}
    failed = [(titles[name], text) for name, text in reasons.items()]
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
        spared=_spared(study, cases, names, directory / CELLS, reasons) if study.stop else 0,
    )


def _spared(study: Study, cases: Sequence[Case], names: Sequence[str], cells: Path, failed: Mapping[str, str]) -> int:
    """Number of draws that are not made and need not be."""
    done = {
        k: outcome_of(case, cells, name, failed)
        for k, (name, case) in enumerate(zip(names, cases, strict=True))
        if name in failed or summary_file(cells, name).exists()
    }
    return len(spared(cases, study.intervals, study.stop, done) - set(done)) if study.stop else 0


def _failures(folder: Path) -> Iterator[tuple[str, str]]:
    """Names of the runs that failed while commands worked together, and why."""
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        yield path.name, path.read_text(encoding="utf-8")


def silent_for(claim: Claim) -> float:
    """Time since a claim's last sign of life, by this machine's clock [s]."""
    return max(0.0, time.time() - claim.touched)


def _made(path: Path) -> Made | None:
    try:
        return Made.of(json.loads(path.read_text(encoding="utf-8"))["made"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
