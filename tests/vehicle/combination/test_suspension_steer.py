"""Roll steer and bump steer: axles that their suspensions turn as the body moves."""

from __future__ import annotations

import numpy as np
import pytest

from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.handling import understeer_gradient
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.sprung import settled
from vehicle.combination.variants import changed_vehicle
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Roughness, RoughProfile, Surface

SPEED = 20.0  # [m/s]


def truck(axle: int = 1, /, **numbers: float) -> Vehicle:
    return changed_vehicle(load_vehicle("rigid_truck"), {f"units.0.axles.{axle}.{k}": v for k, v in numbers.items()})


def roll_gradient(vehicle: Vehicle) -> float:
    """Steady roll of the body per lateral acceleration [rad/(m/s2)]."""
    ((attitude, _),) = settled(vehicle, [0.0], [1.0])
    return float(attitude.roll)


@pytest.mark.parametrize(("axle", "sign"), [(1, 1.0), (0, -1.0)])
def test_roll_steer_adds_to_the_understeer_gradient(axle: int, sign: float) -> None:
    """delta = L / R + K a_y + rear angle - front's own: the gradient grows by roll steer times the roll gradient.

    Understeer if the rear axle turns into the turn, oversteer if the front axle does.
    """
    plain, steering = truck(), truck(axle, roll_steer=0.1)
    added = understeer_gradient(steering, SPEED) - understeer_gradient(plain, SPEED)
    assert added == pytest.approx(sign * 0.1 * roll_gradient(plain), rel=0.02)  # the front wheels are no single one


def test_bump_steer_in_roll_is_roll_steer_by_half_the_track() -> None:
    """In roll the left wheel goes down as much as the right one up: both turn to the same side."""
    track = load_vehicle("rigid_truck").units[0].axles[1].track
    bump, roll = truck(bump_steer=0.1), truck(roll_steer=0.1 * 0.5 * track)
    assert understeer_gradient(bump, SPEED) == pytest.approx(understeer_gradient(roll, SPEED), rel=1e-6)


def driven(vehicle: Vehicle, side: float, surface: Surface) -> FloatArray:
    """x, y, psi of the truck after 3 s of steer to one side."""
    plant = Plant(vehicle, surface)
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), SPEED)
    pose: FloatArray = plant.observe(plant.step(state, VehicleCommand(side * 0.02, 0.0, ()), 3000), 3000).poses[0]
    return pose


def test_both_pass_the_mirror_test() -> None:
    """Left and right change places, so do the signs of all angles; bump steer turns the wheels of an axle apart."""
    vehicle = truck(roll_steer=0.15, bump_steer=0.2)
    left, right = (driven(vehicle, side, Surface(friction=0.8)) for side in (1.0, -1.0))
    np.testing.assert_allclose(right, left * (1.0, -1.0, -1.0), rtol=1e-9, atol=1e-9)
    assert abs(left[1] - driven(truck(), 1.0, Surface(friction=0.8))[1]) > 0.05  # [m], and they do something


def test_roll_steer_makes_a_truck_weave_on_a_rough_road() -> None:
    """The road rolls axles under the body: an axle that this steers yaws the truck, by half as much again."""
    yawing = []
    for vehicle in (truck(), truck(roll_steer=0.3)):
        road = Roughness(profile=RoughProfile(np.random.default_rng(1), "B"))
        plant = Plant(vehicle, Surface(friction=0.8, roughness=road))
        state = plant.initial_state(Pose2(0.0, 0.0, 0.0), SPEED)
        rates = []
        for k in range(400):
            rates.append(plant.observe(state, 20 * k).velocities[0, 2])
            state = plant.step(state, VehicleCommand(0.0, 0.0, ()), 20)
        yawing.append(float(np.std(rates[100:])))
    assert yawing[1] > 1.3 * yawing[0]
