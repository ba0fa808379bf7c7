"""Carrying a trailer from an old estimate to the moment when its steering has answered."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.equations import settle
from controllers.trailer_steering.kinematics import AxleGroup, Predictor, SteerHistory, angles_at, recorded
from estimators.estimates import OffTracking
from tests.trailers import TWO_OF_THREE as TRAILER
from tests.trailers import estimate, signals
from vehicle.frames import FloatArray

AXLES = AxleGroup.of(TRAILER)
PREDICTOR = Predictor(TRAILER, AXLES)


def seen(*, direction: float, direction_rate: float, speed: float, yaw_rate: float) -> OffTracking:
    return estimate(
        1000,
        hitch_direction=direction,
        hitch_direction_rate=direction_rate,
        v_x=speed * math.cos(direction),
        v_y=speed * math.sin(direction),
        yaw_rate=yaw_rate,
    )


def history(read: FloatArray) -> SteerHistory:
    """Readings (n, 2) every 20 ms from tick 1000 on."""
    past: SteerHistory = ()
    for k, angles in enumerate(read):
        past = recorded(past, signals(1000 + 20 * k, angles=angles), 3000)
    return past


def test_a_trailer_that_circles_steadily_goes_on_circling() -> None:
    """With angles that fit the circle the frame turns by r t about the centre and the hitch keeps its direction."""
    radius, speed, span = 10.0, 2.8, 0.4
    half = math.asin(7.0 / radius)
    angles = AXLES.steer_angles(half, -half, -0.02)
    turned = speed / radius * span
    circling = seen(direction=half, direction_rate=0.0, speed=speed, yaw_rate=speed / radius)
    ahead = PREDICTOR.ahead(circling, -0.02, history(np.tile(angles, (11, 1))), angles, 1400)
    chord = 2.0 * radius * math.sin(0.5 * turned)
    expected = (chord * math.cos(half + 0.5 * turned), chord * math.sin(half + 0.5 * turned), turned)
    assert tuple(ahead.frame) == pytest.approx(expected, abs=1e-5)  # the midpoint rule: v h (r h)^2/24 a step
    assert ahead.hitch_direction == pytest.approx(half, abs=1e-6)


def test_angles_read_meanwhile_and_on_their_way_turn_the_trailer() -> None:
    """Against 1 ms steps of the same motion: read ramp for 0.2 s, then 0.2 s of actuator towards the demand."""
    ramp = np.linspace([0.0, 0.0], [-0.07, -0.07], 11)
    demand = np.array([-0.3, -0.2])
    speed, direction, course_rate = 3.0, 0.2, 0.1
    start = seen(direction=direction, direction_rate=course_rate, speed=speed, yaw_rate=0.0)
    ahead = PREDICTOR.ahead(start, 0.01, history(ramp), demand, 1400)
    psi = 0.0
    for k in range(400):
        t = (k + 0.5) * 1e-3
        read = -0.07 * t / 0.2 * np.ones(2)
        coming = (
            settle([-0.07, -0.07], demand, t - 0.2, lag=TRAILER.actuator_lag, max_rate=TRAILER.max_steer_rate)
            if t > 0.2
            else read
        )
        moment = float(AXLES.steer_moment(coming))
        psi += speed * 1e-3 * AXLES.yaw_per_metre(direction + course_rate * t - psi, moment, 0.01)
    assert psi > 0.03  # there is something to predict: 0.4 m at the follow point
    assert ahead.frame.psi == pytest.approx(psi, abs=1e-4)  # 20 ms steps with piecewise linear angles
    assert ahead.hitch_direction == pytest.approx(direction + 0.4 * course_rate - psi, abs=1e-4)


def test_steer_readings_are_kept_in_order_and_only_as_long_as_needed() -> None:
    """A reading that comes again changes nothing; old ones go; between two the angle is interpolated."""
    past: SteerHistory = ()
    for tick in range(0, 200, 20):
        past = recorded(past, signals(tick, angles=np.array([tick * 1e-3, 0.0])), 100)
    assert recorded(past, signals(180, angles=np.ones(2)), 100) == past
    assert [reading.tick for reading in past] == [80, 100, 120, 140, 160, 180]
    assert angles_at(past, np.array([130.0, 0.0])) == pytest.approx(np.array([[0.13, 0.0], [0.08, 0.0]]))
