"""Actuators: lag, rate and limit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.combination.actuators import demand_rate, steer_rate

angles = st.floats(-3.0, 3.0)
LIMITS = {"lag": 0.15, "limit": 0.5, "rate_limit": 0.35}


@given(angles, angles)
def test_steering_is_never_faster_than_its_rate_limit(angle: float, demand: float) -> None:
    """The valve is open and no further."""
    assert abs(float(steer_rate(angle, demand, **LIMITS))) <= LIMITS["rate_limit"]


@given(st.floats(-0.5, 0.5), angles)
def test_steering_does_not_leave_its_limit(angle: float, demand: float) -> None:
    """At the stop the rate points inwards or is zero, whatever is demanded."""
    assert steer_rate(0.5, demand, **LIMITS) <= 0.0 <= steer_rate(-0.5, demand, **LIMITS)


def test_small_errors_decay_with_the_lag() -> None:
    """First order below the rate limit: 0.015 rad off, 0.15 s lag."""
    assert steer_rate(0.1, 0.115, **LIMITS) == pytest.approx(0.1)


@given(st.floats(-20.0, 20.0))
def test_demands_beyond_drive_and_brakes_are_cut(demand: float) -> None:
    """No engine pulls 40 t at 5 m/s2."""
    rate = demand_rate(0.0, demand, lag=0.25, braking=6.0, driving=1.5)
    assert rate * 0.25 == pytest.approx(min(max(demand, -6.0), 1.5))
