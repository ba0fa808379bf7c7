"""Steering actuators before a plant FMU that takes the angles of its road wheels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offtrack.exchange.fmi_import.fmu_plant import SteeringActuators
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.surface import Surface

STEP = 10  # of the loop [ms]


def command_of(vehicle: Vehicle, steer: float) -> VehicleCommand:
    """Demands of all axles that differ, as a law gives them that knows nothing of groups."""
    n_trailer = vehicle.n_by_law
    return VehicleCommand(steer, 0.0, tuple(0.5 * steer * (k - 1) for k in range(n_trailer)))


@pytest.mark.parametrize("name", ["uk_longer_semitrailer", "uk_longer_semitrailer_grouped", "rigid_truck_8x4"])
def test_axles_move_as_those_of_the_plant_here(name: str) -> None:
    """Through lag and limits of rate and angle, by an independent path: the plant integrates, this is a closed form."""
    vehicle = load_vehicle(name)
    plant, actuators = Plant(vehicle, Surface(friction=0.8)), SteeringActuators(vehicle, given=())
    state, angles = plant.initial_state(Pose2(0.0, 0.0, 0.0), 2.0), actuators.straight()
    for k in range(300):
        command = command_of(vehicle, math.radians(50.0 if k < 180 else -3.0))
        state = plant.step(state, command, STEP)
        angles = actuators.turned(angles, command, 1e-3 * STEP)
        np.testing.assert_allclose(angles, plant.observe(state, 0).steer, atol=2e-4)  # of the plant's ticks of 1 ms
    assert np.ptp(angles) > 0.01


def test_an_axle_whose_angle_the_fmu_gives_gets_the_demand() -> None:
    """Its actuator is inside the FMU, and must not lag twice."""
    vehicle = load_vehicle("uk_longer_semitrailer")
    actuators = SteeringActuators(vehicle, given={"steer_angle_1", "steer_angle_3"})
    command = VehicleCommand(0.2, 0.0, (0.1, -0.1))
    angles = actuators.turned(actuators.straight(), command, 0.05)
    assert actuators.command(command, angles).steer == 0.2
    assert angles[2] == -0.1
    assert angles[1] == pytest.approx(math.radians(20.0) * 0.05)  # at its limit of rate: 0.1 rad are far
