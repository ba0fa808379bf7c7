"""Swept path against closed forms; the validation holds it against a table of roundabouts."""

import math

import numpy as np
import pytest

from controllers.path import Path, Segment, arc, line
from scenarios.results import swept_path
from vehicle.frames import FloatArray, Pose2

RIGID = swept_path.UnitOutline("rigid", 5.0, -2.0, 2.5, (3.8, 0.0), (2.0, 1.8))
TRAILER = swept_path.UnitOutline("trailer", 1.6, -11.9, 2.55, (-7.7,), (2.05,))


def along(*segments: Segment) -> FloatArray:
    """Poses every 5 cm of a frame that follows segments from the origin along x."""
    path = Path(Pose2(0.0, 0.0, 0.0), segments)
    return path.poses(np.arange(0.0, path.length, 0.05))


def on_circle(radius: float, turns: float = 1.0) -> FloatArray:
    """Poses of a body whose frame runs round a left circle about (0, radius), always along its tangent."""
    psi = np.linspace(0.0, 2 * math.pi * turns, 2000)
    return np.column_stack([radius * np.sin(psi), radius * (1.0 - np.cos(psi)), psi])


def test_a_rectangle_on_a_circle_has_its_corner_outside_and_its_flank_inside() -> None:
    """Outer radius: the outer front corner; inner: the middle of the inner flank, where the radius stands on it."""
    inner, outer = swept_path.swept_radii((RIGID,), (on_circle(10.0),), (0.0, 10.0))
    assert inner == pytest.approx(10.0 - 1.25, abs=1e-9)  # rounding
    assert outer == pytest.approx(math.hypot(10.0 + 1.25, 5.0), abs=1e-9)


def test_a_rectangle_on_a_circle_has_the_same_width_across_its_path() -> None:
    """The path of the middle of the front is concentric, so square to it is radial."""
    path = swept_path.swept_path((RIGID,), (on_circle(10.0),), None)
    assert path.max_width == pytest.approx(math.hypot(11.25, 5.0) - 8.75, abs=2e-3)  # [m] finite steps of 0.1 m
    assert math.isnan(path.min_inner_radius)


def test_the_other_legs_of_a_figure_of_eight_do_not_widen_the_path() -> None:
    """Two circles that touch, led by the middle of the front: the tail swings out to either side."""
    led = swept_path.UnitOutline("led by its front", 0.0, -7.0, 2.5, (), ())
    first = on_circle(10.0)
    both = np.concatenate([first, on_circle(10.0) * np.array([1.0, -1.0, -1.0])])
    alone = swept_path.swept_path((led,), (first,), None).max_width
    assert alone == pytest.approx(math.hypot(11.25, 7.0) - 8.75, abs=2e-3)  # [m] finite steps of 0.1 m
    both_circles = swept_path.swept_path((led,), (both,), None).max_width
    assert both_circles == pytest.approx(alone, abs=0.05)  # [m] where they touch, the tail has been on both sides


def test_straight_driving_sweeps_the_own_width() -> None:
    straight = np.column_stack([np.linspace(0.0, 50.0, 500), np.zeros(500), np.zeros(500)])
    path = swept_path.swept_path((RIGID,), (straight,), None)
    assert path.max_width == pytest.approx(2.5, abs=1e-9)  # rounding
    assert math.isnan(path.tail_swing)


def test_dragging_at_an_angle_sweeps_the_rectangles_shadow() -> None:
    """Width across the direction of travel: L sin(a) + W cos(a)."""
    slip = math.radians(14.0)
    dragged = np.column_stack([np.linspace(0.0, 60.0, 600), np.zeros(600), np.full(600, slip)])
    expected = 7.0 * math.sin(slip) + 2.5 * math.cos(slip)
    assert swept_path.swept_path((RIGID,), (dragged,), None).max_width == pytest.approx(expected, abs=1e-6)  # rounding


@pytest.mark.parametrize("start", [Pose2(0.0, 0.0, 0.0), Pose2(30.0, -70.0, 2.0)])
def test_more_than_a_full_turn_is_still_one_roundabout(start: Pose2) -> None:
    """450 degrees: the straight entry crosses the circle's exit and must count as neither, wherever it lies."""
    path = Path(start, (line(20.0), arc(25.0 * math.pi, 0.1), line(20.0)))
    poses, centre = path.poses(np.arange(0.0, path.length, 0.05)), start @ Pose2(20.0, 10.0, 0.0)
    inner, outer = swept_path.swept_radii((RIGID,), (poses,), (centre.x, centre.y))
    assert inner == pytest.approx(10.0 - 1.25, abs=1e-6)
    assert outer == pytest.approx(math.hypot(10.0 + 1.25, 5.0), abs=1e-3)
    assert swept_path.swept_path((RIGID,), (poses,), (centre.x, centre.y)).max_width == outer - inner


