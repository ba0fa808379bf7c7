"""The controllers' own model of a steering actuator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.equations import settle

angles = st.floats(-0.6, 0.6)
times = st.floats(0.0, 2.0)


@given(angles, angles, times)
def test_it_solves_the_lag_under_the_rate_limit(angle: float, demand: float, duration: float) -> None:
    """Against Euler steps of d(angle)/dt = clip((demand - angle)/lag); they err by max_rate dt / 2 = 0.4 mrad."""
    lag, max_rate, steps = 0.15, 0.35, 1000
    stepped = angle
    for _ in range(steps):
        stepped += duration / steps * np.clip((demand - stepped) / lag, -max_rate, max_rate)
    assert settle(angle, demand, duration, lag=lag, max_rate=max_rate) == pytest.approx(stepped, abs=1e-3)


@given(angles, angles, times, times)
def test_two_waits_are_one_long_wait(angle: float, demand: float, first: float, second: float) -> None:
    """A held demand has no memory but the angle."""
    kind = {"lag": 0.15, "max_rate": 0.35}
    halfway = settle(angle, demand, first, **kind)
    assert settle(halfway, demand, second, **kind) == pytest.approx(
        settle(angle, demand, first + second, **kind), abs=1e-12
    )


def test_without_lag_the_rate_alone_limits() -> None:
    """One second at 0.2 rad/s, per axle; the second axle arrives and stops."""
    reached = settle([0.0, 0.4], [0.5, 0.3], 1.0, lag=0.0, max_rate=0.2)
    assert reached == pytest.approx([0.2, 0.3], abs=1e-15)
