"""Frames, polylines and the clock: poses compose, angles wrap, arc length adds up, samples keep their period."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.clock import Pipe, Schedule, to_ticks
from vehicle.frames import (
    R_BODY_CAMERA,
    Pose2,
    arc_length,
    dense,
    inverse,
    orthonormalised,
    planar,
    resampled,
    rotation_zyx,
    rows_every,
    skew,
    so3_exp,
    transform,
    wrap,
)

angles = st.floats(-20.0, 20.0)
positions = st.floats(-100.0, 100.0)
poses = st.builds(Pose2, positions, positions, angles)
vectors = st.tuples(angles, angles, angles).map(np.array)
ROUNDING = 1e-12  # 100 m and a few products: 100 * eps * 10


@given(poses, poses)
def test_composition_with_the_inverse_cancels(X_AB: Pose2, X_BC: Pose2) -> None:
    X = X_AB.inverse() @ (X_AB @ X_BC)
    assert (X.x, X.y) == pytest.approx((X_BC.x, X_BC.y), abs=ROUNDING)
    assert wrap(X.psi - X_BC.psi) == pytest.approx(0.0, abs=ROUNDING)


@given(poses, poses)
def test_planar_and_spatial_poses_compose_alike(X_AB: Pose2, X_BC: Pose2) -> None:

    def spatial(X: Pose2) -> np.ndarray:
        return transform(rotation_zyx(X.psi, 0.0, 0.0), np.array([X.x, X.y, 0.0]))

    X = planar(spatial(X_AB) @ spatial(X_BC))
    np.testing.assert_allclose(inverse(spatial(X_AB)) @ spatial(X_AB), np.eye(4), atol=ROUNDING)
    expected = X_AB @ X_BC
    assert (X.x, X.y) == pytest.approx((expected.x, expected.y), abs=ROUNDING)
    assert wrap(X.psi - expected.psi) == pytest.approx(0.0, abs=ROUNDING)


@given(poses, positions, positions)
def test_a_point_moves_like_the_origin_of_a_frame_there(X_AB: Pose2, x: float, y: float) -> None:
    at = X_AB @ Pose2(x, y, 0.0)
    assert X_AB.apply(np.array([[x, y]]))[0] == pytest.approx((at.x, at.y), abs=ROUNDING)
    quarter = Pose2(1.0, 2.0, math.pi / 2)  # left is positive: its x axis is where the left was
    assert quarter.apply(np.array([[3.0, 0.0]]))[0] == pytest.approx((1.0, 5.0), abs=1e-15)


@given(angles)
def test_wrapped_angles_differ_by_whole_turns(angle: float) -> None:
    """Half a turn to the right is reported as half a turn to the left."""
    wrapped = wrap(angle)
    assert -math.pi < wrapped <= math.pi
    assert (angle - wrapped) / math.tau == pytest.approx(round((angle - wrapped) / math.tau), abs=1e-12)
    assert wrap(-math.pi) == math.pi


@given(angles, angles, angles)
def test_yaw_pitch_roll_is_the_product_of_three_turns(yaw: float, pitch: float, roll: float) -> None:
    """R = R_z(yaw) R_y(pitch) R_x(roll), each by Rodrigues' formula."""
    z, y, x = np.eye(3)[::-1]
    product = so3_exp(yaw * z) @ so3_exp(pitch * y) @ so3_exp(roll * x)
    np.testing.assert_allclose(rotation_zyx(yaw, pitch, roll), product, atol=1e-13)


def test_pitch_is_nose_down_and_roll_left_side_up() -> None:
    """ISO 8855: the nose of a body pitched by a little lies lower, its left side after a roll higher."""
    assert (rotation_zyx(0.0, 0.1, 0.0) @ [1.0, 0.0, 0.0])[2] < 0.0
    assert (rotation_zyx(0.0, 0.0, 0.1) @ [0.0, 1.0, 0.0])[2] > 0.0


@given(vectors)
def test_the_exponential_is_a_rotation_about_its_vector(w: np.ndarray) -> None:
    R = so3_exp(w)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-13)
    np.testing.assert_allclose(R @ w, w, atol=1e-12)
    np.testing.assert_allclose(skew(w) @ np.array([1.0, 2.0, 3.0]), np.cross(w, [1.0, 2.0, 3.0]), atol=1e-12)


