"""A rover with six wheels: its loads, its symmetry, and that four wheels behave as they did when they were the rule."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vehicle.rovers import GRAVITY, HOME, driven, plant_on, slope_towards
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

SIX, FOUR = load_rover("six_wheel_rover"), load_rover("el_dorado_ii")
OMEGA = 0.08 / SIX.radius  # of 8 cm/s [rad/s]
STRAIGHT = (0.0,) * 6
FORWARD = RoverCommand((OMEGA,) * 6, STRAIGHT)


@pytest.mark.parametrize("rover", [SIX, FOUR], ids=lambda rover: rover.name)
@pytest.mark.parametrize("direction", [0.0, 0.7, 2.0, math.pi])
def test_loads_hold_the_weight_and_its_moments_on_a_slope(rover: Rover, direction: float) -> None:
    """At rest on 8 degrees the loads sum to m g cos(8 deg), and their moments to the weight's along the slope times h.

    Along and across the body: sum N x = -m g sin(8 deg) cos(d) h, sum N y = -m g sin(8 deg) sin(d) h.
    """
    steepness, still = math.radians(8.0), (0.0,) * len(rover.wheels)
    slope_x, slope_y = slope_towards(direction, steepness)
    plant = plant_on(None, Terrain(slope_x=slope_x, slope_y=slope_y), rover)
    truth = driven(plant, RoverCommand(still, still), 5.0)
    weight, pull = rover.mass * GRAVITY, rover.mass * GRAVITY * math.sin(steepness) * rover.cg_height
    e_x, e_y = truth.X_WB[2, :2] / math.sin(steepness)  # shares of the slope along and across the body
    assert truth.loads.sum() == pytest.approx(weight * math.cos(steepness), rel=1e-9)
    assert truth.loads @ rover.wheel_places == pytest.approx(-pull * np.array([e_x, e_y]), abs=1e-4 * weight)


@pytest.mark.slow
@pytest.mark.parametrize("rover", [SIX, FOUR], ids=lambda rover: rover.name)
def test_left_and_right_are_alike(rover: Rover) -> None:
    """Slope, steering and wheel speeds mirrored: every lateral quantity flips, but for rounding in 10 s of slipping."""
    n = len(rover.wheels)
    other_side = [k + 1 - 2 * (k % 2) for k in range(n)]  # wheels by their mirrored ones
    speeds, steer = (0.9, 1.0, 0.8, 1.1, 0.9, 1.0)[:n], (0.2, 0.15, 0.05, 0.0, -0.1, -0.12)[:n]
    command = RoverCommand(tuple(OMEGA * speed for speed in speeds), steer)
    mirrored = RoverCommand(tuple(OMEGA * speeds[k] for k in other_side), tuple(-steer[k] for k in other_side))
    one = driven(plant_on("toyoura_sand", Terrain(slope_x=0.03, slope_y=0.05), rover), command, 10.0)
    other = driven(plant_on("toyoura_sand", Terrain(slope_x=0.03, slope_y=-0.05), rover), mirrored, 10.0)
    assert other.pose == pytest.approx(one.pose * [1.0, -1.0, -1.0], abs=1e-10)
    assert other.velocity == pytest.approx(one.velocity * [1.0, -1.0, -1.0], abs=1e-10)
    assert other.sinkages == pytest.approx(one.sinkages[other_side], abs=1e-10)
    assert other.loads == pytest.approx(one.loads[other_side], abs=1e-8)


@given(st.floats(10.0, 1e3), st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
def test_wheels_of_equal_stiffness_share_linearly(normal: float, pitch: float, roll: float) -> None:
    """Loads grow with the distance from the middle, which is the least energy; a wheel that would pull is lifted."""
    p = SIX.wheel_places
    forward, leftward = pitch / (p[:, 0] @ p[:, 0]), roll / (p[:, 1] @ p[:, 1])
    linear = normal / 6.0 + forward * p[:, 0] + leftward * p[:, 1]
    assert SIX.footprint.loads(normal, pitch, roll) == pytest.approx(np.maximum(linear, 0.0), rel=1e-9, abs=1e-9)


def test_it_turns_about_the_place_that_its_wheels_point_at() -> None:
    """Each wheel square to its ray from (0, 1.5) m: on firm ground R turns about that place, without side slip."""
    centre = np.array([0.0, 1.5])
    rays = centre - SIX.wheel_places
    steer = np.arctan2(-rays[:, 0], rays[:, 1])
    speeds = 0.1 / 1.5 * np.linalg.norm(rays, axis=1) / SIX.radius
    truth = driven(plant_on(None, rover=SIX), RoverCommand(tuple(speeds.tolist()), tuple(steer.tolist())), 20.0)
    assert truth.velocity[2] == pytest.approx(0.1 / 1.5, rel=0.02)  # rolling resistance costs slip
    assert np.linalg.norm(truth.pose[:2] - centre) == pytest.approx(1.5, abs=0.03)  # the start steers in
    assert truth.slip_angles == pytest.approx(np.zeros(6), abs=0.01)


def test_without_steering_it_turns_by_its_effective_track() -> None:
    """On firm ground at a gentle turn the yaw rate is the difference of the sides' speeds over the effective track."""
    skid = SIX.model_copy(update={"wheels": tuple(wheel.model_copy(update={"steered": False}) for wheel in SIX.wheels)})
    left, right = 0.098 / SIX.radius, 0.102 / SIX.radius
    truth = driven(plant_on(None, rover=skid), RoverCommand((left, right) * 3, STRAIGHT), 20.0)
    assert truth.velocity[2] == pytest.approx((right - left) * SIX.radius / skid.effective_track, rel=0.02)
    with pytest.raises(ValueError, match="six_wheel_rover steers no wheel"):
        plant_on(None, rover=skid).step(np.zeros(42), RoverCommand(STRAIGHT, (0.1,) * 6), 10)


