"""Swept width and swing of corners, on motions whose geometry is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.path import Path, arc, line
from offtrack.studies.standards.low_speed import front_reach, reach
from scenarios.results.swept_path import UnitOutline, tail_swings
from vehicle.frames import FloatArray, Pose2

BODY = UnitOutline("truck", 6.0, -2.0, 2.5, (5.0, 0.0), (2.0, 2.0))
RADIUS, ENTRY = 12.0, 15.0  # of the rear axle's arc, before it [m]


def rolled(side: float) -> FloatArray:
    """Poses of a truck whose rear axle goes straight, round a quarter of a circle to ``side``, and straight."""
    path = Path(Pose2(0.0, 0.0, 0.0), (line(ENTRY), arc(0.5 * math.pi * RADIUS, side / RADIUS), line(15.0)))
    return np.array([path.pose(float(s)) for s in np.arange(0.0, path.length, 0.03)])


def front_path(side: float) -> Path:
    """A path that the middle of the rear axle follows, as reference of the reach."""
    return Path(Pose2(0.0, 0.0, 0.0), (line(ENTRY), arc(0.5 * math.pi * RADIUS, side / RADIUS), line(15.0)))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_truck_in_a_turn_sweeps_from_its_side_to_its_front_corner(side: float) -> None:
    """Beside the rear axle's circle: inside half the width, outside hypot(R + w/2, front) - R, at any one station."""
    swept = reach((BODY,), (rolled(side),), front_path(side))
    outermost = math.hypot(RADIUS + 1.25, 6.0) - RADIUS
    assert swept.width == pytest.approx(outermost + 1.25, abs=0.01)  # stations 0.1 m apart
    farthest = np.nanmax(front_reach(BODY, rolled(side), front_path(side)))
    assert farthest == pytest.approx(outermost, abs=1e-3)  # passes the middle of the turn every 3 cm


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_rear_overhang_swings_out_at_entry_only(side: float) -> None:
    """A rear corner 2 m behind the axle is at hypot(R + w/2, 2) from the centre: 0.15 m beyond the straight.

    At exit it comes from the inside and follows the axle onto the straight. Rows are 3 cm apart.
    """
    expected = math.hypot(RADIUS + 1.25, 2.0) - RADIUS - 1.25
    assert tail_swings((BODY,), (rolled(side),)) == pytest.approx((expected, 0.0), abs=1e-4)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_trailer_steered_too_far_swings_out_at_exit(side: float) -> None:
    """Yawed 5 degrees too far on the exit straight: the corner is 2 sin(5) - 1.25 (1 - cos(5)) outside."""
    poses = rolled(side)
    turned = ENTRY + 0.5 * math.pi * RADIUS
    travelled = np.arange(len(poses)) * 0.03
    bump = np.where((travelled > turned) & (travelled < turned + 6.0), side * math.radians(5.0), 0.0)
    overturned = poses + np.column_stack([np.zeros((len(poses), 2)), bump])
    out = 2.0 * math.sin(math.radians(5.0)) - 1.25 * (1.0 - math.cos(math.radians(5.0)))
    assert tail_swings((BODY,), (overturned,))[1] == pytest.approx(out, abs=1e-9)


def test_a_body_without_overhang_does_not_swing_out() -> None:
    """The rear axle's own corners never leave the straight to the outside."""
    stump = UnitOutline("truck", 6.0, 0.0, 2.5, (5.0, 0.0), (2.0, 2.0))
    assert tail_swings((stump,), (rolled(1.0),)) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_standing_straight_the_width_is_the_bodys() -> None:
    """Along a straight path nothing but the body's own width is swept."""
    poses = np.column_stack([np.arange(0.0, 20.0, 0.1), np.zeros(200), np.zeros(200)])
    path = Path(Pose2(0.0, 0.0, 0.0), (line(20.0),))
    assert reach((BODY,), (poses,), path).width == pytest.approx(2.5, abs=1e-9)
