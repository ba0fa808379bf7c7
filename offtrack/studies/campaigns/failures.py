"""Failures of a campaign's runs by fault, law and requirement, and the smallest fault that fails, by bisection."""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, TypeVar

import numpy as np

from offtrack.studies.campaigns.campaign import FAULTS, Campaign, wants
from offtrack.studies.campaigns.fault_entry import NONE, Bisect, FaultEntry, fault_options
from offtrack.studies.campaigns.verdict import DETECTION, END_OF_RUN, RECOVERY, Judgement
from offtrack.studies.case import Case, Outcome, Settings
from offtrack.studies.table import Exceeding

KeyT = TypeVar("KeyT")
Place = tuple[str, str, str]  # fault, values of the further axes, law
ALL: Final = "all faults"
_CRASHED: Final = ("failed", "diverged")  # begin outcomes without a physical end


class Times(NamedTuple):
    """Times to detect or to recover over several runs [s]."""

    known: int  # runs to which they apply
    never: int  # of these
    median: float  # NaN: nothing is known; infinite: never in half of the runs or more
    worst: float

    @classmethod
    def of(cls, values: Iterable[float]) -> "Times":
        """Of values that are infinite for never, and NaN where they do not apply."""
        known = np.array([value for value in values if not math.isnan(value)])
        if not known.size:
            return cls(0, 0, math.nan, math.nan)
        ordered = np.sort(known)
        return cls(len(known), int(np.isinf(known).sum()), float(ordered[(len(known) - 1) // 2]), float(ordered[-1]))


class Cell(NamedTuple):
    """Runs of one fault, law and values of the further axes."""

    place: Place
    runs: tuple[Judgement, ...]  # those whose fault was reached

    @property
    def failing(self) -> Exceeding:
        """Number of failures, with the interval of the probability."""
        return Exceeding(sum(run.failed for run in self.runs), len(self.runs))

    @property
    def crashed(self) -> int:
        """Runs without a physical end: an exception, a time limit, or equations that diverged."""
        return sum(str(run.outcome.numbers["outcome"]).startswith(_CRASHED) for run in self.runs)

    @property
    def detection(self) -> Times:
        """Times to detect."""
        return Times.of(run.response.detection for run in self.runs)

    @property
    def recovery(self) -> Times:
        """Times to recover."""
        return Times.of(run.response.recovery for run in self.runs)

    @property
    def endings(self) -> Mapping[str, int]:
        """Number of runs by outcome."""
        return Counter(str(run.outcome.numbers["outcome"]).partition(":")[0] for run in self.runs)

    @property
    def worst(self) -> Judgement:
        """The run with the worst broken requirement, or the one nearest to breaking one."""
        return max(self.runs, key=badness)


def badness(run: Judgement) -> tuple[float, float]:
    """Order of runs, the worst last: by their worst requirement, then by the follow point's deviation."""
    return min(run.severity, 1e300), run.outcome.number("off_tracking.true_max_m") or 0.0


def cells_of(campaign: Campaign, runs: Sequence[Judgement]) -> list[Cell]:
    """Cells in the order of the runs; runs that were completed before their fault began are left out."""
    grouped = by(runs, lambda run: place_of(campaign, run))
    return [
        Cell(place, tuple(reached)) for place, group in grouped.items() if (reached := [r for r in group if r.reached])
    ]


def totals(cells: Sequence[Cell]) -> list[Cell]:
    """Of each law and further axes the runs with any fault; none if there is one fault alone."""
    faulty = [cell for cell in cells if cell.place[0] != NONE]
    if len({cell.place[0] for cell in faulty}) < 2:
        return []
    places = dict.fromkeys(cell.place[1:] for cell in faulty)
    return [
        Cell((ALL, *place), tuple(run for cell in faulty if cell.place[1:] == place for run in cell.runs))
        for place in places
    ]


def place_of(campaign: Campaign, run: Judgement) -> Place:
    """Place of a run in the tables."""
    axes = dict(run.outcome.case.axes)
    further = [axes[key] for key in campaign.further]
    return run.fault, " · ".join(further), axes.get(campaign.law, "")


def by(runs: Iterable[Judgement], key: Callable[[Judgement], KeyT]) -> dict[KeyT, list[Judgement]]:
    """The runs grouped, in their order."""
    groups: dict[KeyT, list[Judgement]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups


def requirement_failures(campaign: Campaign, runs: Sequence[Judgement]) -> dict[str, dict[str, Exceeding]]:
    """Number of runs with a fault that broke each requirement, by its name and the law."""
    faulty = [run for run in runs if run.fault != NONE and run.reached]
    needed = campaign.requirements
    names = [END_OF_RUN, *(limit.path for limit in needed.limits)]
    names += [DETECTION] if needed.detect is not None else []
    names += [RECOVERY] if needed.recover is not None else []
    of_laws = by(faulty, lambda run: place_of(campaign, run)[2])
    return {name: {law: _broken(name, group) for law, group in of_laws.items()} for name in names}


def _broken(name: str, runs: Sequence[Judgement]) -> Exceeding:
    return Exceeding(sum(any(breach.requirement == name for breach in run.breaches) for run in runs), len(runs))


def unaccepted(campaign: Campaign, cells: Sequence[Cell]) -> list[Cell]:
    """Cells of faults whose probability to fail may be larger than the campaign accepts."""
    accept = campaign.accept
    if accept is None:
        return []
    counted = [c for c in cells if c.place[0] != NONE and wants(accept, c.runs[0].outcome.case)]
    return [cell for cell in counted if cell.failing.interval()[1] > accept.probability]


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
        others, wanted = ([pair for pair in one.axes if pair[0] != FAULTS] for one in (case, search.template))
        if run.fault != search.entry.title or not same or others != wanted:
            continue
        value = _value(search, dict(case.axes)[FAULTS])
        if value is not None and search.case(value).axes == case.axes:
            yield value, run.failed


def _value(search: Search, text: str) -> float | None:
    """The searched number in the text of a fault; None: it has none of its own."""
    if "{" in text:
        return None
    (fault, *_) = fault_options(text)
    return (fault.amount[0] if fault.amount else None) if search.table.of == "amount" else fault.duration
