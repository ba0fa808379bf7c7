"""Smallest amount or duration of a fault at which a run fails, by bisection; its runs are kept as all others are."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

from scenarios.campaigns.bisect_table import Bisect
from scenarios.campaigns.campaign import FAULTS, Campaign, wants
from scenarios.campaigns.fault_entry import FaultEntry, fault_options
from scenarios.campaigns.verdict import Judgement
from scenarios.studies.case import Case, Outcome, Settings

Finding = Literal["found", "never fails", "always fails"]
Make = Callable[[Sequence[Case]], Sequence[Outcome]]


@dataclass(kw_only=True)
class Search:
    """One search: a fault with one law, further axes and seed."""

    table: Bisect
    entry: FaultEntry
    template: Case  # a run of the campaign with this law, axes and seed
    law: str
    further: str
    tried: dict[float, Judgement] = field(default_factory=dict)  # by the value
    elsewhere: dict[float, bool] = field(default_factory=dict)  # of the campaign's runs: True if it failed

    @property
    def seed(self) -> int:
        """Seed of its runs."""
        return self.template.seed

    def case(self, value: float) -> Case:
        """The run with this value."""
        fault = self.table.text_of(self.entry, value)
        axes = tuple((key, fault if key == FAULTS else text) for key, text in self.template.axes)
        return dataclasses.replace(self.template, axes=axes)

    def next(self) -> float | None:
        """Value of the next run; None: the search has ended."""
        for end in (self.table.low, self.table.high):
            if end not in self.tried:
                return end
        if self.finding != "found":
            return None
        low, high = self.bracket
        middle = float(f"{0.5 * (low + high):.6g}")  # as the text of a fault has it
        return middle if high - low > self.table.tolerance and low < middle < high else None

    @property
    def finding(self) -> Finding:
        """Finding so far, once both ends are tried."""
        if self.tried[self.table.low].failed:
            return "always fails"
        return "found" if self.tried[self.table.high].failed else "never fails"

    @property
    def bracket(self) -> tuple[float, float]:
        """The largest value below which no run of the search failed, and the smallest that failed above it."""
        high = min(value for value, run in self.tried.items() if run.failed)
        passed = (value for value, run in self.tried.items() if not run.failed and value < high)
        return max(passed, default=-math.inf), high

    @property
    def exceptions(self) -> tuple[float, ...]:
        """Values of runs that contradict one threshold: larger ones that passed, smaller ones that failed."""
        known = {value: run.failed for value, run in self.tried.items()} | self.elsewhere
        if self.finding == "found":
            threshold = self.bracket[1]
        else:
            threshold = math.inf if self.finding == "never fails" else -math.inf
        inside = {v: failed for v, failed in known.items() if self.table.low <= v <= self.table.high}
        return tuple(sorted(v for v, failed in inside.items() if failed != (v >= threshold)))


def bisected(campaign: Campaign, runs: Sequence[Judgement], make: Make) -> list[Search]:
    """All searches of a campaign, each to its end; every round makes one run of each that is open.

    Args:
        campaign: the campaign.
        runs: its runs.
        make: makes runs, or takes those that are saved.
    """
    searches = [search for table in campaign.bisections for search in _searches(campaign, table)]
    while open_ones := [(search, value) for search in searches if (value := search.next()) is not None]:
        outcomes = make([search.case(value) for search, value in open_ones])
        for (search, value), outcome in zip(open_ones, outcomes, strict=True):
            search.tried[value] = dataclasses.replace(campaign.judge(outcome), fault=search.entry.title)
    for search in searches:
        search.elsewhere = dict(_elsewhere(search, runs))
    return searches


def _searches(campaign: Campaign, table: Bisect) -> Iterator[Search]:
    (entry,) = (entry for entry in campaign.entries if entry.title == table.fault)
    seen = set[tuple[Settings, int]]()
    for case in campaign.cases():
        point = campaign.others(case), case.seed
        if campaign.entry_of(case) is entry and wants(table, case) and point not in seen:
            seen.add(point)
            axes = dict(case.axes)
            further = " · ".join(axes[key] for key in campaign.further)
            yield Search(table=table, entry=entry, template=case, law=axes.get(campaign.law, ""), further=further)


def _elsewhere(search: Search, runs: Sequence[Judgement]) -> Iterator[tuple[float, bool]]:
    """Runs of the campaign that differ from those of the search in the value alone."""
    for run in runs:
        case = run.outcome.case
        same = dataclasses.replace(case, axes=search.template.axes) == search.template
        if run.fault != search.entry.title or not same or not _same_others(case, search.template):
            continue
        value = _value(search, dict(case.axes)[FAULTS])
        if value is not None and search.case(value).axes == case.axes:
            yield value, run.failed


def _same_others(case: Case, other: Case) -> bool:
    return [pair for pair in case.axes if pair[0] != FAULTS] == [pair for pair in other.axes if pair[0] != FAULTS]


def _value(search: Search, text: str) -> float | None:
    """The searched number in the text of a fault; None: it has none of its own."""
    if "{" in text:
        return None
    (fault, *_) = fault_options(text)
    return (fault.amount[0] if fault.amount else None) if search.table.of == "amount" else fault.duration
