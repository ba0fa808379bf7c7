"""Crossings and tangents of paths whose points repeat or turn back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.off_tracking.hitch_path import crossing, tangent
from vehicle.frames import FloatArray

RADIUS = 20.0  # [m]


def circle(spacing: float = 0.5, n: int = 60) -> FloatArray:
    """A path that comes from behind, newest first, on a left circle."""
    angle = spacing / RADIUS * np.arange(n)
    return np.column_stack([-RADIUS * np.sin(angle), RADIUS * (1.0 - np.cos(angle))])


def arc_length(path: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])


@pytest.mark.parametrize("jitter", [0.0, 1e-15, 1e-9])
@pytest.mark.parametrize("repeats", [2, 5])
def test_a_repeated_point_does_not_change_the_crossing(repeats: int, jitter: float) -> None:
    """A sensor that delivers the same fix again leaves points on one station, exactly or up to rounding."""
    once = circle()
    expected = crossing(once, arc_length(once), -10.0)
    again = np.repeat(once, repeats, axis=0) + jitter * np.arange(repeats * len(once))[:, None] % (7.0 * jitter or 1.0)
    found = crossing(again, arc_length(again), -10.0)
    assert expected is not None
    assert found is not None
    assert found.y == pytest.approx(expected.y, abs=1e-7)
    assert found.beyond == repeats * expected.beyond


def test_points_that_differ_by_rounding_alone_are_crossed_at_their_place() -> None:
    """Two of them on both sides of the line."""
    path = np.array([[0.0, 0.0], [-1.0, 0.1], [-2.0 + 1e-12, 0.3], [-2.0, 0.3], [-3.0, 0.6]])
    found = crossing(path, arc_length(path), -2.0)
    assert found is not None
    assert found.y == pytest.approx(0.3, abs=1e-9)


@given(st.lists(st.sampled_from([-0.5, -0.1, -1e-9, 0.0, 0.0, 0.1]), min_size=1, max_size=60))
def test_a_path_that_repeats_and_turns_back_is_crossed_where_its_points_say(steps: list[float]) -> None:
    """The most recent pair of points around the line holds the crossing, whatever the others do."""
    x = np.concatenate([[0.0], np.cumsum(steps)])
    path = np.column_stack([x, 0.1 * x**2])
    s = arc_length(path)
    found = crossing(path, s, -1.0)
    behind = np.flatnonzero(x <= -1.0)
    assert (found is None) == (not behind.size)
    if found is not None:
        assert found.beyond == behind[0]
        assert s[found.beyond - 1] <= found.s <= s[found.beyond]
        assert math.isfinite(found.y)


def test_where_a_path_turns_back_it_has_no_direction() -> None:
    """Out and back on the same line: the parabola does not advance, and a direction would be that of rounding."""
    x = np.concatenate([np.arange(0.0, 1.0, 0.1), np.arange(1.0, -0.05, -0.1)])
    path = np.column_stack([-x, np.zeros(len(x))])
    s = arc_length(path)
    assert tangent(path, s, 1.0, 0.45) == (0.0, 0.0)
    short = 0.01 * circle()[:6]  # 25 mm: the direction would be that of the noise
    assert tangent(short, arc_length(short), 0.0, 1.0) == (0.0, 0.0)
    assert tangent(path, s, 0.3, 0.2).direction == pytest.approx(0.0, abs=1e-9)
