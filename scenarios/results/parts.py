"""Columns of rows that are read once, some hundred at a time: rows take ten times the memory of their columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import Final, TypeVar

import numpy as np

from scenarios.results.log import Column, Signal
from vehicle.frames import FloatArray

RowT = TypeVar("RowT")
ColumnsOf = Callable[[Sequence[RowT]], Iterable[Column]]  # columns of a part of the rows

_PART: Final = 500  # rows at a time


def columns_by_parts(rows: Sequence[RowT], *columns_of: ColumnsOf[RowT]) -> list[list[tuple[Signal, FloatArray]]]:
    """Columns over all rows, a list for each function.

    The functions get the rows in order, part by part, and first no rows at all, for the names of their columns.
    """
    tables = [[(signal, np.empty(len(rows))) for signal, _ in columns([])] for columns in columns_of]
    for begin, part in _parts(rows):
        for table, columns in zip(tables, columns_of, strict=True):
            for (_, whole), (_, values) in zip(table, columns(part), strict=True):
                whole[begin : begin + len(part)] = values
    return tables


def _parts(rows: Sequence[RowT]) -> Iterator[tuple[int, list[RowT]]]:
    """Parts of the rows, each with the place of its first one."""
    begin, left = 0, iter(rows)
    while part := list(islice(left, _PART)):
        yield begin, part
        begin += len(part)
