"""The log of a long run is made of few rows at a time, and is the log of all of them."""

from __future__ import annotations

import dataclasses
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar, overload

import numpy as np
import pytest

from scenarios.assembly.rover_run import assemble_rover
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.rover_session import RoverSession
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import RoverScenario, load_any_scenario, load_scenario
from scenarios.results import log as parts
from scenarios.results.log import Log, Signal, columns_by_parts
from scenarios.results.rover_result import RoverRow, rover_log
from scenarios.results.run_inputs import RunInputs
from scenarios.results.trailer_signals import TrailerRow, run_log

RowT = TypeVar("RowT", TrailerRow, RoverRow)
MadeT = TypeVar("MadeT")
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


def test_no_rows_have_columns_too() -> None:
    """A run may be interrupted before its first row."""
    ((column,),) = columns_by_parts([], lambda rows: [(TICK, rows)])
    assert column[0] == TICK
    assert column[1].shape == (0,)


def test_a_column_of_another_length_is_refused() -> None:
    """One number would fill a column without a word."""
    with pytest.raises(ValueError, match=r"shape \(1,\) does not fit 3 rows"):
        Log.of([(TICK, [0.0, 1.0, 2.0]), (SQUARE, [0.0])])


def test_a_table_that_nobody_can_change_is_not_copied() -> None:
    log = Log.of([(TICK, [0.0, 1.0]), (SQUARE, [0.0, np.nan])])
    assert Log((SQUARE, TICK), log.rows).rows is log.rows
    assert not np.shares_memory(Log((TICK,), log.rows[:, :1]).rows, log.rows)


class Repeated(Sequence[RowT]):
    """Rows of a run again and again, each made when it is asked for."""

    def __init__(self, rows: Sequence[RowT], count: int, period: int) -> None:
        self._rows: list[RowT] = list(rows)
        self._count, self._period = count, period

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> RowT: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[RowT]: ...
    def __getitem__(self, index: int | slice) -> RowT | Sequence[RowT]:
        raise AssertionError("rows are read in order")

    def __iter__(self) -> Iterator[RowT]:
        for k in range(self._count):
            row = self._rows[k % len(self._rows)]
            truth = row.truth
            fresh = {
                field.name: value.copy()
                for field in dataclasses.fields(truth)
                if isinstance(value := getattr(truth, field.name), np.ndarray)
            }
            yield dataclasses.replace(row, truth=dataclasses.replace(truth, tick=k * self._period, **fresh))


COUNT = 1000  # rows, in parts of 50


def test_the_log_of_a_trailer_takes_little_more_memory_than_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1000 rows, which would take over 4 times as much as their log."""
    monkeypatch.setattr(parts, "_PART", 50)
    scenario = load_scenario("roundabout", ["off_tracking=truth", "course.turn_deg=30"])
    with TrailerSession(assemble(scenario, 1)) as session:
        for _ in range(20):
            session.advance()
        whole = session.result(RunInputs(), complete=False).log
        rows = Repeated(session.rows, COUNT, 10)
        rows_in_memory, _ = traced(lambda: list(rows))
        peak, log = traced(lambda: run_log(rows, [], session.parts.vehicle))
        session.parts.close()
    assert [log[name][:20].tobytes() for name in ("x_tractor", "wheel_load_min")] == [
        whole[name].tobytes() for name in ("x_tractor", "wheel_load_min")
    ]
    assert rows_in_memory > 4.0 * log.rows.nbytes
    assert peak < 2.6 * log.rows.nbytes  # twice the log: its columns and, empty, its table; and one part of rows


def test_the_log_of_a_rover_takes_little_more_memory_than_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1000 rows, which would take over 4 times as much as their log."""
    monkeypatch.setattr(parts, "_PART", 50)
    scenario = load_any_scenario("rover-slope", ["slip_estimator=truth"])
    assert isinstance(scenario, RoverScenario)
    with RoverSession(assemble_rover(scenario, 1)) as session:
        for _ in range(20):
            session.advance()
        rows, rig, path = Repeated(session.rows, COUNT, 50), session.parts.rig, session.parts.path
    rows_in_memory, _ = traced(lambda: list(rows))
    peak, log = traced(lambda: rover_log(rig, rows, [], path))
    assert rows_in_memory > 4.0 * log.rows.nbytes
    assert peak < 2.6 * log.rows.nbytes  # twice the log: its columns and, empty, its table; and one part of rows


def traced(make: Callable[[], MadeT]) -> tuple[int, MadeT]:
    """Largest memory in use while something is made [bytes], and the thing."""
    tracemalloc.start()
    made = make()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak, made
