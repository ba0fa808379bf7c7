"""The parts of the predictive controller: reference, observer, friction, the assumed way."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from controllers.trailer import Combination
from controllers.trailer_steering.mpc.observer import (
    FrictionMemory,
    Observer,
    ObserverMemory,
    Reckoned,
    reckoned,
    updated,
)
from controllers.trailer_steering.mpc.planning import denser, hitch_course, path_now, reference, with_estimate
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from tests.trailers import estimate
from tests.trailers import signals as readings
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray, Pose2

FOLLOW, RADIUS, SPEED = 14.0, 12.0, 2.8
VEHICLE = load_vehicle("uk_longer_semitrailer")
LEVER = 0.7744762  # of the kingpin, before the drive axle [m]


def circle(angles: FloatArray) -> FloatArray:
    """Points (n, 2) of a left-hand circle that leaves the origin along x."""
    return RADIUS * np.column_stack([np.sin(angles), 1.0 - np.cos(angles)])


def test_on_a_circle_the_wanted_headings_are_chords() -> None:
    """The chord of the follow distance lags the hitch's direction by asin(L / 2R); its middle is R - R cos inside."""
    ahead = hitch_course(0.0, SPEED / RADIUS, SPEED, 0.05, 24)
    behind = denser(circle(-np.arange(0.0, 16.0, 0.28) / RADIUS))
    wanted = reference(ahead.points, behind, FOLLOW)
    assert wanted is not None
    lag = math.asin(0.5 * FOLLOW / RADIUS)
    np.testing.assert_allclose(wanted.headings, ahead.directions - lag, atol=1e-4)  # 1 mm at the follow point
    # the path lies to the right of the chord in a left turn
    np.testing.assert_allclose(wanted.offsets, -(RADIUS - RADIUS * math.cos(lag)), atol=0.02)  # nearest point: 0.1 m


def test_a_path_with_two_seconds_missing_stays_on_its_circle() -> None:
    """Points 0.28 m apart but for a hole of 5.8 m: a cubic for even spacing would fold the path by 0.35 m there."""
    angles = np.arange(0.0, 16.0, 0.28)
    path = denser(circle(-angles[(angles < 3.0) | (angles > 8.8)] / RADIUS))
    assert np.hypot(path[:, 0], path[:, 1] - RADIUS) == pytest.approx(RADIUS, abs=0.02)  # sagitta of its chord: 0.35 m
    steps = np.hypot(*np.diff(path, axis=0).T)
    assert steps.min() > 0.1
    assert steps.max() < 0.21  # no piece is longer than 0.2 m of the path's chords


def test_a_path_with_repeated_points_is_made_denser() -> None:
    """A trailer at standstill leaves the same point twice; on a straight the points between are on it."""
    x = np.array([0.0, 0.0, -0.5, -1.0, -1.0, -1.5])
    path = denser(np.column_stack([x, 0.0 * x]))
    np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-12)
    assert np.diff(path[:, 0]).max() < 0.0


def test_a_path_too_short_for_the_follow_point_asks_for_nothing() -> None:
    """13 m of path for a trailer of 14 m."""
    ahead = hitch_course(0.0, 0.0, SPEED, 0.05, 24)
    behind = np.column_stack([-np.arange(0.0, 11.0, 0.25), np.zeros(44)])
    assert reference(ahead.points[:4], behind, FOLLOW) is None


def signals(tick: int, *, lead: float, own: float, articulation: float = 0.0) -> CombinationSignals:
    return readings(tick, speed=SPEED, articulation=np.array([articulation]), yaw_rates=np.array([lead, own]))


def travelling(tick: int, direction: float = 0.0, **changes: Any) -> OffTracking:
    """An estimate with the hitch's travel in this direction [rad]."""
    v_x, v_y = SPEED * math.cos(direction), SPEED * math.sin(direction)
    return estimate(tick, hitch_direction=direction, v_x=v_x, v_y=v_y, **changes)


def test_the_hitch_is_reckoned_along_its_circle() -> None:
    """Trailer and tractor turning alike, 1 s: the hitch is where the circle has it, the trailer has turned as much."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    rate = SPEED / RADIUS
    lag = math.atan(LEVER * rate / SPEED)
    for tick in range(0, 1001, 20):
        memory = observer.with_signals(memory, signals(tick, lead=rate, own=rate, articulation=-lag))
    moved = reckoned(memory.records, 0)
    assert memory.now.hitch_direction == pytest.approx(0.0, abs=0.002)  # the mean lever of the fixed axles
    assert moved.frame.psi == pytest.approx(rate, abs=1e-9)
    way = memory.now.speed
    assert (moved.frame.x, moved.frame.y) == pytest.approx(tuple(circle(np.array([rate]))[0] * way / SPEED), abs=0.01)
    assert len(moved.hitch_path) == 50


def test_a_slide_of_the_unit_ahead_shows_in_the_estimates_alone() -> None:
    """Gyros still, the hitch's direction grows by 0.2 rad/s: followed within the 0.2 s of one estimate and its age."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    for tick in range(0, 2001, 20):
        memory = observer.with_signals(memory, signals(tick, lead=0.0, own=0.0))
        if tick % 100 == 0 and tick > 0:
            seen_tick = tick - 100
            memory = observer.corrected(memory, travelling(seen_tick, direction=2e-4 * (seen_tick - 50)), 0.1)
    assert memory.now.hitch_direction == pytest.approx(0.4, abs=0.04)
    assert memory.uncertainty > 0.0


