"""Prescribed motion has its closed form; at low speed the dynamic model becomes the kinematic one."""

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


def off_tracking(plant: ConstantSlipPlant, X_WT: Pose2, follow_x: float) -> float:
    """Position of the hitch path on the trailer's lateral axis at the follow point, from observed poses [m]."""
    state, path = plant.initial_state(X_WT, 5.0), []
    for tick in range(0, 6000, 20):
        path.append(plant.observe(state, tick).poses[1])
        state = plant.step(state, IDLE, 20)
    x, y = Pose2(*path[-1]).inverse().apply(np.array(path)[:, :2]).T
    return float(np.interp(follow_x, x, y))


@pytest.mark.parametrize("slip_deg", [0.0, 2.0, 14.0, 16.0, -14.0])
@pytest.mark.parametrize("X_WT", [Pose2(0.0, 0.0, 0.0), Pose2(5.0, -3.0, 2.0)])
def test_off_tracking_is_follow_distance_times_tangent(
    longer_semitrailer: Vehicle, slip_deg: float, X_WT: Pose2
) -> None:
    """De Saxe & Cebon 2018, section 3.1: 14 m, 14 deg: 3.490592 m. Going left of its nose, the path lies right."""
    plant = ConstantSlipPlant(longer_semitrailer, ROAD, unit=1, slip_angle=math.radians(slip_deg), speed=5.0)
    e = off_tracking(plant, X_WT, -14.0)
    assert e == pytest.approx(-14.0 * math.tan(math.radians(slip_deg)), abs=1e-9)
    if slip_deg == 14.0:
        assert abs(e) == pytest.approx(3.490592, abs=5e-7)


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
    """A tractor is not dragged, and nothing slides at 86 deg."""
    arguments = {"unit": 1, "slip_angle": 0.2, "speed": 5.0} | wrong
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} = "):
        ConstantSlipPlant(longer_semitrailer, ROAD, **arguments)  # type: ignore[arg-type]  # any argument, by name


def test_another_speed_than_the_constant_one_is_refused(longer_semitrailer: Vehicle) -> None:
    """The speed is stated twice, and must be the same."""
    plant = ConstantSlipPlant(longer_semitrailer, ROAD, unit=1, slip_angle=0.2, speed=5.0)
    with pytest.raises(ValueError, match=r"speed = 4\.0 m/s"):
        plant.initial_state(Pose2(0.0, 0.0, 0.0), 4.0)