def test_tail_swing_at_entry_has_the_closed_form() -> None:
    """A body turning about a point of its middle line at x = 0: hypot(overhang, R + W/2) - R - W/2."""
    straight = np.column_stack([np.linspace(-20.0, -0.1, 200), np.zeros(200), np.zeros(200)])
    poses = np.concatenate([straight, on_circle(10.0, turns=0.25)])
    assert swept_path.tail_swings((RIGID,), (poses,))[0] == pytest.approx(
        math.hypot(2.0, 11.25) - 11.25, abs=1e-5
    )  # [m] steps of 1e-3 rad


@pytest.mark.parametrize("side", [1, -1])
def test_a_rear_that_swings_out_on_the_way_out_is_seen_too(side: int) -> None:
    """A trailer that points 0.2 rad too far into the turn when it is back on the straight has its rear outside."""
    yaw = np.concatenate([np.linspace(0.0, math.pi / 2, 300), np.full(300, math.pi / 2)])
    beyond = np.concatenate([np.zeros(300), np.linspace(0.0, 30.0, 300)])
    tractor = np.column_stack([30.0 * np.sin(yaw), 30.0 * (1.0 - np.cos(yaw)) + beyond, yaw])
    trailer = tractor + np.column_stack(
        [np.zeros((600, 2)), np.concatenate([np.zeros(300), np.linspace(0.2, 0.0, 300)])]
    )
    mirror = np.array([1.0, side, side])
    swing = swept_path.tail_swings((RIGID, TRAILER), (tractor * mirror, trailer * mirror))
    assert swing[1] == pytest.approx(11.9 * math.sin(0.2) + 1.275 * math.cos(0.2) - 1.275, abs=1e-9)  # rounding


def test_a_vehicle_that_never_turned_was_on_no_roundabout() -> None:
    straight = np.column_stack([np.linspace(0.0, 5.0, 50), np.zeros(50), np.zeros(50)])
    path = swept_path.swept_path((RIGID,), (straight,), (20.0, 12.0))
    assert math.isnan(path.max_width)
    assert math.isnan(path.min_inner_radius)


def test_a_body_of_which_only_a_corner_is_in_the_sector_has_no_radii() -> None:
    """A turn of 12 degrees a vehicle's length before the circle: its inner flank is nearest to the centre elsewhere."""
    poses = np.array([[4.3, 0.0, 0.0], [4.3, 0.0, math.radians(12.0)]])
    assert all(map(math.isnan, swept_path.swept_radii((RIGID,), (poses,), (0.0, 10.0))))


def test_wheels_turn_about_their_own_middle() -> None:
    pose = np.array([[10.0, 5.0, math.pi / 2]])
    wheels = swept_path.placed_wheels(RIGID, pose, np.array([[math.pi / 2, 0.0]]))[0]
    middles = swept_path.placed(np.array([[3.8, 1.0], [3.8, -1.0], [0.0, 0.9], [0.0, -0.9]]), pose)[0]
    np.testing.assert_allclose(wheels.mean(axis=1), middles, atol=1e-12)  # rounding
    assert np.ptp(wheels[0][:, 0]) == pytest.approx(1.0)  # steered by 90 degrees: its length lies along x again
    assert np.ptp(wheels[2][:, 1]) == pytest.approx(1.0)


def test_a_long_combination_in_a_hairpin_is_as_wide_as_its_bodies() -> None:
    """Its last unit is on the other leg, 20 m beside the first; units of 2 m that keep the path sweep 2.1 m there."""
    way = along(line(40.0), arc(10.0 * math.pi, 0.1), line(40.0))
    units = tuple(swept_path.UnitOutline(f"unit {k}", 1.0, -1.0, 2.0, (), ()) for k in range(8))
    poses = tuple(way[np.maximum(np.arange(len(way)) - 60 * k, 0)] for k in range(8))  # 3 m apart
    width = swept_path.width_across_path(units, poses)
    assert width == pytest.approx(math.hypot(11.0, 1.0) - 9.0, abs=0.02)  # corners of the square on the bend