def test_the_gyros_bias_is_learnt_from_the_estimates() -> None:
    """0.2 deg/s for 20 s, four times the time of its low-pass: 2 % of it are left."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    bias = math.radians(0.2)
    for tick in range(0, 20001, 20):
        memory = observer.with_signals(memory, signals(tick, lead=0.0, own=bias))
        if tick % 100 == 0 and tick > 0:
            memory = observer.corrected(memory, travelling(tick - 100), 0.1)
    assert memory.bias == pytest.approx(bias, rel=0.05)


def test_the_first_estimate_after_a_gap_teaches_nothing_but_the_path() -> None:
    """Its yaw rate is of its last frame, not of the 3 s without any; what the axles ahead did meanwhile is in doubt."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    for tick in range(0, 4001, 20):
        memory = observer.with_signals(memory, signals(tick, lead=0.0, own=1e-4 * tick))
        if tick % 100 == 0 and 0 < tick <= 1000:
            memory = observer.corrected(memory, travelling(tick - 100), 0.1)
    assert memory.uncertainty > 0.04  # 0.02 rad/s for 2.5 s
    after = observer.corrected(memory, travelling(3900), 3.0)
    assert (after.bias, after.slide, after.speed_scale) == (memory.bias, memory.slide, memory.speed_scale)
    np.testing.assert_array_equal(after.records, memory.records)


def driven(
    memory: FrictionMemory,
    true_moment: float,
    model_moment: float,
    by_friction: float,
    distance: float,
    uncertainty: float = 0.0,
) -> FrictionMemory:
    """The estimate after a distance; the model's tyres have a moment, plus the effect of its friction."""
    for _ in range(round(distance / 0.05)):
        moment = model_moment + by_friction * (memory.log_friction - FrictionMemory().log_friction)
        memory = updated(memory, moment - memory.disturbance - true_moment, by_friction, 0.05, uncertainty)
    return memory


def test_sliding_tyres_tell_the_friction_within_a_few_metres() -> None:
    """All tyres slide: they should do 0.45 of their load and do 0.2. Most of it is friction's, not a disturbance."""
    memory = driven(FrictionMemory(), 0.2, 0.45, 0.45, 10.0)
    assert memory.friction < 0.3
    assert abs(memory.disturbance) < 0.05


def test_tyres_that_grip_tell_nothing_of_friction() -> None:
    """The rest of the accelerometer's reading is a disturbance, and most of it is kept.

    The stationary Kalman filter of a disturbance of 0.03 that is forgotten over L = 20 m, with noise r = 0.04^2 m, has
    the gain k = sqrt(1/L^2 + 2 0.03^2 / (L r)) - 1/L = 0.192 per metre and thus keeps k / (k + 1/L) = 0.794 of it.
    """
    memory = driven(FrictionMemory(), 0.05, 0.0, 0.0, 30.0)
    assert memory.friction == pytest.approx(FrictionMemory().friction)
    assert memory.disturbance == pytest.approx(-0.05 * 0.794, abs=0.001)  # steps of 0.05 m for a continuous filter


def test_friction_stays_while_the_motion_of_the_tyres_is_uncertain() -> None:
    """The same slide where the hitch's direction may be wrong by 5 deg: a third of it at most is believed."""
    sure = driven(FrictionMemory(), 0.2, 0.45, 0.45, 1.0)
    doubtful = driven(FrictionMemory(), 0.2, 0.45, 0.45, 1.0, uncertainty=0.4)
    first = FrictionMemory().log_friction
    assert first - doubtful.log_friction < 0.34 * (first - sure.log_friction)


SHORT = np.array([[0.0, 0.0], [-0.28, 0.0], [-0.56, 0.0]])


def test_a_straight_trailer_is_assumed_to_start_on_its_path() -> None:
    """While the path is shorter than the trailer, the axis at its beginning continues it to the rear."""
    lost = travelling(200, path=SHORT, health=Health.LOST)
    begun = with_estimate(None, lost, FOLLOW)
    assert begun is not None
    assert not begun.complete
    so_far = path_now(begun, Reckoned(Pose2(0.28, 0.0, 0.0), np.array([[0.28, 0.0]])), FOLLOW)
    assert so_far is not None
    assert so_far[:, 0].min() < -FOLLOW
    assert not so_far[:, 1].any()
    turned = with_estimate(None, travelling(200, path=SHORT, health=Health.LOST, direction=0.3), FOLLOW)
    assert turned is not None
    assert path_now(turned, Reckoned(Pose2(0.0, 0.0, 0.0), np.empty((0, 2))), FOLLOW) is None


def test_a_whole_path_without_health_is_not_used() -> None:
    """There the odometry failed, and its path is a guess."""
    first = with_estimate(None, travelling(100), FOLLOW)
    assert with_estimate(first, travelling(200, health=Health.LOST), FOLLOW) is first
    assert with_estimate(None, travelling(200, health=Health.LOST), FOLLOW) is None
