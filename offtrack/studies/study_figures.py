"""Figures of a study: numbers over draws; its runs together, and the pages that play them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from offtrack.reports.page import Explorer, ExplorerAxis, ExplorerRun, Figure
from offtrack.reports.player.playback import Playback
from offtrack.reports.plots import drawn
from offtrack.reports.run_files import MOST_RUNS, FinishedRun, overlaid, page_in_study, rebuilt
from offtrack.studies.case import RUN, Case, Outcome, Settings
from offtrack.studies.table import QUANTITIES, Quantity, Row, running_mean, spreads, text_of
from scenarios.results.log import read_log
from scenarios.results.run_directory import replaced

# apart for colour-blind readers, after Okabe and Ito
_COLOURS: Final = ("#e0761a", "#1f5fa8", "#12935f", "#c2459c", "#7a5195", "#b8860b", "#4fa3d1", "#a33b2b", "#5b6673")
MOST_LINES: Final = len(_COLOURS)


NAMED: Final = ("trailer_steering", "off_tracking", "slip_compensation", "slip_estimator", RUN)


_UNITS: Final = {"kmh": "km/h", "deg": "°"}  # by the end of a key


def plain(key: str) -> str:
    """The last part of a key in words, with its unit."""
    words, unit = _words(key)
    return f"{words} [{unit}]" if unit else words


def _words(key: str) -> tuple[str, str]:
    """The last part of a key in words, and its unit; empty if its name has none."""
    name = key.strip("{}").rpartition(".")[2]
    stem, _, end = name.rpartition("_")
    return (stem if end in _UNITS else name).replace("_", " "), _UNITS.get(end, "")


def condition(axes: Settings) -> str:
    """Values of keys in words: laws and estimators by themselves, others behind their keys."""
    texts = ((value, key, *_words(key)) for key, value in axes)
    return " · ".join(value if key in NAMED else f"{of} {value} {unit}".strip() for value, key, of, unit in texts)


def varied(rows: Sequence[Row] | Sequence[Case]) -> list[str]:
    """Keys with several values."""
    return [key for key, _ in rows[0].axes if len({dict(row.axes)[key] for row in rows}) > 1]


def alike(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """The first seed's and first draw's runs that have signals, at most six.

    Of more, those that differ in law or off-tracking source come first.
    """
    first = outcomes[0].case
    found = [
        one
        for one in outcomes
        if (one.case.seed, one.case.drawn) == (first.seed, first.drawn) and one.signals is not None
    ]
    others = [key for key, _ in first.axes if key not in NAMED]
    found.sort(key=lambda one: any(dict(one.case.axes)[key] != dict(first.axes)[key] for key in others))
    return found[:MOST_RUNS]


def convergence(outcomes: Sequence[Outcome], quantity: Quantity) -> Figure:
    """Mean of a quantity over the draws so far with its confidence interval, a line for each point of the grid."""
    points = [spread for spread in spreads(outcomes, quantity) if len(spread.known) > 1][:MOST_LINES]
    with drawn(f"study convergence {quantity.path}", 3.6) as (drawing, ax):
        for spread, colour in zip(points, _COLOURS, strict=False):
            mean, half = running_mean(spread.known)
            count = np.arange(1, len(mean) + 1)
            label = condition(spread.axes) or quantity.meaning
            ax.plot(count, mean, color=colour, label=label)
            ax.fill_between(count[2:], (mean - half)[2:], (mean + half)[2:], color=colour, alpha=0.15, linewidth=0.0)
        ax.set(xlabel="number of draws", ylabel=f"mean of {quantity.meaning} [{quantity.unit}]")
    return drawing.content


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
            page = page_in_study(_finished(outcomes[k], outcomes[k].case.title), _VALUES)
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
    result = rebuilt(scenario, read_log(outcome.signals), outcome.numbers, outcome.signals)
    directory = outcome.signals.parent
    return FinishedRun(name=name, directory=directory, summary=outcome.numbers, result=result)


def played_together(outcomes: Sequence[Outcome]) -> Playback | None:
    """The runs laid over each other; None unless there are two or more that can be played."""
    if len(outcomes) < 2:
        return None
    keys = varied([outcome.case for outcome in outcomes])
    names = [condition(tuple(pair for pair in outcome.case.axes if pair[0] in keys)) for outcome in outcomes]
    try:
        return overlaid([_finished(outcome, name) for outcome, name in zip(outcomes, names, strict=True)])
    except ValueError:
        return None


def explorer(outcomes: Sequence[Outcome], links: Sequence[str]) -> Explorer | None:
    """All runs over their varied values and numbers; None if there is nothing to compare."""
    shown = list(zip(outcomes, links, strict=True))[:_MOST_DRAWN]
    keys = [key for key, _ in (*outcomes[0].case.axes, *outcomes[0].case.drawn)]
    chosen = [key for key in keys if len({_values(outcome)[key] for outcome in outcomes}) > 1]
    seeds = len({outcome.case.seed for outcome in outcomes}) > 1
    quantities = [q for q in QUANTITIES if len({text_of(q, outcome.number(q.path)) for outcome in outcomes}) > 1]
    quantities = quantities[: max(0, _MOST_AXES - len(chosen) - seeds)]
    if len(outcomes) < 2 or not quantities:
        return None
    words = {key: not all(_is_finite(_values(outcome)[key]) for outcome in outcomes) for key in chosen}
    axes = [ExplorerAxis(plain(key), words=words[key], varied=True) for key in chosen]
    axes += [ExplorerAxis("seed", digits=0, varied=True)] if seeds else []
    axes += [ExplorerAxis(q.meaning, q.unit, q.digits) for q in quantities]
    runs = [
        ExplorerRun(
            outcome.case.title,
            str(outcome.numbers["outcome"]),
            outcome.completed,
            [*_run_values(outcome, words, quantities, seeds=seeds)],
            link,
        )
        for outcome, link in shown
    ]
    return Explorer(axes, runs)


def _values(outcome: Outcome) -> dict[str, str]:
    return dict((*outcome.case.axes, *outcome.case.drawn))


def _run_values(
    outcome: Outcome, words: Mapping[str, bool], quantities: Sequence[Quantity], *, seeds: bool
) -> Iterator[str | float | None]:
    """Varied values of a run, which are words or numbers, its seed, and its numbers."""
    values = _values(outcome)
    for key, is_word in words.items():
        yield values[key] if is_word else float(values[key])
    if seeds:
        yield float(outcome.case.seed)
    for quantity in quantities:
        number = outcome.number(quantity.path)
        yield number if number is not None and math.isfinite(number) else None


def _is_finite(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
