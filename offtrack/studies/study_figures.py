"""Figures of a study: the paths driven, and numbers over a varied key; and pages that play its runs."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from offtrack.reports.page import Explorer, ExplorerAxis, ExplorerRun, Figure
from offtrack.reports.player.playback import Playback, PlayedRun
from offtrack.reports.plots import INK, drawn, plan_drawn, zero_line
from offtrack.reports.run_files import MOST_RUNS, FinishedRun, overlaid, rebuilt, run_page
from offtrack.studies.case import RUN, Outcome, Settings
from offtrack.studies.table import QUANTITIES, Quantity, Row, running_mean, spreads, text_of
from scenarios.results.log import read_log
from scenarios.results.run_directory import replaced
from vehicle.frames import arc_length

# apart for colour-blind readers, after Okabe and Ito
_COLOURS: Final = ("#e0761a", "#1f5fa8", "#12935f", "#c2459c", "#7a5195", "#b8860b", "#4fa3d1", "#a33b2b", "#5b6673")
MOST_LINES: Final = len(_COLOURS)
_LARGEST_RATIO: Final = 20.0  # of the values in one figure; beyond it the axis is logarithmic


_NAMED: Final = ("trailer_steering", "off_tracking", "slip_compensation", "slip_estimator", RUN)


def alike(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """The first seed's runs, one for each law, off-tracking source or run; other keys have their first value."""
    first = outcomes[0].case
    named = [key for key in _NAMED if key in dict(first.axes)]
    return [
        outcome
        for outcome in outcomes
        if (outcome.case.seed, outcome.case.drawn) == (first.seed, first.drawn)
        and [pair for pair in outcome.case.axes if pair[0] not in named]
        == [pair for pair in first.axes if pair[0] not in named]
        and outcome.signals
    ]


def drives_of(outcomes: Sequence[Outcome]) -> list[PlayedRun]:
    """The runs that are alike but for their laws, off-tracking sources or names."""
    drawn = alike(outcomes)
    keys = [key for key, _ in outcomes[0].case.axes if key in _NAMED]
    distinct = [key for key in keys if len({dict(outcome.case.axes)[key] for outcome in drawn}) > 1]
    titles = [" · ".join(value for key, value in one.case.axes if key in distinct) or one.case.title for one in drawn]
    return [overlaid([_finished(*one)]).runs[0] for one in zip(drawn, titles, strict=True)]


def plan(drives: Sequence[PlayedRun]) -> Figure:
    """Paths of the hitch, and of the follow point in each run."""
    hitch, followed = drives[0].trail_points(drives[0].trails[0]), [one.trail_points(one.trails[1]) for one in drives]
    with plan_drawn("study plan", [hitch, *followed]) as (drawing, ax):
        ax.plot(*hitch.T, color=INK, linewidth=2.4, label="hitch")
        for drive, path, colour in zip(drives, followed, _COLOURS, strict=False):
            ax.plot(*path.T, color=colour, label=f"follow point, {drive.name}")
    return drawing.content


def off_tracking(drives: Sequence[PlayedRun]) -> Figure:
    """True off-tracking over the distance driven by the hitch."""
    with drawn("study off-tracking", 3.4) as (drawing, ax):
        zero_line(ax)
        for drive, colour in zip(drives, _COLOURS, strict=False):
            distance = arc_length(drive.trail_points(drive.trails[0]))
            ax.plot(distance, drive.log["off_tracking_true"], color=colour, label=drive.name)
        ax.set(xlabel="distance driven by the hitch [m]", ylabel="off-tracking [m], + left")
    return drawing.content


def numeric_axis(rows: Sequence[Row]) -> str | None:
    """The first axis with several values that are all numbers; None if there is none."""
    for key, _ in rows[0].axes if rows else ():
        values = {dict(row.axes)[key] for row in rows}
        if len(values) > 1 and all(_is_finite(value) for value in values):
            return key
    return None


def trend(rows: Sequence[Row], axis: str, quantity: Quantity) -> Figure:
    """A quantity over a numeric axis, a line for every combination of the other axes."""
    lines: dict[Settings, list[tuple[float, float]]] = {}
    for row in rows:
        value = row.numbers[quantity.path]
        if value is not None:
            others = tuple(pair for pair in row.axes if pair[0] != axis)
            lines.setdefault(others, []).append((float(dict(row.axes)[axis]), value))
    varied = {key for key, _ in rows[0].axes if len({dict(row.axes)[key] for row in rows}) > 1}
    with drawn(f"study {axis} {quantity.path}", 3.6) as (drawing, ax):
        for k, (others, points) in enumerate(lines.items()):
            label = " · ".join(value for key, value in others if key in varied) or quantity.label
            style = ("-", "--", ":", "-.")[k // MOST_LINES % 4]
            ax.plot(*zip(*sorted(points), strict=True), style, marker="o", color=_COLOURS[k % MOST_LINES], label=label)
        ax.set(xlabel=axis, ylabel=f"{quantity.label} [{quantity.unit}]")
        values = [value for points in lines.values() for _, value in points]
        if min(values) > 0.0 and max(values) > _LARGEST_RATIO * min(values):
            ax.set_yscale("log")  # a linear axis would hide the differences of the small values
        else:
            ax.set_ylim(bottom=0.0, top=1.05 * max(values) or None)
    return drawing.content


def convergence(outcomes: Sequence[Outcome], quantity: Quantity) -> Figure:
    """Mean of a quantity over the draws so far with its confidence interval, a line for each point of the grid."""
    points = [spread for spread in spreads(outcomes, quantity) if len(spread.known) > 1][:MOST_LINES]
    with drawn(f"study convergence {quantity.path}", 3.6) as (drawing, ax):
        for spread, colour in zip(points, _COLOURS, strict=False):
            mean, half = running_mean(spread.known)
            count = np.arange(1, len(mean) + 1)
            label = " · ".join(value for _, value in spread.axes) or quantity.label
            ax.plot(count, mean, color=colour, label=label)
            ax.fill_between(count[2:], (mean - half)[2:], (mean + half)[2:], color=colour, alpha=0.15, linewidth=0.0)
        ax.set(xlabel="number of draws", ylabel=f"mean of {quantity.label} [{quantity.unit}]")
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
    result = rebuilt(scenario, read_log(outcome.signals), outcome.numbers, outcome.signals)
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
    words = {key: not all(_is_finite(_values(outcome)[key]) for outcome in outcomes) for key in varied}
    axes = [ExplorerAxis(key.strip("{}").rpartition(".")[2], words=words[key], varied=True) for key in varied]
    axes += [ExplorerAxis("seed", digits=0, varied=True)] if seeds else []
    axes += [ExplorerAxis(q.label, q.unit, q.digits) for q in quantities]
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
