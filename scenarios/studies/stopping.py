"""End of a study with drawn values: enough draws once the intervals of its limits' probabilities are narrow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Final

from pydantic import Field

from scenarios.options.base import Options
from scenarios.studies.case import MOST_CASES, Case, Outcome, Settings

Intervals = Callable[[Sequence[Outcome], Settings], Iterable[tuple[float, float]]]

_NARROWEST: Final = 1e-4
_WIDEST: Final = 0.5


class Stop(Options):
    """When a point of a study has enough draws: the table ``stop`` of a study."""

    half_width: Annotated[float, Field(ge=_NARROWEST, lt=_WIDEST)]  # of each limit's interval (Clopper-Pearson)
    batch: Annotated[int, Field(ge=2, le=MOST_CASES, strict=True)] = 50  # draws between two looks


def made_in_batches(
    cases: Sequence[Case],
    intervals: Intervals,
    stop: Stop,
    make: Callable[[Sequence[int]], Sequence[Outcome]],
) -> list[Outcome]:
    """Make the draws of each point batch by batch until its intervals are narrow; return outcomes in the cases' order.

    The looks come after fixed numbers of draws in a fixed order, so the study ends after the same draws whoever makes
    them, and as often as it is repeated.

    Args:
        cases: all runs of the study.
        intervals: of the probabilities that are looked at, from the outcomes so far and the axes of a point.
        stop: the rule.
        make: makes the runs with these indices and returns their outcomes.
    """
    points = _points(cases)
    done: dict[int, Outcome] = {}
    for first in range(0, max(map(len, points.values())), stop.batch):
        batch = [k for drawn in points.values() for k in drawn[first : first + stop.batch]]
        done |= zip(batch, make(batch), strict=True)
        outcomes = [done[k] for k in sorted(done)]
        points = {axes: drawn for axes, drawn in points.items() if not _is_known(intervals(outcomes, axes), stop)}
        if not points:
            break
    return [done[k] for k in sorted(done)]


def spared(cases: Sequence[Case], intervals: Intervals, stop: Stop, done: Mapping[int, Outcome]) -> set[int]:
    """Indices of the runs that need not be made, as far as the runs that are ``done`` (by their indices) tell."""
    spare: set[int] = set()
    for axes, drawn in _points(cases).items():
        for last in range(stop.batch, len(drawn), stop.batch):
            if not all(k in done for k in drawn[:last]):
                break
            if _is_known(intervals([done[k] for k in drawn[:last]], axes), stop):
                spare |= set(drawn[last:])
                break
    return spare


def _points(cases: Sequence[Case]) -> dict[Settings, list[int]]:
    """Indices of the runs of every point."""
    points: dict[Settings, list[int]] = {}
    for k, case in enumerate(cases):
        points.setdefault(case.axes, []).append(k)
    return points


def _is_known(intervals: Iterable[tuple[float, float]], stop: Stop) -> bool:
    """True if every interval is narrow enough."""
    return all(high - low <= 2.0 * stop.half_width for low, high in intervals)
