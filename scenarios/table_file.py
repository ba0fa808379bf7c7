"""Tables of numbers as text: columns by the names in the first line, with limits for their numbers."""

import csv
import io
import math
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vehicle.foundation.data_file import table_text
from vehicle.foundation.user_file import MAX_FIELD, shown
from vehicle.frames import FloatArray


class Column(NamedTuple):
    """A column and the largest plausible size of its numbers."""

    name: str
    limit: float
    unit: str

    def number(self, text: str, place: str) -> float:
        """Number of a text at a place in a file.

        Raises:
            ValueError: if it is not a number within the limits.
        """
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{place}: {self.name} = '{shown(text.strip(), 40)}' is not a finite number")
        if abs(value) > self.limit:
            raise ValueError(
                f"{place}: {self.name} = {value:g} must be within -{self.limit:g} to {self.limit:g} {self.unit}"
            )
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class NumberTable:
    """A table of which only the first line is interpreted yet."""

    path: Path
    names: list[str]  # of the columns
    lines: Iterator[list[str]]  # the others; empty ones are skipped

    def numbers(self, columns: Sequence[Column]) -> FloatArray:
        """Numbers (n, columns) of these columns; others are not interpreted.

        Raises:
            ValueError: one line naming file, line, column and limit, if a column is missing or a value is not a number
                within its limits.
        """
        wanted = [column.name for column in columns]
        for name in wanted:
            if name not in self.names:
                raise ValueError(f"{self.path}: column '{name}' is missing; expected {', '.join(wanted)}")
        places, values = [self.names.index(name) for name in wanted], array("d")
        for number, line in enumerate(self.lines, start=2):
            if len(line) != len(self.names):
                raise ValueError(f"{self.path}: line {number} has {len(line)} values for {len(self.names)} columns")
            for column, k in zip(columns, places, strict=True):
                values.append(column.number(line[k], f"{self.path}: line {number}"))
        return np.array(values, dtype=np.float64).reshape(-1, len(columns))


def open_table(path: Path) -> NumberTable:
    """Open a table of numbers.

    Raises:
        ValueError: one line, if the file cannot be read, has too many numbers, or names a column twice.
    """
    lines = _lines(path, table_text(path))
    names = [shown(name.strip()) for name in next(lines, [])]
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: two columns have the same name")
    return NumberTable(path=path, names=names, lines=lines)


def _lines(path: Path, text: str) -> Iterator[list[str]]:
    try:
        yield from (line for line in csv.reader(io.StringIO(text, newline="")) if line)
    except csv.Error:
        raise ValueError(f"{path}: a value has more than {MAX_FIELD} characters; is a quotation mark open?") from None