def test_a_tail_does_not_swing_out_where_the_next_turn_is_the_other_way() -> None:
    """An S-bend takes the rear to the other side of the first straight, as it takes the whole vehicle."""
    yaw = np.concatenate([np.linspace(0.0, -0.7, 200), np.linspace(-0.7, 1.5, 600)])
    along = np.column_stack([np.cos(yaw), np.sin(yaw)]) * 0.1
    poses = np.column_stack([np.cumsum(along, axis=0), yaw])
    poses = np.vstack([np.column_stack([np.arange(-30.0, 0.0, 0.1), np.zeros((300, 2))]), poses])
    outline = swept_path.UnitOutline("truck", 5.0, -1.0, 2.5, (), ())
    swing, _ = swept_path.tail_swings((outline,), (poses,))
    assert 0.0 <= swing < 0.1


# Clearance of the wheels to the edges of the road


TRUCK = swept_path.UnitOutline("truck", 5.0, -1.0, 2.5, (4.0, 0.0), (2.0, 1.8))


def least(clearance: swept_path.Clearance) -> list[float]:
    """Least distances to the left and right edge [m]."""
    rows = [clearance.least(side) for side in (0, 1)]
    assert None not in rows
    return [float(clearance.distance[row, side]) for side, row in enumerate(rows)]


def test_clearance_on_a_circle_is_that_of_the_outer_front_and_the_inner_rear_wheel() -> None:
    """Rear axle on a circle of 20 m, left turn; the road's middle is on 21 m, its edges 3 and 4 m beside it."""
    angle = np.linspace(0.0, math.pi, 2000)
    road = 21.0 * np.column_stack([np.sin(angle), -np.cos(angle)])
    edges = swept_path.RoadEdges(road, np.tile([3.0, 4.0], (len(road), 1)))
    inner = angle[200:-400]
    poses = np.column_stack([20.0 * np.sin(inner), -20.0 * np.cos(inner), inner])
    clearance = swept_path.wheel_clearance(edges, (TRUCK,), (poses,))
    left, right = least(clearance)
    assert left == pytest.approx(20.0 - 0.9 - 18.0, abs=1e-4)
    assert right == pytest.approx(25.0 - math.hypot(21.0, 4.0), abs=1e-4)


def test_the_swept_path_stays_inside_a_lane_by_the_sides_and_corners_of_its_bodies() -> None:
    """The same drive: the inner side beside the rear axle, 0.35 m further in than the wheel, and the front corner."""
    angle = np.linspace(0.0, math.pi, 2000)
    road = 21.0 * np.column_stack([np.sin(angle), -np.cos(angle)])
    inner = angle[200:-400]
    poses = np.column_stack([20.0 * np.sin(inner), -20.0 * np.cos(inner), inner])
    clearance = swept_path.body_clearance(
        swept_path.RoadEdges(road, np.tile([3.0, 4.0], (len(road), 1))), (TRUCK,), (poses,)
    )
    left, right = least(clearance)
    assert left == pytest.approx(20.0 - 1.25 - 18.0, abs=1e-4)
    assert right == pytest.approx(25.0 - math.hypot(21.25, 5.0), abs=1e-4)


def test_a_wheel_beyond_the_edge_counts_negative_and_rows_that_are_no_numbers_not_at_all() -> None:
    road = np.column_stack([np.arange(0.0, 100.0), np.zeros(100)])
    poses = np.column_stack([np.arange(10.0, 60.0, 0.5), np.linspace(0.0, 3.0, 100), np.zeros(100)])
    poses = np.vstack([poses, np.full(3, np.nan)])
    clearance = swept_path.wheel_clearance(swept_path.RoadEdges(road, 3.0), (TRUCK,), (poses,))
    left, right = least(clearance)
    assert left == pytest.approx(3.0 - 4.0, abs=0.05)
    assert right == pytest.approx(3.0 - 1.0, abs=1e-9)


def test_a_vehicle_that_never_moved_has_no_clearance() -> None:
    road = np.column_stack([np.arange(0.0, 100.0), np.zeros(100)])
    clearance = swept_path.wheel_clearance(swept_path.RoadEdges(road, 3.0), (TRUCK,), (np.zeros((50, 3)),))
    assert [clearance.least(side) for side in (0, 1)] == [None, None]
