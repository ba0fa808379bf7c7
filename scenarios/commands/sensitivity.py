"""Sensitivity of a study's numbers, for the terminal and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.table import Table

from scenarios.commands.console import PlainConsole

if TYPE_CHECKING:
    from scenarios.studies.case import Outcome, Settings
    from scenarios.studies.sensitivity import Sensitivity


def sensitivity_of(design: Sensitivity, outcomes: Sequence[Outcome]) -> dict[Settings, dict[str, Any]]:
    """The entry ``sensitivity`` of each point's row in JSON."""
    from scenarios.studies.sensitivity import analysed, plain

    points: dict[Settings, dict[str, Any]] = {}
    for analysis in analysed(design, outcomes):
        points.setdefault(analysis.axes, {"sensitivity": []})["sensitivity"].append(plain(analysis, design.method))
    return points


def print_sensitivity(design: Sensitivity, outcomes: Sequence[Outcome]) -> None:
    """Print a table for each point: a row for each quantity and key."""
    from scenarios.studies.sensitivity import analysed
    from scenarios.studies.sensitivity_page import HEADINGS, remarks

    first, second = HEADINGS[design.method]
    console, analyses = PlainConsole(), analysed(design, outcomes)
    for axes in dict.fromkeys(analysis.axes for analysis in analyses):
        point = " ".join(f"{key}={value}" for key, value in axes)
        table = Table(title=f"Sensitivity{f', {point}' if point else ''}", title_justify="left", padding=(0, 0))
        for heading in ("", "key", first, "±", second, "±", ""):
            table.add_column(heading, justify="left" if heading in ("", "key") else "right")
        for analysis in (one for one in analyses if one.axes == axes):
            head = f"{analysis.quantity.label} [{analysis.quantity.unit}]"
            for index in analysis.indices:
                numbers = ("" if value is None else f"{value:.3g}" for value in index[1:])
                table.add_row(head, index.key, *numbers, remarks(design, analysis))
                head = ""
            if not analysis.indices:
                table.add_row(head, "", "", "", "", "", remarks(design, analysis))
        console.print(table)
    left_out = dict.fromkeys(title for analysis in analyses for title in analysis.left_out)
    for title in list(left_out)[:10]:
        console.print(f"left out: {title}", soft_wrap=True)
    if len(left_out) > 10:
        console.print(f"left out: {len(left_out) - 10} more, see the report", soft_wrap=True)