def test_wheels_without_drive_roll_along() -> None:
    """Only the middle wheels drive: the others follow at the speed of the ground, with less slip than the driven."""
    wheels = tuple(w.model_copy(update={"driven": w.name.startswith("middle")}) for w in SIX.wheels)
    plant = plant_on(None, rover=SIX.model_copy(update={"wheels": wheels}))
    truth = driven(plant, FORWARD, 10.0)
    assert truth.velocity[0] == pytest.approx(0.08, rel=0.05)
    assert np.all(truth.slip_ratios[2:4] > 0.0)
    assert np.all(truth.slip_ratios[[0, 1, 4, 5]] < 0.0)  # rolling resistance brakes them
    assert truth.wheel_speeds * SIX.radius == pytest.approx(np.full(6, truth.velocity[0]), rel=0.05)


def test_some_wheels_may_be_steered_and_others_not() -> None:
    """The middle wheels lie on the line through the centre of the turn and need no steering."""
    wheels = tuple(w.model_copy(update={"steered": not w.name.startswith("middle")}) for w in SIX.wheels)
    plant = plant_on(None, rover=SIX.model_copy(update={"wheels": wheels}))
    truth = driven(plant, RoverCommand((OMEGA,) * 6, (0.2, 0.2, 0.0, 0.0, -0.2, -0.2)), 10.0)
    assert truth.velocity[2] > 0.01
    assert truth.steer == pytest.approx([0.2, 0.2, 0.0, 0.0, -0.2, -0.2], abs=1e-6)
    with pytest.raises(ValueError, match="six_wheel_rover steers not all wheels"):
        plant.step(plant.initial_state(HOME), RoverCommand(STRAIGHT, (0.1,) * 6), 10)


@pytest.mark.slow
def test_the_order_of_the_wheels_does_not_matter() -> None:
    order = [3, 0, 2, 1]
    shuffled = FOUR.model_copy(update={"wheels": tuple(FOUR.wheels[k] for k in order)})
    speeds, steer = np.array([0.7, 0.8, 0.75, 0.85]), np.array([0.1, 0.12, -0.1, -0.05])
    terrain = Terrain(slope_x=0.03, slope_y=0.05)

    def after(rover: Rover, at: list[int]) -> RoverTruth:
        command = RoverCommand(tuple(speeds[at].tolist()), tuple(steer[at].tolist()))
        return driven(plant_on("toyoura_sand", terrain, rover), command, 5.0)

    one, other = after(FOUR, [0, 1, 2, 3]), after(shuffled, order)
    assert other.pose == pytest.approx(one.pose, abs=1e-10)
    np.testing.assert_allclose(other.X_WB, one.X_WB, atol=1e-10)
    assert other.loads == pytest.approx(one.loads[order], abs=1e-8)
