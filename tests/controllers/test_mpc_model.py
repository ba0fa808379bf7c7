"""The predictive controller's model of the trailer: against the plant, closed forms and differences."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from controllers.trailer import Combination
from controllers.trailer_steering.mpc.trailer_model import (
    STEP,
    TYRE_STEP,
    Inputs,
    State,
    Stepper,
    TrailerModel,
    rate,
    rolled_on,
    state_sizes,
)
from scenarios.assembly.adapters import trailer_geometry
from vehicle.clock import TICK
from vehicle.combination.description import load_vehicle
from vehicle.combination.layout import parts
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

VEHICLE = load_vehicle("uk_longer_semitrailer")
MODEL = TrailerModel.of(trailer_geometry(VEHICLE, 1), Combination(VEHICLE, 1))
SPEED = 10.0 / 3.6


def given(**known: float) -> FloatArray:
    """Inputs of a prediction: zero but for those given, at 10 km/h on a dry road."""
    told = {"rate": 0.0, "speed": SPEED, "course_rate": 0.0, "pull": 0.0, "disturbance": 0.0, "friction": 0.8} | known
    rates = [told.pop("rate")] * MODEL.n_actuators
    return np.array([*rates, *told.values()])


@pytest.mark.parametrize("friction", [0.8, 0.2])
@pytest.mark.parametrize(("speed", "angle"), [(SPEED, 0.15), (20.0, 0.03)])
def test_the_prediction_turns_as_the_plant_does(speed: float, angle: float, friction: float) -> None:
    """Steered trailer axles on a straight road for 1.2 s, told how the plant's hitch travels: yaw within a tenth.

    Left out are roll, load transfer and the tractor, which takes some of the moment at speed.
    """
    plant = Plant(VEHICLE, Surface(friction=friction))
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed)
    command = VehicleCommand(0.0, 0.0, (angle, angle))
    predicted = np.zeros(sum(state_sizes(MODEL)))
    predicted[-2:] = angle
    step, ticks = Stepper(MODEL), round(STEP / TICK)
    course = 0.0
    for k in range(24):
        truth = plant.observe(state, k)
        state = plant.step(state, command, ticks)
        after = plant.observe(state, k)
        before, course = course, after.poses[1, 2] + math.atan2(after.velocities[1, 1], after.velocities[1, 0])
        hitch_speed = math.hypot(*truth.velocities[1, :2])
        predicted = step(
            predicted, given(speed=hitch_speed, course_rate=(course - before) / STEP, friction=friction)
        ).state
    turned, yaw_rate = after.poses[1, 2], after.velocities[1, 2]
    assert abs(turned) > 0.01
    assert course - predicted[0] == pytest.approx(turned, rel=0.1)
    assert predicted[1] == pytest.approx(yaw_rate, abs=0.1 * abs(turned) / STEP / 24 + 0.1 * abs(yaw_rate))


def test_in_a_steady_circle_the_axles_that_point_right_roll_without_slip() -> None:
    """No slip, no side force, no pull: an equilibrium where the follow point runs on the hitch's circle.

    Small angles of slip are left, for the fixed axle scrubs: so all three are taken as steered by the closed form.
    """
    radius, follow = 12.0, 14.0
    lead = math.asin(0.5 * follow / radius)
    yaw_rate = SPEED / radius
    angles = [math.atan2(SPEED * math.sin(lead) - axle.x * yaw_rate, SPEED * math.cos(lead)) for axle in MODEL.axles]
    every = TrailerModel(
        axles=tuple(type(axle)(axle.x, axle.load, axle.tyre, k, 1.0) for k, axle in enumerate(MODEL.axles)),
        mass_moment=0.0,  # and no inertia in the hitch's turn
        inertia=MODEL.inertia,
        n_actuators=3,
        actuator_lag=0.15,
    )
    x = ca.SX(np.array([lead, yaw_rate, 0.0, 0.0, 0.0, *angles, *angles]))
    u = ca.SX(np.array([0.0, 0.0, 0.0, SPEED, yaw_rate, 0.0, 0.0, 0.8]))
    rates = rate(every, State(*parts(x, state_sizes(every))), Inputs(u[:3], *ca.vertsplit(u[3:])))
    assert np.abs(np.array(ca.DM(ca.vertcat(*rates)))).max() < 1e-5  # of a push that is never quite zero


def test_a_push_to_the_left_at_the_rear_turns_the_trailer_right() -> None:
    """The sign of everything: axles steered left push the rear left, the trailer yaws to the right."""
    state = np.zeros(sum(state_sizes(MODEL)))
    state[-4:] = 0.05
    step = Stepper(MODEL)
    for _ in range(10):
        state = step(state, given()).state
    assert state[1] < 0.0
    assert state[0] > 0.0  # and its hitch then travels to the left of its axis


def test_derivatives_are_those_of_differences() -> None:
    """Gauss-Newton rests on them; central differences of 1e-6 are right to 1e-6 of these sizes."""
    rng = np.random.default_rng(1)
    n = sum(state_sizes(MODEL))
    state, told = rng.normal(scale=0.05, size=n), given(course_rate=0.2, pull=0.3, friction=0.3, rate=0.1)
    step = Stepper(MODEL)
    at = step(state, told)
    for k in range(n):
        ahead, back = (step(state + side * 1e-6 * np.eye(n)[k], told) for side in (1.0, -1.0))
        np.testing.assert_allclose(at.by_state[:, k], (ahead.state - back.state) / 2e-6, atol=1e-5)
        np.testing.assert_allclose(at.slip_by_state[:, k], (ahead.slip - back.slip) / 2e-6, atol=1e-5)
    ahead, back = (step(state, told + side * 1e-6 * np.eye(len(told))[0]) for side in (1.0, -1.0))
    np.testing.assert_allclose(at.by_rate[:, 0], (ahead.state - back.state) / 2e-6, atol=1e-5)


def test_small_slip_makes_its_stiffness_of_force_and_large_slip_friction() -> None:
    """All axles at one slip: the moment over the load moment is the force over the load."""
    steer = np.zeros(2)
    for slip, friction, force in ((0.001, 0.8, 0.001 * MODEL.stiffness), (0.25, 0.2, 0.2)):
        deflection = np.zeros(3)
        for _ in range(100):  # 2 s, 11 relaxation lengths
            tyres = rolled_on(
                MODEL, deflection, steer, hitch_direction=slip, yaw_rate=0.0, speed=SPEED, friction=friction
            )
            deflection = tyres.deflection
        assert -tyres.moment == pytest.approx(force, rel=0.05)  # pneumatic trail, and the curve past its peak
    assert -tyres.by_friction == pytest.approx(0.2, rel=0.1)  # sliding tyres go with the friction
    assert TYRE_STEP * 100 > 1.0
