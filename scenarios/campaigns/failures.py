"""Failures of a campaign's runs: by fault, law and further axes, by requirement, and the worst of them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple, TypeVar

import numpy as np

from scenarios.campaigns.campaign import Campaign, wants
from scenarios.campaigns.fault_entry import NONE
from scenarios.campaigns.verdict import DETECTION, END_OF_RUN, RECOVERY, Judgement
from scenarios.studies.spread import Exceeding

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
    def of(cls, values: Iterable[float]) -> Times:
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
