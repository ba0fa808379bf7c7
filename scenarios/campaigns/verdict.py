"""Verdict on one run of a campaign: requirements that it broke, with the reason and the value."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

from scenarios.campaigns.fault_entry import FaultTime, fault_time
from scenarios.campaigns.requirements import Requirements
from scenarios.campaigns.response import Response, response
from scenarios.results.log import read_log
from scenarios.studies.case import MOST_CASES, Case, Outcome, composed

END_OF_RUN, DETECTION, RECOVERY = "outcome", "time to detect", "time to recover"
_WORST: Final = 1e9  # severity of a run that did not end as it should


class Breach(NamedTuple):
    """A broken requirement."""

    requirement: str  # as tables name it
    reason: str  # with the value
    severity: float  # value over limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A run with its verdict."""

    outcome: Outcome
    fault: str  # title of the entry; "none" for a reference
    breaches: tuple[Breach, ...]
    response: Response
    reached: bool  # False: the run was completed before its fault began, so that it tells nothing
    severity: float  # of its worst requirement, broken or not

    @property
    def failed(self) -> bool:
        """True if a requirement is broken."""
        return bool(self.breaches)

    @property
    def verdict(self) -> str:
        """The verdict in a word."""
        return "failed" if self.failed else "passed" if self.reached else "fault not reached"

    @property
    def reasons(self) -> str:
        """All broken requirements with their values."""
        return "; ".join(breach.reason for breach in self.breaches)


def judged(outcome: Outcome, fault: str, requirements: Requirements) -> Judgement:
    """Judge a run by its summary and its signals."""
    time = time_of(outcome.case)
    measured = _response(outcome, time, requirements)
    checks = list(_checks(outcome, time, measured, requirements))
    end = outcome.number("timing.simulated_s")
    return Judgement(
        outcome=outcome,
        fault=fault,
        breaches=tuple(check for check in checks if check.severity > 1.0),
        response=measured,
        reached=time is None or not outcome.completed or end is None or time.onset < end,
        severity=max((check.severity for check in checks), default=0.0),
    )


def time_of(case: Case) -> FaultTime | None:
    """When the faults of a run act; None: it has none."""
    text = dict(case.axes).get("faults", "")
    return fault_time(composed("faults", text, case.drawn))


def _response(outcome: Outcome, time: FaultTime | None, requirements: Requirements) -> Response:
    if outcome.signals is None or not outcome.signals.is_file():
        return Response()
    return _response_in(outcome.signals, time, requirements.recovered_below, outcome.completed)


@lru_cache(maxsize=MOST_CASES)  # a file of signals is named by its content
def _response_in(signals: Path, time: FaultTime | None, below: float, completed: bool) -> Response:
    return response(read_log(signals), time, recovered_below=below, completed=completed)


def _checks(
    outcome: Outcome, time: FaultTime | None, measured: Response, requirements: Requirements
) -> Iterator[Breach]:
    """Every requirement that applies; a severity above 1 breaks it."""
    ending = str(outcome.numbers["outcome"])
    yield Breach(END_OF_RUN, ending, 0.0 if ending in requirements.outcomes else _WORST)
    if ending.startswith("failed"):
        return
    for limit in requirements.limits:
        value = outcome.number(limit.path)
        text = f"{limit.path} = {'no value' if value is None else f'{value:.4g}'}"
        yield Breach(limit.path, text, math.inf if value is None else limit.severity(value))
    if time is not None:
        yield from _timely(outcome, time, measured, requirements)


def _timely(outcome: Outcome, time: FaultTime, measured: Response, requirements: Requirements) -> Iterator[Breach]:
    """Times to detect and to recover, as far as they apply: not if fault or course ended before they had to come."""
    simulated = outcome.number("timing.simulated_s")
    ran = math.inf if simulated is None or not outcome.completed else simulated
    over = math.inf if time.end is None else time.end
    is_harmless = requirements.harmless_below > 0.0 and measured.deviation <= requirements.harmless_below
    for name, longest, value, room in (
        (DETECTION, None if is_harmless else requirements.detect, measured.detection, min(over, ran) - time.onset),
        (RECOVERY, requirements.recover, measured.recovery, ran - over),
    ):
        never = math.isinf(value)
        if longest is not None and not math.isnan(value) and not (never and room < longest):
            yield Breach(name, f"{name}: {'never' if never else f'{value:.2f} s'}", value / longest)
