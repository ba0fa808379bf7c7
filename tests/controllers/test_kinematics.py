"""Kinematics of a trailer led at its hitch, its prediction, the tractor's motion, and the model of an actuator."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from controllers.equations import settle
from controllers.trailer import Actuation, Combination, Linkage, no_axle_answers
from controllers.trailer_steering import kinematics
from estimators.estimates import OffTracking
from estimators.hitch_motion import HitchMotion
from tests.trailers import ALL_STEERED as TRAILER
from tests.trailers import COMBINATION, TWO_OF_THREE, estimate, signals
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

# Axle angles, slip and yaw


ALL_STEERED = kinematics.AxleGroup.of(TRAILER)
TWO_STEERED = kinematics.AxleGroup.of(replace(TRAILER, steered=(False, True, True)))
directions = st.floats(-0.8, 0.8)
slips = st.floats(-0.05, 0.05)


@given(directions, directions)
def test_all_axle_lines_meet_in_one_centre(lead: float, follow: float) -> None:
    """No scrub: the normals of all wheels pass through the point where those of hitch and follow point meet."""
    assume(abs(lead - follow) > 1e-2)
    unlimited = replace(TRAILER, max_steer=1.5)
    angles = kinematics.AxleGroup.of(unlimited).steer_angles(lead, follow, 0.0)
    # A centre at (-c, d) has tan(direction) = (c - x)/d at the distance x behind the hitch.
    d = 14.0 / (math.tan(lead) - math.tan(follow))
    c = d * math.tan(lead)
    assert d * np.tan(angles) == pytest.approx(c - ALL_STEERED.steered, abs=1e-9)


@given(directions, slips, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.5, 10.0))
def test_yaw_follows_from_slip_as_slip_does_from_yaw(lead: float, slip: float, a: float, b: float, v: float) -> None:
    angles = np.array([a, b])
    yaw_rate = v * TWO_STEERED.yaw_per_metre(lead, float(TWO_STEERED.steer_moment(angles)), slip)
    measured = TWO_STEERED.mean_slip(v * math.cos(lead), v * math.sin(lead), yaw_rate, angles)
    assert measured == pytest.approx(slip, abs=1e-12)


@pytest.mark.parametrize("axles", [ALL_STEERED, TWO_STEERED], ids=["three", "two"])
@given(lead=st.floats(-0.3, 0.3), follow=st.floats(-0.3, 0.3), slip=slips)
def test_steer_angles_send_the_follow_point_where_it_is_wanted(
    axles: kinematics.AxleGroup, lead: float, follow: float, slip: float
) -> None:
    """Put into the moment balance, slip and fixed axle included, they give the yaw that turns lead into follow."""
    angles = axles.steer_angles(lead, follow, slip)
    assume(np.abs(angles).max() < TRAILER.max_steer - 1e-9)
    yaw_per_metre = axles.yaw_per_metre(lead, float(axles.steer_moment(angles)), slip)
    follow_tangent = math.tan(lead) - 14.0 * yaw_per_metre / math.cos(lead)
    assert follow_tangent == pytest.approx(math.tan(follow), abs=1e-12)


def test_what_an_axle_at_its_limit_lacks_the_others_give() -> None:
    """Coming out of a tight turn with one axle fixed, the last axle would need more than 30 deg; the moment stays."""
    lead, follow = 0.1, -0.57
    angles = TWO_STEERED.steer_angles(lead, follow, 0.0)
    unlimited = kinematics.AxleGroup.of(replace(TRAILER, steered=(False, True, True), max_steer=1.5))
    asked = unlimited.steer_angles(lead, follow, 0.0)
    assert abs(asked[1]) > TRAILER.max_steer > abs(asked[0])
    assert angles[1] == pytest.approx(-TRAILER.max_steer)
    assert abs(angles[0]) > abs(asked[0])
    assert TWO_STEERED.steer_moment(angles) == pytest.approx(unlimited.steer_moment(asked), abs=1e-12)


LINKED = replace(TRAILER, steered=(False, True, True), linkages=(Linkage((0, 1), (0.638, 1.0)),))


def test_groups_and_ratios_say_which_axles_turn_together() -> None:
    """Axles in no linkage have an actuator of their own, with an angle that is theirs."""
    three = replace(TRAILER, linkages=(Linkage((1, 2), (0.5, 1.0)),))
    assert (three.groups, three.steer_ratios) == (((0,), (1, 2)), (1.0, 0.5, 1.0))
    assert (TRAILER.groups, TRAILER.steer_ratios) == (((0,), (1,), (2,)), (1.0, 1.0, 1.0))


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), slips)
def test_linked_axles_turn_in_their_ratio_with_the_moment_asked_for(lead: float, follow: float, slip: float) -> None:
    """One actuator has one angle; at it the trailer turns as it would with an angle for each axle."""
    asked = TWO_STEERED.steer_angles(lead, follow, slip)
    angles = kinematics.AxleGroup.of(LINKED).steer_angles(lead, follow, slip)
    assert angles[0] == pytest.approx(0.638 * angles[1], abs=1e-15)
    assert abs(angles[1]) <= LINKED.max_steer
    assume(abs(angles[1]) < LINKED.max_steer - 1e-9)
    assert TWO_STEERED.steer_moment(angles) == pytest.approx(TWO_STEERED.steer_moment(asked), abs=1e-9)


# Prediction from an old estimate to the moment when the steering has answered


TWO_OF_THREE_AXLES = kinematics.AxleGroup.of(TWO_OF_THREE)
PREDICTOR = kinematics.Predictor(TWO_OF_THREE, TWO_OF_THREE_AXLES)


def seen(*, direction: float, direction_rate: float, speed: float, yaw_rate: float) -> OffTracking:
    return estimate(
        1000,
        hitch_direction=direction,
        hitch_direction_rate=direction_rate,
        v_x=speed * math.cos(direction),
        v_y=speed * math.sin(direction),
        yaw_rate=yaw_rate,
    )


def history(read: FloatArray) -> kinematics.SteerHistory:
    """Readings (n, 2) every 20 ms from tick 1000 on."""
    past: kinematics.SteerHistory = ()
    for k, angles in enumerate(read):
        past = kinematics.recorded(past, signals(1000 + 20 * k, angles=angles), 3000)
    return past


def test_a_trailer_that_circles_steadily_goes_on_circling() -> None:
    """With angles that fit the circle the frame turns by r t about the centre and the hitch keeps its direction."""
    radius, speed, span = 10.0, 2.8, 0.4
    half = math.asin(7.0 / radius)
    angles = TWO_OF_THREE_AXLES.steer_angles(half, -half, -0.02)
    turned = speed / radius * span
    circling = seen(direction=half, direction_rate=0.0, speed=speed, yaw_rate=speed / radius)
    ahead = PREDICTOR.ahead(circling, -0.02, history(np.tile(angles, (11, 1))), angles, 1400, TRAILER.actuator_lag)
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
    ahead = PREDICTOR.ahead(start, 0.01, history(ramp), demand, 1400, TRAILER.actuator_lag)
    psi = 0.0
    for k in range(400):
        t = (k + 0.5) * 1e-3
        read = -0.07 * t / 0.2 * np.ones(2)
        coming = (
            settle([-0.07, -0.07], demand, t - 0.2, lag=TWO_OF_THREE.actuator_lag, max_rate=TWO_OF_THREE.max_steer_rate)
            if t > 0.2
            else read
        )
        moment = float(TWO_OF_THREE_AXLES.steer_moment(coming))
        psi += speed * 1e-3 * TWO_OF_THREE_AXLES.yaw_per_metre(direction + course_rate * t - psi, moment, 0.01)
    assert psi > 0.03  # there is something to predict: 0.4 m at the follow point
    assert ahead.frame.psi == pytest.approx(psi, abs=1e-4)  # 20 ms steps with piecewise linear angles
    assert ahead.hitch_direction == pytest.approx(direction + 0.4 * course_rate - psi, abs=1e-4)


def test_steer_readings_are_kept_in_order_and_only_as_long_as_needed() -> None:
    """A reading that comes again changes nothing; old ones go; between two the angle is interpolated."""
    past: kinematics.SteerHistory = ()
    for tick in range(0, 200, 20):
        past = kinematics.recorded(past, signals(tick, angles=np.array([tick * 1e-3, 0.0])), 100)
    assert kinematics.recorded(past, signals(180, angles=np.ones(2)), 100) == past
    assert [reading.tick for reading in past] == [80, 100, 120, 140, 160, 180]
    assert kinematics.angles_at(past, np.array([130.0, 0.0])) == pytest.approx(np.array([[0.13, 0.0], [0.08, 0.0]]))


# Motion of a tractor's rear axle


TRACTOR = COMBINATION.vehicle.units[0]


@pytest.mark.parametrize("steer", [0.0, 0.35, -0.6])
@pytest.mark.parametrize("slip", [0.0, -0.02])
@pytest.mark.parametrize("speed", [2.8, -1.0])
def test_the_speed_does_not_depend_on_how_the_front_wheels_slip(steer: float, slip: float, speed: float) -> None:
    """A wheel that is steered by more than the direction of its travel rolls slower: the yaw rate shows by how much."""
    for front_slip in (0.0, 0.05):
        travel = steer - math.copysign(front_slip, steer)
        yaw_rate = speed * (math.tan(travel) - slip) / TRACTOR.steered_axles[0].x
        rolling = speed * math.cos(steer) + speed * math.tan(travel) * math.sin(steer)
        read = signals(0, speed=rolling * math.cos(steer), steer=steer, yaw_rates=np.array([yaw_rate, 0.0]))
        assert kinematics.TractorMotion(COMBINATION).speed(read, slip) == pytest.approx(speed, abs=1e-12)


def test_a_steered_trailer_ahead_rolls_instead_of_scrubbing() -> None:
    """Seen from the second trailer the first one's angles are unknown: straight ones would push the tractor by 13 mrad.

    From the first trailer, whose angles are read, the slip is within 2 mrad of that.
    """
    vehicle = load_vehicle("b_double_steered")
    lead, second = vehicle.units[1:3]
    gammas, rates, speed = np.array([0.36, 0.05]), np.array([0.22, 0.22, 0.2]), 2.8
    v_y = rates[0] * vehicle.units[0].rear_hitch[0]
    c, s = math.cos(gammas[0]), math.sin(gammas[0])
    v_x, v_y = c * speed - s * v_y, s * speed + c * v_y
    rolling = np.array([math.atan((v_y + axle.x * rates[1]) / v_x) for axle in lead.axles if axle.steered])
    read = replace(signals(0), speed=speed, articulation=gammas, yaw_rates=rates)
    known = kinematics.TractorMotion(Combination(vehicle, 1)).slip(replace(read, angles=rolling))
    straight = kinematics.TractorMotion(Combination(vehicle, 1)).slip(replace(read, angles=np.zeros(len(rolling))))
    assumed = kinematics.TractorMotion(Combination(vehicle, 2)).slip(
        replace(read, angles=np.zeros(sum(axle.steered for axle in second.axles)))
    )
    assert abs(straight - known) > 0.005
    assert assumed == pytest.approx(known, abs=0.002)


# A steering actuator


angle = st.floats(-0.6, 0.6)
times = st.floats(0.0, 2.0)


@given(angle, angle, times)
def test_it_solves_the_lag_under_the_rate_limit(angle: float, demand: float, duration: float) -> None:
    """Against Euler steps of d(angle)/dt = clip((demand - angle)/lag); they err by max_rate dt / 2 = 0.4 mrad."""
    lag, max_rate, steps = 0.15, 0.35, 1000
    stepped = angle
    for _ in range(steps):
        stepped += duration / steps * np.clip((demand - stepped) / lag, -max_rate, max_rate)
    assert settle(angle, demand, duration, lag=lag, max_rate=max_rate) == pytest.approx(stepped, abs=1e-3)


@given(angle, angle, times, times)
def test_two_waits_are_one_long_wait(angle: float, demand: float, first: float, second: float) -> None:
    kind = {"lag": 0.15, "max_rate": 0.35}
    halfway = settle(angle, demand, first, **kind)
    assert settle(halfway, demand, second, **kind) == pytest.approx(
        settle(angle, demand, first + second, **kind), abs=1e-12
    )


def test_without_lag_the_rate_alone_limits() -> None:
    """One second at 0.2 rad/s, per axle; the second axle arrives and stops."""
    reached = settle([0.0, 0.4], [0.5, 0.3], 1.0, lag=0.0, max_rate=0.2)
    assert reached == pytest.approx([0.2, 0.3], abs=1e-15)


def test_the_mean_motion_between_two_ticks_is_that_of_the_steps_between() -> None:
    """Within a step it is interpolated; there is none beyond the last."""
    path, moves = kinematics.straight_behind(14.0), HitchMotion(3.0, 0.3, 0.1)
    for tick in range(0, 100, 20):
        path = kinematics.extended(path, tick, moves, 0.02)
    assert kinematics.motion_between(path, 10, 70) == pytest.approx(moves, rel=1e-3)
    assert kinematics.motion_between(path, 10, 90) is None


def test_axles_at_their_grip_answer_no_more() -> None:
    for at_grip, held in (([True, False], False), ([True, True], True)):
        known = Actuation(goal=np.zeros(2), able=np.ones(2, np.bool_), at_grip=np.array(at_grip))
        assert no_axle_answers(known) is held


@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize(("true", "measured"), [(0.15, 0.15), (0.17, 0.15), (0.05, 0.15), (0.5, 0.5), (0.8, 0.8)])
def test_the_lag_of_actuators_is_measured_where_they_are_slow(true: float, measured: float, noise: float) -> None:
    """Sine demands of 5 deg and 0.3 Hz, noise of the encoders in degrees; actuators that cannot move tell nothing.

    Quick ones follow so closely that nothing can be measured, and nothing is lost.
    """
    trailer, rng = replace(TRAILER, actuator_lag=0.15), np.random.default_rng(1)
    angles, goal = np.zeros(3), np.zeros(3)
    history: kinematics.SteerHistory = ()
    answers = stuck = kinematics.Answers()
    for tick in range(0, 20_000, 20):
        angles = angles + (goal - angles) * (1.0 - math.exp(-0.02 / true))
        history = kinematics.recorded(
            history, signals(tick, angles=angles + np.radians(noise) * rng.normal(size=3)), 100
        )
        answers = answers.with_reading(trailer, history, Actuation(goal=goal, able=np.ones(3, dtype=bool)))
        stuck = stuck.with_reading(trailer, history, Actuation(goal=goal, able=np.zeros(3, dtype=bool)))
        goal = np.full(3, math.radians(5.0) * math.sin(2.0 * math.pi * 0.3 * tick / 1000.0))
    assert answers.lag(trailer) == pytest.approx(measured, rel=0.15)
    assert stuck.lag(trailer) == 0.15
    at_limit = replace(trailer, max_steer_rate=1e-4)
    beyond = kinematics.Answers().with_reading(
        at_limit, history, Actuation(goal=goal + 1.0, able=np.ones(3, dtype=bool))
    )
    assert beyond.lag(at_limit) == 0.15
