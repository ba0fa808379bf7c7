"""The log of a long run is made of few rows at a time, and is the log of all of them."""

import dataclasses
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from scenarios.assembly.trailer_run import assemble
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.results import log as parts
from scenarios.results.log import Log, Signal, columns_by_parts
from scenarios.results.trailer_signals import run_log

TICK, SQUARE = Signal("tick", "ms", "time"), Signal("square", "-", "its square")


def test_columns_of_parts_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """23 rows in parts of 5: in order, each once, also where a function remembers the part before."""
    monkeypatch.setattr(parts, "_PART", 5)
    seen = list[int]()

    def remembering(rows: Sequence[int]) -> Iterator[tuple[Signal, list[float]]]:
        seen.extend(rows)
        yield TICK, [float(len(seen))] * len(rows)

    def squares(rows: Sequence[int]) -> Iterator[tuple[Signal, list[float]]]:
        yield TICK, [float(k) for k in rows]
        yield SQUARE, [float(k * k) for k in rows]

    (counted,), (ticks, squared) = columns_by_parts(range(23), remembering, squares)
    assert seen == list(range(23))
    assert counted[1].tolist() == [5.0] * 5 + [10.0] * 5 + [15.0] * 5 + [20.0] * 5 + [23.0] * 3
    assert (ticks[0], squared[0]) == (TICK, SQUARE)
    assert squared[1].tolist() == [float(k * k) for k in range(23)]
    ((column,),) = columns_by_parts([], lambda rows: [(TICK, rows)])  # interrupted before the first row
    assert (column[0], column[1].shape) == (TICK, (0,))
    with pytest.raises(ValueError, match=r"shape \(1,\) does not fit 3 rows"):  # it would fill a column
        Log.of([(TICK, [0.0, 1.0, 2.0]), (SQUARE, [0.0])])


class Repeated(Sequence[Any]):
    """Rows of a run again and again, each made when it is asked for, in their order."""

    def __init__(self, rows: Sequence[Any], count: int, period: int) -> None:
        self._rows, self._count, self._period = list(rows), count, period

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        raise AssertionError("rows are read in order")

    def __iter__(self) -> Iterator[Any]:
        for k in range(self._count):
            row = self._rows[k % len(self._rows)]
            values = {field.name: getattr(row.truth, field.name) for field in dataclasses.fields(row.truth)}
            fresh = {name: value.copy() for name, value in values.items() if isinstance(value, np.ndarray)}
            yield dataclasses.replace(row, truth=dataclasses.replace(row.truth, tick=k * self._period, **fresh))


def traced(make: Callable[[], Any]) -> tuple[int, Any]:
    """Largest memory in use while something is made [bytes], and the thing."""
    tracemalloc.start()
    made = make()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak, made


def test_the_log_takes_little_more_memory_than_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1000 rows in parts of 50, which would take over 4 times as much as their log."""
    monkeypatch.setattr(parts, "_PART", 50)
    with TrailerSession(assemble(load_scenario("roundabout", ["off_tracking=truth"]), 1)) as session:
        for _ in range(20):
            session.advance()
        rows = Repeated(session.rows, 1000, 10)
        whole = run_log(session.rows, [], session.parts.vehicle)
        rows_in_memory, _ = traced(lambda: list(rows))
        peak, log = traced(lambda: run_log(rows, [], session.parts.vehicle))
    for name in ("x_tractor", "wheel_load_min"):
        assert log[name][: len(whole)].tobytes() == whole[name].tobytes()
    assert rows_in_memory > 4.0 * log.rows.nbytes
    assert peak < 2.6 * log.rows.nbytes  # twice the log: its columns and, empty, its table; and one part of rows
