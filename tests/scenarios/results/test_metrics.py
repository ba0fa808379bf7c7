"""Metrics against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.results import metrics
from scenarios.results.metrics import true_off_tracking
from vehicle.frames import FloatArray

STEP = 0.01  # [s]


def circling(radius: float, speed: float, axle: float, turns: float = 1.2) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hitch path and yaw of a trailer that has always been on a left circle without slip."""
    angle = np.arange(0.0, 2 * math.pi * turns, speed * STEP / radius)
    articulation = math.asin(axle / radius)  # the axle's velocity is along the trailer: at right angles to its radius
    return radius * np.sin(angle), -radius * np.cos(angle), angle - articulation


@pytest.mark.parametrize(("radius", "speed"), [(12.0, 4.0), (15.0, 4.0), (20.0, 2.0), (100.0, 12.0)])
def test_steady_circle_has_the_closed_form_off_tracking(radius: float, speed: float) -> None:
    """|e| = sqrt(R^2 - (Lf - La)^2) - sqrt(R^2 - La^2), from two right triangles about the centre.

    The trailer cuts in on a left circle, so the path lies on its right: negative.
    """
    axle, follow = 9.0, 14.0
    e = true_off_tracking(*circling(radius, speed, axle), follow)
    expected = math.sqrt(radius**2 - axle**2) - math.sqrt(radius**2 - (follow - axle) ** 2)
    assert np.isnan(e).sum() < 0.5 * len(e)
    there = e[np.isfinite(e)]
    np.testing.assert_allclose(there[1:], expected, atol=1e-7)  # [m] the chord alone would be 2e-5 off
    assert there[0] == pytest.approx(expected, abs=1e-5)  # [m] where the path begins there is no older sample


@settings(max_examples=30)
@given(st.floats(13.0, 60.0), st.floats(0.5, 20.0), st.floats(5.0, 10.0), st.floats(8.0, 12.9))
def test_off_tracking_flips_in_the_mirror(radius: float, speed: float, axle: float, follow: float) -> None:
    x, y, psi = circling(radius, speed, axle)
    e, mirrored = true_off_tracking(x, y, psi, follow), true_off_tracking(x, -y, -psi, follow)
    np.testing.assert_allclose(mirrored, -e, atol=1e-12)  # [m] rounding of sin and cos


def test_off_tracking_does_not_depend_on_where_the_world_is() -> None:
    x, y, psi = circling(15.0, 4.0, 9.0)
    e = true_off_tracking(x, y, psi, 14.0)
    c, s = math.cos(2.0), math.sin(2.0)
    moved = true_off_tracking(c * x - s * y + 50.0, s * x + c * y - 80.0, psi + 2.0 - 2 * math.pi, 14.0)
    np.testing.assert_allclose(moved, e, atol=1e-9)  # [m] rounding at 100 m


def test_straight_driving_at_an_angle_gives_the_tangent() -> None:
    """Dragged with 14 degrees of yaw, the path lies 14 m tan(14 deg) = 3.4906 m beside (de Saxe 2018, section 3.1).

    The nose points left of the travel, the rear is right of the path, so the path lies left: positive.
    """
    n, slip = 1000, math.radians(14.0)
    e = true_off_tracking(0.05 * np.arange(n, dtype=np.float64), np.zeros(n), np.full(n, slip), 14.0)
    first = math.ceil(14.0 / math.cos(slip) / 0.05)  # sample by which the path is long enough
    assert np.isnan(e[:first]).all()
    np.testing.assert_allclose(e[first + 1 :], 14.0 * math.tan(slip), atol=1e-9)  # [m] nothing to interpolate


def test_only_the_newest_crossing_counts_where_the_path_crosses_itself() -> None:
    """After a full loop the old entry lies beside the new path; the follow point must follow the newer one."""
    s = np.arange(0.0, 40.0 + 2 * math.pi * 12.0 + 10.0, 0.04)
    turned = np.clip((s - 40.0) / 12.0, 0.0, 2 * math.pi)
    beyond = np.where(s < 40.0, s, np.maximum(40.0, s - 2 * math.pi * 12.0))
    x, y = beyond + 12.0 * np.sin(turned), 12.0 * (1.0 - np.cos(turned))
    e = true_off_tracking(x, y, turned, 14.0)
    # The hitch stands 10 m out of the circle on the very line it came in on; 14 m back along this line the newest path
    # is still 4 m on the circle, 12 - sqrt(12^2 - 4^2) to the left.
    on_circle = 14.0 - (x[-1] - 40.0)
    assert e[-1] == pytest.approx(12.0 - math.sqrt(12.0**2 - on_circle**2), abs=1e-6)  # [m] as on any circle


def test_standing_still_changes_nothing() -> None:
    x, y, psi = circling(15.0, 4.0, 9.0)
    e = true_off_tracking(x, y, psi, 14.0)
    waiting = np.repeat(np.arange(len(x)), np.where(np.isin(np.arange(len(x)), (900, 1400)), 300, 1))
    held = true_off_tracking(x[waiting], y[waiting], psi[waiting], 14.0)
    np.testing.assert_allclose(held, e[waiting], atol=2e-5)  # [m] the cubic beside the stop is no better than the chord


def test_going_back_takes_the_path_up() -> None:
    """Back along the way it came a trailer has the off-tracking it had there, and so it has forwards again."""
    x, y, psi = circling(15.0, 4.0, 9.0)
    there = true_off_tracking(x, y, psi, 14.0)
    n = len(x)
    order = np.concatenate([np.arange(n), np.arange(n - 2, n - 600, -1), np.arange(n - 600, n)])
    e = true_off_tracking(x[order], y[order], psi[order], 14.0)
    np.testing.assert_allclose(e, there[order], atol=2e-5)  # [m] at the joins the cubic is no better than the chord


