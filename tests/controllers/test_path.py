"""Paths by arc length."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import fresnel

from controllers.path import Path, Segment, arc, line
from vehicle.frames import Pose2

ORIGIN = Pose2(0.0, 0.0, 0.0)
WINDING = Path(
    Pose2(1.0, -2.0, 0.3),
    (line(10.0), Segment(4.0, 0.0, 0.1), arc(30.0, 0.1), Segment(8.0, 0.1, -0.08), arc(40.0, -0.08), line(5.0)),
)
stations = st.floats(0.0, WINDING.length)


def test_points_of_an_arc_lie_on_its_circle_which_closes() -> None:
    """A left arc from the origin along x has its centre at (0, R); the integration rule is exact to rounding there."""
    path = Path(ORIGIN, (arc(math.tau * 12.5, 1.0 / 12.5),))
    points = path.points(1.0)
    assert np.hypot(points[:, 0], points[:, 1] - 12.5) == pytest.approx(12.5, abs=1e-12)
    assert tuple(path.pose(path.length)) == pytest.approx((0.0, 0.0, math.tau), abs=1e-12)


def test_a_clothoid_is_the_fresnel_integral() -> None:
    """With curvature s/a^2, x = a sqrt(pi) C(s/(a sqrt(pi))) and y with S."""
    a = 9.0
    path = Path(ORIGIN, (Segment(20.0, 0.0, 20.0 / a**2),))
    for s in (3.0, 11.0, 20.0):
        sine, cosine = fresnel(s / (a * math.sqrt(math.pi)))
        expected = (a * math.sqrt(math.pi) * cosine, a * math.sqrt(math.pi) * sine, 0.5 * s**2 / a**2)
        assert tuple(path.pose(s)) == pytest.approx(expected, abs=1e-10)  # two roundings of sums of 32 terms


@given(stations)
def test_tangent_and_curvature_are_the_derivatives_of_position_and_heading(s: float) -> None:
    """Central differences over 2 h; their own error is curvature^2 h^2 / 6 = 2e-9, and the curvature's jumps none."""
    h = 1e-3
    before, at, after = (WINDING.pose(s + d) for d in (-h, 0.0, h))
    assert (after.x - before.x) / (2 * h) == pytest.approx(math.cos(at.psi), abs=1e-4)
    assert (after.y - before.y) / (2 * h) == pytest.approx(math.sin(at.psi), abs=1e-4)
    low, high = sorted((WINDING.curvature(s - h), WINDING.curvature(s + h)))
    assert low - 1e-6 <= (after.psi - before.psi) / (2 * h) <= high + 1e-6


@given(stations, st.floats(-4.0, 4.0), st.floats(-2.0, 2.0))
def test_projection_finds_the_foot_of_a_point_beside_the_path(s: float, offset: float, guess_error: float) -> None:
    """A point moved sideways by less than the radius of curvature projects back to where it came from."""
    pose = WINDING.pose(s)
    x, y = pose.x - offset * math.sin(pose.psi), pose.y + offset * math.cos(pose.psi)
    assert WINDING.project(x, y, near=s + guess_error) == pytest.approx(s, abs=1e-7)


def test_projection_stays_on_its_branch_where_the_path_crosses_itself() -> None:
    """A three-quarter circle between two lines crosses its own entry: the guess decides which branch is meant."""
    radius = 8.0
    path = Path(ORIGIN, (line(20.0), arc(1.5 * math.pi * radius, 1.0 / radius), line(20.0)))
    first, second = 20.0 - radius, 20.0 + 1.5 * math.pi * radius + radius
    crossing = path.pose(first)
    assert path.pose(second)[:2] == pytest.approx(crossing[:2], abs=1e-12)
    assert path.project(crossing.x, crossing.y, near=first + 1.0) == pytest.approx(first, abs=1e-9)
    assert path.project(crossing.x, crossing.y, near=second - 1.0) == pytest.approx(second, abs=1e-9)


def test_the_path_goes_on_straight_beyond_both_ends() -> None:
    assert WINDING.curvature(-1.0) == WINDING.curvature(WINDING.length + 1.0) == 0.0
    end, beyond = WINDING.pose(WINDING.length), WINDING.pose(WINDING.length + 3.0)
    assert (beyond.x - end.x, beyond.y - end.y) == pytest.approx((3 * math.cos(end.psi), 3 * math.sin(end.psi)))
    assert WINDING.project(beyond.x, beyond.y, near=WINDING.length) == pytest.approx(WINDING.length + 3.0, abs=1e-9)


@given(stations)
def test_mirror_symmetry(s: float) -> None:
    segments = tuple(Segment(g.length, -g.start_curvature, -g.end_curvature) for g in WINDING.segments)
    mirrored = Path(Pose2(WINDING.start.x, -WINDING.start.y, -WINDING.start.psi), segments)
    pose, image = WINDING.pose(s), mirrored.pose(s)
    assert (image.x, -image.y, -image.psi) == pytest.approx((pose.x, pose.y, pose.psi), abs=1e-12)
    assert mirrored.curvature(s) == -WINDING.curvature(s)


def test_a_path_is_a_value() -> None:
    again = Path(WINDING.start, WINDING.segments)
    assert again == WINDING
    assert pickle.loads(pickle.dumps(WINDING)).pose(33.0) == WINDING.pose(33.0)


@pytest.mark.parametrize(
    ("segments", "message"),
    [((), "segments"), ((line(0.0),), "length = 0.0 m"), ((arc(130.0, 0.1),), "turn = 13.000 rad")],
)
def test_a_malformed_path_is_refused(segments: tuple[Segment, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Path(ORIGIN, segments)
