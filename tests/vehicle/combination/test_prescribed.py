"""Prescribed motion at a slip angle; its off-tracking is that of a run, see the tests of the loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vehicle.combination.description import Vehicle
from vehicle.combination.plant import ConstantSlipPlant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.surface import Surface

ROAD = Surface(friction=0.8)
IDLE = VehicleCommand(0.3, 1.0, (0.1, 0.1))


def test_velocity_is_at_the_slip_angle_and_matches_the_poses(longer_semitrailer: Vehicle) -> None:
    """beta = atan2(v_y, v_x) of the trailer; poses advance with it in a straight line."""
    plant = ConstantSlipPlant(longer_semitrailer, ROAD, unit=1, slip_angle=0.2, speed=5.0)
    state = plant.initial_state(Pose2(1.0, 2.0, 0.5), 5.0)
    now, then = plant.observe(state, 0), plant.observe(plant.step(state, IDLE, 100), 100)
    assert math.atan2(now.velocities[1, 1], now.velocities[1, 0]) == pytest.approx(0.2)
    np.testing.assert_allclose(
        then.poses - now.poses, [[0.5 * math.cos(0.5), 0.5 * math.sin(0.5), 0.0]] * 2, atol=1e-12
    )
    assert then.poses[1, 2] == pytest.approx(0.5 - 0.2)
    np.testing.assert_allclose(then.bodies[1][:2, 3], then.poses[1, :2])


@pytest.mark.parametrize(
    "wrong", [{"unit": 0}, {"unit": 2}, {"slip_angle": 1.5}, {"slip_angle": math.nan}, {"speed": 0.0}]
)
def test_impossible_drags_are_refused_by_name(longer_semitrailer: Vehicle, wrong: dict[str, float]) -> None:
    arguments = {"unit": 1, "slip_angle": 0.2, "speed": 5.0} | wrong
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} = "):
        ConstantSlipPlant(longer_semitrailer, ROAD, **arguments)  # type: ignore[arg-type]  # any argument, by name


def test_another_speed_than_the_constant_one_is_refused(longer_semitrailer: Vehicle) -> None:
    plant = ConstantSlipPlant(longer_semitrailer, ROAD, unit=1, slip_angle=0.2, speed=5.0)
    with pytest.raises(ValueError, match=r"speed = 4\.0 m/s"):
        plant.initial_state(Pose2(0.0, 0.0, 0.0), 4.0)
