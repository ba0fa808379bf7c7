"""Figures of a campaign: smallest faults that fail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from scenarios.campaigns.bisection import Finding, Search
from scenarios.report.page import Figure
from scenarios.report.plots import ESTIMATED, GREY, TRUE, drawn

_MARKS: Final[dict[Finding, tuple[str, str, str]]] = {
    "found": ("o", ESTIMATED, "smallest value that fails"),
    "never fails": (">", TRUE, "does not fail up to here"),
    "always fails": ("<", GREY, "fails already here"),
}


def thresholds(searches: Sequence[Search]) -> Figure:
    """Smallest value that fails in each search of one table, a line for each law and further axes, a dot a seed."""
    table = searches[0].table
    lines = list(dict.fromkeys(_line(search) for search in searches))
    name = f"{searches[0].entry.title}: {table.of}"
    with drawn(f"campaign {name}", 1.3 + 0.3 * len(lines), title=name) as (drawing, ax):
        for finding, (mark, colour, label) in _MARKS.items():
            chosen = [search for search in searches if search.finding == finding]
            if chosen:
                places = [lines.index(_line(search)) for search in chosen]
                ax.plot([_value(s) for s in chosen], places, mark, color=colour, alpha=0.75, markersize=8, label=label)
        ax.set_yticks(range(len(lines)), lines)
        margin = 0.04 * (table.high - table.low)
        ax.set(xlim=(table.low - margin, table.high + margin), ylim=(len(lines) - 0.5, -0.5), xlabel=_axis(searches[0]))
    return drawing.content


def _line(search: Search) -> str:
    return " · ".join(filter(None, (search.law, search.further))) or "all runs"


def _value(search: Search) -> float:
    if search.finding == "found":
        return search.bracket[1]
    return search.table.high if search.finding == "never fails" else search.table.low


def _axis(search: Search) -> str:
    """The searched number with its unit."""
    if search.table.of == "duration":
        return "duration [s]"
    option = search.entry.options()[0]
    return f"{option.name} [{option.unit}]"
