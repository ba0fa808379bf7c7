"""Rows of a study on the terminal, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from scenarios.commands.console import PlainConsole

if TYPE_CHECKING:
    from scenarios.studies.table import Row

TextColumn = tuple[str, list[str]]  # heading and cells


def plain(row: Row) -> dict[str, object]:
    """A row as JSON has it."""
    return {
        "axes": dict(row.axes),
        "runs": row.runs,
        "completed": row.completed,
        "endings": list(row.endings),
        **row.numbers,
    }


def print_rows(rows: Sequence[Row], directory: Path) -> None:
    """Print a table of a study's points with their numbers, as many as the terminal is wide."""
    from scenarios.studies.table import shown_quantities, text_of

    quantities = shown_quantities(rows)
    varied = [key for key, _ in rows[0].axes if len({dict(row.axes)[key] for row in rows}) > 1]
    columns = [(key.rpartition(".")[2], [dict(row.axes)[key] for row in rows]) for key in varied]
    columns.append(("done", [f"{row.completed}/{row.runs}" for row in rows]))
    numbers = [(f"{q.label} [{q.unit}]", [text_of(q, row.numbers[q.path]) for row in rows]) for q in quantities]
    console = PlainConsole()
    shown = fitting(columns, numbers, console.width)
    table = Table(padding=(0, 0))
    for k, (heading, cells) in enumerate([*columns, *shown]):
        table.add_column(heading, justify="left" if k < len(varied) else "right", width=least_width(heading, cells))
    for row in zip(*(cells for _, cells in (*columns, *shown)), strict=True):
        table.add_row(*row)
    console.print(table)
    if left_out := [heading for heading, _ in numbers[len(shown) :]]:
        console.print(f"Left out, as the terminal is narrow: {', '.join(left_out)}", soft_wrap=True)
    for ending in dict.fromkeys(ending for row in rows for ending in row.endings):
        count = sum(row.runs - row.completed for row in rows if ending in row.endings)
        console.print(f"{ending}: {count} runs", soft_wrap=True)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)


def fitting(columns: Sequence[TextColumn], numbers: Sequence[TextColumn], width: int) -> Sequence[TextColumn]:
    """As many of the numbers, from the first on, as fit beside the other columns on a terminal; at least one."""
    for count in range(len(numbers), 1, -1):
        shown = [*columns, *numbers[:count]]
        if sum(least_width(heading, cells) + 1 for heading, cells in shown) + 1 <= width:
            return numbers[:count]
    return numbers[:1]


def least_width(heading: str, cells: Sequence[str]) -> int:
    """Least width of a column that cuts neither a number nor a word of its heading."""
    return max(map(len, (*heading.split(), *cells)))
