"""Distances along polylines against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vehicle.foundation.polyline import arc_length, dense, resampled, rows_every

CORNER = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]])  # 5 m and 6 m


def test_arc_length_adds_up_the_chords() -> None:
    """3-4-5 and a straight; a single point lies at zero; a repeated one adds nothing."""
    assert arc_length(CORNER).tolist() == [0.0, 5.0, 11.0]
    assert arc_length(CORNER[:1]).tolist() == [0.0]
    assert arc_length(CORNER[[0, 1, 1, 2]]).tolist() == [0.0, 5.0, 5.0, 11.0]


def test_arc_length_of_a_polygon_approaches_the_circle() -> None:
    """Chords of 0.01 rad are short by a share of 0.01^2 / 24."""
    angle = np.arange(0.0, 1.0001, 0.01)
    assert arc_length(10.0 * np.column_stack([np.cos(angle), np.sin(angle)]))[-1] == pytest.approx(10.0, rel=5e-6)


def test_resampled_points_lie_at_their_distance() -> None:
    """Half way along each leg."""
    np.testing.assert_allclose(resampled(CORNER, np.array([2.5, 8.0])), [[1.5, 2.0], [3.0, 7.0]], atol=1e-12)


def test_dense_points_reach_from_end_to_end() -> None:
    """About as far apart as asked for, all alike, and both ends are there."""
    points, spacing = dense(np.array([[0.0, 0.0], [0.0, 10.5]]), 2.0)
    assert spacing == pytest.approx(2.1)
    np.testing.assert_allclose(arc_length(points), spacing * np.arange(6), atol=1e-12)
    assert math.isclose(points[-1, 1], 10.5)


def test_rows_are_a_spacing_apart() -> None:
    """On a line with a point every metre, every third."""
    line = np.column_stack([np.arange(10.0), np.zeros(10)])
    assert rows_every(line, 3.0).tolist() == [0, 3, 6]
