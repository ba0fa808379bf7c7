"""Time in ticks: schedules divide, pipes deliver in order and on time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.clock import Pipe, Schedule, to_ticks


@pytest.mark.parametrize(("rate_hz", "period"), [(10.0, 100), (50.0, 20), (1000.0, 1), (0.5, 2000)])
def test_rates_become_whole_periods(rate_hz: float, period: int) -> None:
    """10 Hz is every 100th tick of 1 ms."""
    assert Schedule.at_rate(rate_hz).period == period


@pytest.mark.parametrize("rate_hz", [30.0, 3.0, 1500.0, 0.0, -10.0])
def test_rates_that_do_not_divide_are_refused(rate_hz: float) -> None:
    """30 Hz is no whole number of milliseconds; a rounded period would drift."""
    with pytest.raises(ValueError, match=r"camera|positive"):
        Schedule.at_rate(rate_hz, name="camera")


@pytest.mark.parametrize("seconds", [0.0005, -0.1, 0.10001])
def test_spans_that_are_no_whole_ticks_are_refused(seconds: float) -> None:
    """The message names the argument and its value."""
    with pytest.raises(ValueError, match=f"latency = {seconds} s"):
        to_ticks(seconds, "latency")


@pytest.mark.parametrize(("period", "offset", "latency"), [(0, 0, 0), (10, -1, 0), (10, 0, -1)])
def test_impossible_schedules_are_refused(period: int, offset: int, latency: int) -> None:
    """No sampling every 0 ticks, none before the start, no delivery before the capture."""
    with pytest.raises(ValueError, match="period, offset, latency"):
        Schedule(period=period, offset=offset, latency=latency)


@given(st.integers(1, 500), st.integers(0, 500))
def test_samples_are_one_period_apart_from_the_offset_on(period: int, offset: int) -> None:
    """Sample k is due at offset + k * period and at no other tick."""
    schedule = Schedule(period=period, offset=offset)
    due = [tick for tick in range(offset + 5 * period) if schedule.due(tick)]
    assert due == [offset + k * period for k in range(5)]


@given(st.lists(st.integers(0, 100), max_size=20), st.integers(0, 100))
def test_a_pipe_delivers_what_is_due_in_order_and_once(delivery_ticks: list[int], now: int) -> None:
    """Messages leave in the order they were put in, not before their tick, and do not come back."""
    pipe: Pipe[int] = Pipe()
    for k, tick in enumerate(delivery_ticks):
        pipe = pipe.put(tick, k)
    rest, delivered = pipe.deliver(now)
    assert delivered == tuple(k for k, tick in enumerate(delivery_ticks) if tick <= now)
    assert rest.deliver(now)[1] == ()
    assert set(rest.deliver(100)[1]) | set(delivered) == set(range(len(delivery_ticks)))
