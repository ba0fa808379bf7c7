"""A virtual driver at the rear: PID with preview on the off-tracking error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer_steering.virtual_driver import VirtualDriver
from estimators.estimates import Health, OffTracking
from scenarios.courses import roundabout, straight
from sensors.messages import CombinationSignals
from tests.trailers import ALL_STEERED as TRAILER

ROUNDABOUT = roundabout(front_x=5.2, width=2.55)


def on_circle(radius: float, tick: int = 0) -> OffTracking:
    """A trailer that follows perfectly: hitch and follow point on the circle, whose chord is its axis."""
    angles = np.linspace(0.0, 2.2 * math.asin(7.0 / radius), 150)
    tangent = math.asin(7.0 / radius)
    along = -radius * (np.sin(angles - tangent) + math.sin(tangent))
    across = radius * (math.cos(tangent) - np.cos(angles - tangent))
    return OffTracking(
        tick=tick,
        value=0.0,
        std=0.01,
        health=Health.OK,
        path=np.column_stack([along, across]),
        hitch_direction=tangent,
        hitch_direction_rate=0.0,
        path_tangent=-tangent,
        v_x=2.8 * math.cos(tangent),
        v_y=2.8 * math.sin(tangent),
        yaw_rate=2.8 / radius,
    )


def signals(tick: int) -> CombinationSignals:
    """Not looked at."""
    return CombinationSignals(
        tick=tick,
        angles=np.zeros(3),
        speed=2.8,
        steer=0.0,
        articulation=np.zeros(1),
        yaw_rates=np.zeros(2),
        lateral_acceleration=0.0,
    )


def test_a_steady_turn_needs_no_error() -> None:
    """The proportion is chosen so: on a wide circle the angles are those of perfect following, -(x - Lf/2)/R."""
    law = VirtualDriver(TRAILER, derivative=0.0, integral=0.0)
    memory = law.init()
    for tick in range(0, 3000, 20):
        memory, command = law.step(memory, tick, on_circle(200.0, tick), signals(tick))
    exact = -np.arctan((np.array(TRAILER.axle_distances) - 7.0) / math.sqrt(200.0**2 - 49.0))
    # The group's moment is exact to (Lf/R)^2; single axles share a centre.
    np.testing.assert_allclose(command.angles, exact, atol=2e-4)


@pytest.mark.parametrize("lag", [0.15, 0.4])
@pytest.mark.parametrize("speed", [2.8, 8.0, 16.0, 28.0])
def test_the_crossover_leaves_the_same_phase_at_every_speed(speed: float, lag: float) -> None:
    """A step of the previewed error: angle per error times (L_f - p) v/x_c is the crossover of a rolling trailer.

    Times the delays of 0.1 s and half of 0.1 s, the actuators' lag, and the tyres' it stays below 0.7 rad; at walking
    pace it is that of a steady turn without error.
    """
    trailer = replace(TRAILER, actuator_lag=lag)
    law = VirtualDriver(trailer, derivative=0.0, integral=0.0)
    memory, angles = law.init(), np.zeros(3)
    offset = 0.05
    path = np.column_stack([-np.linspace(0.0, 20.0, 81), np.full(81, offset)])
    for tick in range(0, 3000, 20):
        seen = replace(on_circle(200.0, 100 * (tick // 100)), path=path, hitch_direction=0.0, v_x=speed, v_y=0.0)
        memory, command = law.step(memory, tick + 100, seen, signals(tick))
        angles = command.angles
    distances = np.array(trailer.axle_distances)
    x_c = float(distances @ distances) / float(distances.sum())
    single = math.atan(float(distances @ np.tan(angles)) / float(distances.sum()))  # of an axle at x_c
    crossover = single / offset * 12.5 * speed / x_c
    steady = 2.0 * (x_c - 7.0) / (1.5 * 12.5) * 12.5 * speed / x_c
    lags = 0.15 + lag + 0.5 / speed + 0.022 * speed
    assert crossover == pytest.approx(min(steady, 0.7 / lags), rel=0.02)  # the estimate's age moves the preview


def test_round_the_roundabout_it_keeps_within_three_decimetres(drive: Any) -> None:
    """10 km/h, no slip, estimates 0.1 s late: an unsteered trailer is 5 m off, path preview 0.02 m."""
    run = drive(ROUNDABOUT, TRAILER, VirtualDriver(TRAILER))
    assert run.rms < 0.13
    assert run.worst < 0.3


def test_the_integral_takes_away_what_slip_leaves(drive: Any) -> None:
    """1 deg of slip on a straight road: what proportion alone leaves the integral takes away."""
    course = straight(front_x=5.2, length=120.0)
    tilted: Any = {"slip": lambda lateral_acceleration: -0.0175}
    with_integral = drive(course, TRAILER, VirtualDriver(TRAILER), **tilted)
    without = drive(course, TRAILER, VirtualDriver(TRAILER, integral=0.0), **tilted)
    assert abs(without.off_tracking[-1]) > 0.02
    assert abs(with_integral.off_tracking[-1]) < 0.005


def test_left_and_right_are_steered_alike(drive: Any) -> None:
    """Mirror symmetry of the whole loop."""
    law = VirtualDriver(TRAILER)
    left = drive(ROUNDABOUT, TRAILER, law, until=20.0)
    right = drive(roundabout(front_x=5.2, width=2.55, direction="right"), TRAILER, law, until=20.0)
    np.testing.assert_allclose(right.steer, -left.steer, atol=1e-6)  # roundings, as the loop forgets them


def test_a_lost_estimate_changes_nothing() -> None:
    """The law continues with the last usable one."""
    law = VirtualDriver(TRAILER)
    memory, _ = law.step(law.init(), 0, on_circle(20.0), signals(0))
    lost = replace(on_circle(-20.0, 20), health=Health.LOST, std=math.inf)
    _, seen = law.step(memory, 40, lost, signals(40))
    _, unseen = law.step(memory, 40, on_circle(20.0), signals(40))
    np.testing.assert_array_equal(seen.angles, unseen.angles)


@pytest.mark.parametrize(("name", "value"), [("preview", 0.0), ("gain", -1.0), ("integral", 1.0), ("derivative", 9.0)])
def test_a_parameter_outside_its_limits_is_refused(name: str, value: float) -> None:
    """By name, value and limits."""
    with pytest.raises(ValueError, match=rf"{name} = {value} .*must be between"):
        VirtualDriver(TRAILER, **{name: value})
