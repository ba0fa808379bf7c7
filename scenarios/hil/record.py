"""Record of the demands that came in: with it a run is repeated, bitwise, without the bench."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from scenarios.hil.demands import TICK_NAME, Demands
from vehicle.table_file import Column, open_table

RECORD_NAME: Final = "demands.csv"
_CAME: Final = "came_"  # begins the name of the column that says whether a part's demands came at that tick: 1 or 0

Values = Mapping[str, tuple[float, ...]]  # by part


def record_text(parts: Sequence[Demands], rows: Sequence[tuple[int, Values]]) -> str:
    """The record as CSV: a line for every step in which demands came; numbers are exact."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for part in parts for name in (f"{_CAME}{part.part}", *(one.name for one in part.numbers))]
    writer.writerow([TICK_NAME, *names])
    for tick, values in rows:
        cells: list[float] = []
        for part in parts:
            came = part.part in values
            cells += [int(came), *(values[part.part] if came else (0.0,) * len(part.numbers))]
        writer.writerow([tick, *cells])
    return text.getvalue()


class RecordedDemands:
    """The demands of a record, by the tick of the step that took them."""

    def __init__(self, path: Path, parts: Sequence[Demands]) -> None:
        """Read a record.

        Raises:
            ValueError: one line, if it is no record of such demands.
        """
        columns = [Column(TICK_NAME, 1e9, "ms")]
        for part in parts:
            columns.append(Column(f"{_CAME}{part.part}", 1.0, "-"))
            columns += [Column(one.name, one.limit, one.unit) for one in part.numbers]
        self._steps: dict[int, dict[str, tuple[float, ...]]] = {}
        for tick, *cells in open_table(path).numbers(columns).tolist():
            at = 0
            values: dict[str, tuple[float, ...]] = {}
            for part in parts:
                came, end = cells[at], at + 1 + len(part.numbers)
                if came:
                    values[part.part] = tuple(cells[at + 1 : end])
                at = end
            self._steps[int(tick)] = values

    def at(self, tick: int) -> Values:
        """Demands that came at this tick."""
        return self._steps.get(tick, {})
