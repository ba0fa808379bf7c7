"""Path of the hitch: where it crosses the follow point, its tangent, and the point at the height of the roll axis."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.estimates import Anchor, Health
from estimators.off_tracking.buffer import BodyMotion, OffTrackingBuffer
from estimators.off_tracking.hitch_path import crossing, tangent
from estimators.off_tracking.pose_chain import Sample, extended, first_sample, with_bridge
from estimators.rigid_motion import UncertainMotion
from scenarios.results.metrics import true_off_tracking
from vehicle.combination.truth import plan_pose
from vehicle.frames import FloatArray, inverse, raised, rotation_zyx, transform
from vehicle.surface import Surface

RADIUS = 20.0  # [m]
AHEAD = transform(np.eye(3), np.array([1.0, 0.0, 0.0]))


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


FOLLOW, AXLE = 13.0, 9.0  # hitch to follow point and to the axles [m]
HEIGHT = 0.7  # of the roll axis [m]
STEP = 0.1  # [m]


def bodies_on(surface: Surface, roll: float) -> FloatArray:
    """X_WB (n, 4, 4) of a trailer that is pulled along a straight, a left turn of R = 14 m by 180 deg and a straight.

    Its body rolls by up to ``roll`` [rad] about its roll axis, a full swing every 7 m.
    """
    s = np.arange(0.0, 100.0, STEP)
    heading = np.clip((s - 30.0) / 14.0, 0.0, math.pi)
    x, y = (STEP * np.cumsum(part(heading)) for part in (np.cos, np.sin))
    psi, poses = 0.0, []
    for k, station in enumerate(s):
        psi += STEP / AXLE * math.sin(heading[k] - psi)
        stands = surface.pose_on(float(x[k]), float(y[k]), psi, (0.0, -AXLE))
        leans = rotation_zyx(0.0, 0.0, roll * math.sin(2.0 * math.pi * station / 7.0))
        poses.append(stands @ raised(HEIGHT) @ transform(leans, np.zeros(3)) @ raised(-HEIGHT))
    return np.array(poses)


def true_of(bodies: FloatArray, height: float) -> FloatArray:
    """True off-tracking (n,) of points at a height [m] in the body."""
    x, y, psi = plan_pose(bodies, height).T
    return true_off_tracking(x, y, np.unwrap(psi), FOLLOW)


def errors_and_stds(bodies: FloatArray, height: float) -> tuple[FloatArray, FloatArray]:
    """Errors of the estimates from exact motions of points at a height [m], and their stated deviations [m]."""
    true, buffer, every = true_of(bodies, HEIGHT), OffTrackingBuffer(FOLLOW), 4
    memory, errors, stds = buffer.init(), [], []
    for k in range(every, len(bodies), every):
        X_PC = inverse(bodies[k - every] @ raised(height)) @ bodies[k] @ raised(height)
        motion = BodyMotion(
            tick=100 * k, previous_tick=100 * (k - every), X_PC=X_PC, covariance=np.zeros((6, 6)), health=Health.OK
        )
        memory, estimate = buffer.step(memory, motion)
        if estimate.health is not Health.LOST and np.isfinite(true[k]):
            errors.append(estimate.value - true[k])
            stds.append(estimate.std)
    return np.array(errors), np.array(stds)


@pytest.mark.slow
@pytest.mark.parametrize("roll", [0.0, 0.02])
@pytest.mark.parametrize("cross_fall", [0.0, 0.025, -0.025])
def test_exact_motions_give_the_true_off_tracking_on_a_bank(cross_fall: float, roll: float) -> None:
    """Conical ground turns its normal with the path: points at another height have another off-tracking.

    What is left is the tilt of the path's mean plane, and what is stated for it.
    """
    bodies = bodies_on(Surface(friction=0.8, cross_fall=cross_fall, centre=(30.0, 14.0)), roll)
    errors, stds = errors_and_stds(bodies, HEIGHT)
    assert np.sqrt(np.mean(errors**2)) < 0.0025
    # 0.5 mm: the path between samples, 0.4 m apart, is a cubic
    assert np.mean(np.abs(errors) < 2.5 * stds + 0.0005) > 0.95
    if cross_fall or roll:
        on_ground, _ = errors_and_stds(bodies, 0.0)
        assert np.sqrt(np.mean(on_ground**2)) > 0.003


def test_points_lie_beside_those_on_the_ground_by_bank_times_height() -> None:
    """On a plane that falls by 5 % to the right, a point 0.7 m up in a body lies 35 mm to the right of its foot."""
    plane = Surface(friction=0.8, cross_fall=0.05)
    foot = plane.pose_on(3.0, 4.0, 0.0, (0.0, -AXLE))
    x, y, psi = plan_pose(foot, HEIGHT).tolist()
    assert (x, psi) == pytest.approx((3.0, 0.0), abs=1e-12)
    assert y == pytest.approx(4.0 - HEIGHT * math.sin(math.atan(0.05)), abs=1e-12)


def test_roll_about_the_roll_axis_does_not_move_the_points() -> None:
    """On level ground the pose in plan is that of the unit, however the body rolls."""
    level = Surface(friction=0.8)
    stands = level.pose_on(3.0, 4.0, 0.6, (0.0, -AXLE))
    leans = stands @ raised(HEIGHT) @ transform(rotation_zyx(0.0, 0.0, 0.1), np.zeros(3)) @ raised(-HEIGHT)
    np.testing.assert_allclose(plan_pose(leans, HEIGHT), [3.0, 4.0, 0.6], atol=1e-12)
    assert abs(plan_pose(leans, 0.0)[1] - 4.0) > 0.05


@pytest.mark.parametrize("since", [0, 1])
def test_a_bridge_takes_the_closing_error_in_proportion_and_is_known_at_its_ends(since: int) -> None:
    """Four frames of 1 m, the last one measured 0.2 m aside, from the bridge's beginning or from before it."""
    still, drifted = np.diag([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]), np.diag([0.0, 0.0, 0.0, 0.0, 3.0, 0.0])

    def sample(tick: int, covariance: FloatArray, y: float = 0.0) -> Sample:
        return Sample(tick, transform(np.eye(3), np.array([float(tick), y, 0.0])), 0, covariance, False)

    reckoned = tuple(sample(tick, drifted) for tick in (4, 3, 2, 1, 0))
    bridged = with_bridge((sample(4, still, 0.2), *reckoned[4 - since :]), reckoned, since)
    middle = next(one for one in bridged if one.tick == (2 if since == 0 else 3))
    u = 0.5 if since == 0 else 2.0 / 3.0
    assert middle.X_OS[1, 3] == pytest.approx(0.2 * u)
    assert middle.covariance[4, 4] == pytest.approx((u**2 if since == 0 else 0.0) + u * (1.0 - u) * 3.0)


def test_what_motions_are_measured_from_stays_beside_the_path_after_reversing() -> None:
    """3 m forwards, 1.5 m back: of the two samples ahead a keyframe is kept, else both errors add up."""
    samples: tuple[Sample, ...] = (first_sample(0),)
    for tick in (1, 2, 3):
        samples = extended(samples, tick, UncertainMotion(AHEAD, np.eye(6)), False, keep_start=False)
    back = UncertainMotion(transform(np.eye(3), np.array([-1.5, 0.0, 0.0])), 2.0 * np.eye(6))
    for keyframe, variance in ((3, 1.0), (-5, 2.0 + 1.0 + 1.0)):
        anchor = Anchor(tick=keyframe, X_AC=np.eye(4), covariance=np.eye(6))
        newest, *others = extended(samples, 4, back, False, keep_start=False, anchor=anchor)
        assert newest.covariance[0, 0] == variance
        assert [(one.tick, one.on_path) for one in others if one.tick != keyframe] == [(1, True), (0, True)]
        assert [one.on_path for one in others if one.tick == keyframe] == [False] * (keyframe == 3)
