"""Clearance of the wheels to the edges of the road."""

from __future__ import annotations

import math

import numpy as np
import pytest

from scenarios.results.swept_path import RoadEdges, UnitOutline, wheel_clearance

TRUCK = UnitOutline("truck", 5.0, -1.0, 2.5, (4.0, 0.0), (2.0, 1.8))


def test_clearance_on_a_circle_is_that_of_the_outer_front_and_the_inner_rear_wheel() -> None:
    """Rear axle on a circle of 20 m, left turn; the road's middle is on 21 m, its edges 3 and 4 m beside it."""
    angle = np.linspace(0.0, math.pi, 2000)
    road = 21.0 * np.column_stack([np.sin(angle), -np.cos(angle)])
    edges = RoadEdges(road, np.tile([3.0, 4.0], (len(road), 1)))
    inner = angle[200:-400]
    poses = np.column_stack([20.0 * np.sin(inner), -20.0 * np.cos(inner), inner])
    clearance = wheel_clearance(edges, (TRUCK,), (poses,))
    assert clearance.left == pytest.approx(20.0 - 0.9 - 18.0, abs=1e-4)
    assert clearance.right == pytest.approx(25.0 - math.hypot(21.0, 4.0), abs=1e-4)


def test_a_wheel_beyond_the_edge_counts_negative_and_rows_that_are_no_numbers_not_at_all() -> None:
    road = np.column_stack([np.arange(0.0, 100.0), np.zeros(100)])
    poses = np.column_stack([np.arange(10.0, 60.0, 0.5), np.linspace(0.0, 3.0, 100), np.zeros(100)])
    poses = np.vstack([poses, np.full(3, np.nan)])
    clearance = wheel_clearance(RoadEdges(road, 3.0), (TRUCK,), (poses,))
    assert clearance.left == pytest.approx(3.0 - 4.0, abs=0.05)
    assert clearance.right == pytest.approx(3.0 - 1.0, abs=1e-9)


def test_a_vehicle_that_never_moved_has_no_clearance() -> None:
    road = np.column_stack([np.arange(0.0, 100.0), np.zeros(100)])
    assert all(map(math.isnan, wheel_clearance(RoadEdges(road, 3.0), (TRUCK,), (np.zeros((50, 3)),))))