def test_orthonormalising_undoes_a_small_stretch() -> None:
    """The rotation nearest to a stretched rotation is that rotation: polar decomposition."""
    R = rotation_zyx(0.3, -0.2, 0.1)
    stretch = np.eye(3) + 1e-3 * np.array([[1.0, 0.5, 0.0], [0.5, -1.0, 0.2], [0.0, 0.2, 0.4]])
    np.testing.assert_allclose(orthonormalised(R @ stretch), R, atol=1e-14)


def test_a_camera_looks_along_the_body_axis_with_its_rows_level() -> None:
    """OpenCV axes of a forward camera: z forward, x to the right (-y), y down (-z)."""
    np.testing.assert_array_equal(R_BODY_CAMERA @ np.eye(3), np.column_stack([[0, -1, 0], [0, 0, -1], [1, 0, 0]]))


@pytest.mark.parametrize(("rate_hz", "period"), [(10.0, 100), (50.0, 20), (1000.0, 1), (0.5, 2000)])
def test_rates_become_whole_periods(rate_hz: float, period: int) -> None:
    assert Schedule.at_rate(rate_hz).period == period


@pytest.mark.parametrize("rate_hz", [30.0, 3.0, 1500.0, 0.0, -10.0])
def test_rates_that_do_not_divide_are_refused(rate_hz: float) -> None:
    """30 Hz is no whole number of milliseconds; a rounded period would drift."""
    with pytest.raises(ValueError, match=r"camera|positive"):
        Schedule.at_rate(rate_hz, name="camera")
    for seconds in (0.0005, -0.1, 0.10001):
        with pytest.raises(ValueError, match=f"latency = {seconds} s"):
            to_ticks(seconds, "latency")


@pytest.mark.parametrize(("period", "offset", "latency"), [(0, 0, 0), (10, -1, 0), (10, 0, -1)])
def test_impossible_schedules_are_refused(period: int, offset: int, latency: int) -> None:
    with pytest.raises(ValueError, match="period, offset, latency"):
        Schedule(period=period, offset=offset, latency=latency)


@given(st.integers(1, 500), st.integers(0, 500))
def test_samples_are_one_period_apart_from_the_offset_on(period: int, offset: int) -> None:
    schedule = Schedule(period=period, offset=offset)
    due = [tick for tick in range(offset + 5 * period) if schedule.due(tick)]
    assert due == [offset + k * period for k in range(5)]


@given(st.lists(st.integers(0, 100), max_size=20), st.integers(0, 100))
def test_a_pipe_delivers_what_is_due_in_order_and_once(delivery_ticks: list[int], now: int) -> None:
    pipe: Pipe[int] = Pipe()
    for k, tick in enumerate(delivery_ticks):
        pipe = pipe.put(tick, k)
    rest, delivered = pipe.deliver(now)
    assert delivered == tuple(k for k, tick in enumerate(delivery_ticks) if tick <= now)
    assert rest.deliver(now)[1] == ()
    assert set(rest.deliver(100)[1]) | set(delivered) == set(range(len(delivery_ticks)))


CORNER = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]])  # 5 m and 6 m


def test_polylines_are_measured_by_their_chords() -> None:
    """3-4-5 and a straight; a single point lies at zero; a repeated one adds nothing; resampled, and thinned."""
    assert arc_length(CORNER).tolist() == [0.0, 5.0, 11.0]
    assert arc_length(CORNER[:1]).tolist() == [0.0]
    assert arc_length(CORNER[[0, 1, 1, 2]]).tolist() == [0.0, 5.0, 5.0, 11.0]
    np.testing.assert_allclose(resampled(CORNER, np.array([2.5, 8.0])), [[1.5, 2.0], [3.0, 7.0]], atol=1e-12)
    points, spacing = dense(np.array([[0.0, 0.0], [0.0, 10.5]]), 2.0)
    assert (spacing, points[-1, 1]) == pytest.approx((2.1, 10.5))
    np.testing.assert_allclose(arc_length(points), spacing * np.arange(6), atol=1e-12)
    assert rows_every(np.column_stack([np.arange(10.0), np.zeros(10)]), 3.0).tolist() == [0, 3, 6]