def test_a_short_path_has_no_off_tracking() -> None:
    assert np.isnan(true_off_tracking(np.zeros(1), np.zeros(1), np.zeros(1), 14.0)).all()
    assert true_off_tracking(np.empty(0), np.empty(0), np.empty(0), 14.0).shape == (0,)
    with pytest.raises(ValueError, match="follow_distance"):
        true_off_tracking(np.zeros(9), np.zeros(9), np.zeros(9), 0.0)


def test_statistics_pass_over_what_is_missing() -> None:
    values = np.array([np.nan, 3.0, np.nan, -4.0])
    assert metrics.rms(values) == pytest.approx(math.sqrt(12.5))
    assert metrics.peak(values) == 4.0
    assert metrics.mean(values) == -0.5
    assert all(math.isnan(f(np.full(3, np.nan))) for f in (metrics.rms, metrics.peak, metrics.mean))


def test_a_lost_estimate_has_no_error() -> None:
    """A lost estimate states 0 and means nothing: it must not count as an error of the size of the truth."""
    error = metrics.estimate_error(np.array([1.1, 0.0, np.nan]), np.ones(3), np.array([1.0, 2.0, np.nan]))
    np.testing.assert_allclose(error, [0.1, np.nan, np.nan], atol=1e-12)  # [m] rounding


def test_valid_fraction_counts_from_when_an_estimate_could_be_expected() -> None:
    """Lost while the path is too short, and at the very capture at which it becomes long enough, is no failure."""
    truth = np.array([np.nan, np.nan, np.nan, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    health = np.array([2.0, np.nan, 2.0, 2.0, 0.0, np.nan, 2.0, 1.0, np.nan, 0.0])
    assert metrics.valid_fraction(health, truth) == 0.75
    assert math.isnan(metrics.valid_fraction(health[:3], truth[:3]))


def test_stated_standard_deviations_are_held_against_the_errors() -> None:
    """An error at exactly 2.5 sigma is within; what is lost, or states an exact 0, does not count."""
    error = np.array([0.025, -0.03, 0.01, np.nan, 0.5])
    std = np.array([0.01, 0.01, 0.01, 0.01, 0.0])
    assert metrics.within_sigmas(error, std) == pytest.approx(2.0 / 3.0)
    assert metrics.nees(error, std) == pytest.approx((6.25 + 9.0 + 1.0) / 3.0)
    assert all(math.isnan(f(error[3:], std[3:])) for f in (metrics.within_sigmas, metrics.nees))


def test_the_longest_loss_lasts_from_the_last_usable_capture_to_the_next() -> None:
    """Captures every second row; a loss at the start does not count, one at the end does."""
    time = 0.1 * np.arange(14.0)
    health = np.full(14, np.nan)
    health[::2] = [2.0, 0.0, 2.0, 2.0, 1.0, 0.0, 2.0]
    assert metrics.longest_loss(health, time) == pytest.approx(0.6)
    health[8:13:2] = 2.0
    assert metrics.longest_loss(health, time) == pytest.approx(1.0)
    assert metrics.longest_loss(np.zeros(14), time) == 0.0
    assert math.isnan(metrics.longest_loss(np.full(14, 2.0), time))


def odometry_case(scale: float, yaw_bias: float) -> tuple[FloatArray, FloatArray]:
    """True poses on a circle and motions measured ``scale`` times as long, turned on by ``yaw_bias`` a frame."""
    psi = 0.03 * np.arange(200)
    z = np.cumsum(0.4 * np.exp(1j * psi))
    body = np.concatenate([[0.0], np.diff(z) * np.exp(-1j * psi[:-1])])
    motions = np.column_stack([scale * body.real, scale * body.imag, np.full(200, 0.03 + yaw_bias)])
    return np.column_stack([z.real, z.imag, psi]), motions


def test_an_odometry_that_measures_too_short_drifts_by_its_scale() -> None:
    """1 % too short, error over chord is 1 %; over the way travelled it is that times chord / arc."""
    poses, motions = odometry_case(0.99, 0.0)
    drift = metrics.odometry_drift(poses, motions, np.zeros(200, dtype=bool), 13.9)
    steps = 35  # of 0.4 m
    chord = math.sin(0.5 * 0.03 * steps) / math.sin(0.5 * 0.03) / steps
    np.testing.assert_allclose(drift, 0.01 * chord, rtol=1e-9)  # rounding


def test_a_yaw_bias_drifts_with_half_the_way() -> None:
    """On a straight a bias of q a frame puts the end of n frames off by about q n / 2 of the way."""
    n = 200
    poses = np.column_stack([0.4 * np.arange(n), np.zeros(n), np.zeros(n)])
    motions = np.column_stack([np.full(n, 0.4), np.zeros(n), np.full(n, 1e-4)])
    drift = metrics.odometry_drift(poses, motions, np.zeros(n, dtype=bool), 13.9)
    assert drift == pytest.approx(1e-4 * 34 / 2, rel=0.02)  # 35 steps, the first of them unturned; arc for chord


def test_perfect_odometry_does_not_drift_and_a_lost_motion_breaks_the_chain() -> None:
    """A stretch with a hole in it says nothing about the odometry; the others still do."""
    poses, motions = odometry_case(1.0, 0.0)
    whole = metrics.odometry_drift(poses, motions, np.zeros(200, dtype=bool), 14.0)
    lost = np.zeros(200, dtype=bool)
    lost[100] = True
    motions[100] = np.nan
    broken = metrics.odometry_drift(poses, motions, lost, 14.0)
    assert whole.max() < 1e-12  # rounding
    assert broken.max() < 1e-12
    assert len(whole) - len(broken) == 36  # the starts from which frame 100 is among the next 36
