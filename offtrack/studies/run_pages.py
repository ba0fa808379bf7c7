"""Pages of a study's runs, which play them; and all runs over their values, with links to these pages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from offtrack.reports.kinds import KINDS
from offtrack.reports.page import Explorer, ExplorerAxis, ExplorerRun
from offtrack.reports.player.playback import Playback
from offtrack.reports.viewing import MOST_RUNS, FinishedRun, overlaid, run_page
from offtrack.studies.case import Outcome
from offtrack.studies.table import QUANTITIES, Quantity, text_of
from scenarios.results.atomic_files import replaced
from scenarios.results.log import read_log

PAGES: Final = "pages"  # folder of the runs' pages
_MOST: Final = 60  # pages; further runs have none
_VALUES: Final = 200_000  # of the signals of a page
_MOST_AXES: Final = 10  # of the drawing
_MOST_DRAWN: Final = 3000  # runs in the drawing


def write_run_pages(outcomes: Sequence[Outcome], directory: Path, first: Sequence[int] = ()) -> list[str]:
    """Write a page for each run that can be played, and return their addresses, empty where there is none.

    Of more than 60 runs those have pages that are named ``first`` by their indices, those that ended otherwise than by
    completing the course, and those with the largest first number of the table.
    """
    links = [""] * len(outcomes)
    others = sorted(range(len(outcomes)), key=lambda k: _interest(outcomes[k]), reverse=True)
    chosen = list(dict.fromkeys([*first, *others]))[:_MOST]
    for k in sorted(chosen):
        try:
            page = run_page(_finished(outcomes[k], outcomes[k].case.title), _VALUES)
        except ValueError:  # its signals are gone, or it ended before it had moved
            continue
        (directory / PAGES).mkdir(exist_ok=True)
        replaced(directory / PAGES / f"{k + 1}.html", page)
        links[k] = f"{PAGES}/{k + 1}.html"
    return links


def _interest(outcome: Outcome) -> tuple[bool, float]:
    numbers = (outcome.number(quantity.path) for quantity in QUANTITIES)
    return not outcome.completed, next((abs(value) for value in numbers if value is not None), 0.0)


def _finished(outcome: Outcome, name: str) -> FinishedRun:
    if outcome.signals is None or not outcome.signals.is_file():
        raise ValueError(f"{outcome.case.title}: has no signals")
    scenario = outcome.case.resolved()
    result = KINDS[scenario.vehicle_kind].rebuilt(scenario, read_log(outcome.signals), outcome.numbers)
    directory = outcome.signals.parent
    return FinishedRun(name=name, directory=directory, summary=outcome.numbers, result=result)


def played_together(outcomes: Sequence[Outcome]) -> Playback | None:
    """The runs laid over each other; None unless there are two to six that can be played."""
    if not 2 <= len(outcomes) <= MOST_RUNS:
        return None
    try:
        return overlaid(
            [_finished(outcome, name) for outcome, name in zip(outcomes, _short_names(outcomes), strict=True)]
        )
    except ValueError:
        return None


def _short_names(outcomes: Sequence[Outcome]) -> list[str]:
    """What distinguishes the runs from each other."""
    axes = [dict(outcome.case.axes) for outcome in outcomes]
    distinct = [key for key in axes[0] if len({values[key] for values in axes}) > 1]
    return [" · ".join(values[key] for key in distinct) for values in axes]


def explorer(outcomes: Sequence[Outcome], links: Sequence[str]) -> Explorer | None:
    """All runs over their varied values and numbers; None if there is nothing to compare."""
    shown = list(zip(outcomes, links, strict=True))[:_MOST_DRAWN]
    keys = [key for key, _ in (*outcomes[0].case.axes, *outcomes[0].case.drawn)]
    varied = [key for key in keys if len({_values(outcome)[key] for outcome in outcomes}) > 1]
    seeds = len({outcome.case.seed for outcome in outcomes}) > 1
    quantities = [q for q in QUANTITIES if len({text_of(q, outcome.number(q.path)) for outcome in outcomes}) > 1]
    quantities = quantities[: max(0, _MOST_AXES - len(varied) - seeds)]
    if len(outcomes) < 2 or not quantities:
        return None
    words = {key: not all(_is_number(_values(outcome)[key]) for outcome in outcomes) for key in varied}
    axes = [ExplorerAxis(key.strip("{}").rpartition(".")[2], words=words[key], varied=True) for key in varied]
    axes += [ExplorerAxis("seed", digits=0, varied=True)] if seeds else []
    axes += [ExplorerAxis(q.label, q.unit, q.digits) for q in quantities]
    runs = [
        ExplorerRun(
            outcome.case.title,
            str(outcome.numbers["outcome"]),
            outcome.completed,
            [*_run_values(outcome, varied, words, seeds=seeds), *_run_numbers(outcome, quantities)],
            link,
        )
        for outcome, link in shown
    ]
    return Explorer(axes, runs)


def _values(outcome: Outcome) -> dict[str, str]:
    return dict((*outcome.case.axes, *outcome.case.drawn))


def _run_values(
    outcome: Outcome, varied: Sequence[str], words: dict[str, bool], *, seeds: bool
) -> Iterator[str | float]:
    values = _values(outcome)
    for key in varied:
        yield values[key] if words[key] else float(values[key])
    if seeds:
        yield float(outcome.case.seed)


def _run_numbers(outcome: Outcome, quantities: Sequence[Quantity]) -> Iterator[float | None]:
    for quantity in quantities:
        number = outcome.number(quantity.path)
        yield number if number is not None and math.isfinite(number) else None


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
