"""A virtual driver at the rear: PID with preview on the off-tracking error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer_steering.path_laws import VirtualDriver
from estimators.estimates import Health, OffTracking
from scenarios.courses import roundabout, straight
from sensors.messages import CombinationSignals
from tests.trailers import ALL_STEERED as TRAILER
from tests.trailers import estimate
from tests.trailers import signals as readings
from vehicle.frames import FloatArray

ROUNDABOUT = roundabout(front_x=5.2, width=2.55)
STRAIGHT = np.zeros(3)


def on_circle(radius: float, tick: int = 0) -> OffTracking:
    """A trailer that follows perfectly: hitch and follow point on the circle, whose chord is its axis."""
    angles = np.linspace(0.0, 2.2 * math.asin(7.0 / radius), 150)
    tangent = math.asin(7.0 / radius)
    along = -radius * (np.sin(angles - tangent) + math.sin(tangent))
    across = radius * (math.cos(tangent) - np.cos(angles - tangent))
    return estimate(
        tick,
        path=np.column_stack([along, across]),
        hitch_direction=tangent,
        path_tangent=-tangent,
        v_x=2.8 * math.cos(tangent),
        v_y=2.8 * math.sin(tangent),
        yaw_rate=2.8 / radius,
    )


def signals(tick: int, angles: FloatArray = STRAIGHT) -> CombinationSignals:
    """Only the encoders are looked at."""
    return readings(tick, angles=angles, speed=2.8)


def test_a_steady_turn_needs_no_error() -> None:
    """On a wide circle the angles of perfect following, -(x - Lf/2)/R, are kept without an error."""
    exact = -np.arctan((np.array(TRAILER.axle_distances) - 7.0) / math.sqrt(200.0**2 - 49.0))
    law = VirtualDriver(TRAILER)
    memory = law.init()
    for tick in range(0, 3000, 20):
        memory, command = law.step(memory, tick, on_circle(200.0, tick), signals(tick, exact))
    np.testing.assert_allclose(command.angles, exact, atol=1e-4)  # the path's points lie 0.2 m apart


@pytest.mark.parametrize("lag", [0.15, 0.4])
@pytest.mark.parametrize("speed", [2.8, 8.0, 16.0, 28.0])
def test_the_crossover_leaves_the_same_phase_at_every_speed(speed: float, lag: float) -> None:
    """A path that begins to lie 0.05 m to the left: the turn of the follow point per error, times v, is the crossover.

    Times the tyres' lag and a quarter of the others (0.1 s old, half of 0.1 s, the actuators) it stays below 0.7 rad.
    """
    trailer = replace(TRAILER, actuator_lag=lag, max_steer_rate=100.0)
    law = VirtualDriver(trailer, parameters=VirtualDriver.Parameters(integral=0.0))
    offset, memory = 0.05, law.init()
    path = np.column_stack([-np.linspace(0.0, 20.0, 81), np.full(81, offset)])
    for tick in (0, 100):
        beside = replace(on_circle(200.0, tick), path=path, hitch_direction=0.0, v_x=speed, v_y=0.0, yaw_rate=0.0)
        # the first command is limited to the initial angle: the second starts from straight wheels too
        memory, command = law.step(memory, tick + 100, beside, signals(tick + 100))
    distances = np.array(trailer.axle_distances)
    follow = np.arctan(np.tan(command.angles) * trailer.follow_distance / distances)
    np.testing.assert_allclose(follow, follow[0], rtol=0.01)  # one centre for all axles; share of small angles
    lags = 0.5 / speed + 0.022 * speed + 0.25 * (0.15 + lag)
    assert follow[0] / offset * speed == pytest.approx(min(speed / 1.5, 0.7 / lags), rel=0.02)


def test_a_trailer_keeps_enough_of_its_alignment_at_speed() -> None:
    """The direction of the path ahead is followed in full at walking pace, by less than half at 60 km/h."""
    law = VirtualDriver(replace(TRAILER, max_steer_rate=100.0), parameters=VirtualDriver.Parameters(integral=0.0))
    path = np.column_stack([-np.linspace(0.0, 20.0, 81), -0.02 * (np.linspace(0.0, 20.0, 81) - 14.0)])
    angles = []
    for speed in (2.8, 16.7):
        memory = law.init()
        for tick in (0, 100):
            along = replace(on_circle(200.0, tick), path=path, hitch_direction=0.02, v_x=speed, v_y=0.0, yaw_rate=0.0)
            along = replace(along, v_y=0.02 * speed, hitch_direction_rate=0.0)
            memory, command = law.step(memory, tick + 100, along, signals(tick + 100))
        angles.append(abs(float(command.angles[0])))
    assert angles[1] < 0.5 * angles[0]


def test_round_the_roundabout_it_keeps_within_three_centimetres(drive: Any) -> None:
    """10 km/h, no slip, estimates 0.1 s late: an unsteered trailer is 5 m off."""
    run = drive(ROUNDABOUT, TRAILER, VirtualDriver(TRAILER))
    assert run.rms < 0.012
    assert run.worst < 0.04


def test_integral_or_derivative_take_away_what_slip_leaves(drive: Any) -> None:
    """1 deg of slip on a straight road: proportion alone leaves 0.04 m."""
    course = straight(front_x=5.2, length=70.0)
    left = {
        (integral, derivative): drive(
            course,
            TRAILER,
            VirtualDriver(TRAILER, parameters=VirtualDriver.Parameters(integral=integral, derivative=derivative)),
            slip=lambda lateral_acceleration: -0.0175,
        ).off_tracking[-1]
        for integral, derivative in ((0.0, 0.0), (0.06, 0.0), (0.0, 1.0))
    }
    assert abs(left[0.0, 0.0]) > 0.02
    assert abs(left[0.06, 0.0]) < 0.005
    assert abs(left[0.0, 1.0]) < 0.005


def test_a_lost_estimate_changes_nothing() -> None:
    """The law continues with the last usable one."""
    law = VirtualDriver(TRAILER)
    memory, _ = law.step(law.init(), 0, on_circle(20.0), signals(0))
    lost = replace(on_circle(-20.0, 20), health=Health.LOST, std=math.inf)
    _, seen = law.step(memory, 40, lost, signals(40))
    _, unseen = law.step(memory, 40, on_circle(20.0), signals(40))
    np.testing.assert_array_equal(seen.angles, unseen.angles)
