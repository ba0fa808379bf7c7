"""The preview driver in closed loop with whole combinations: stable at any speed, and on the path."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.driver import PreviewDriver
from scenarios.assembly.tractor_data import tractor_guided_at
from scenarios.courses import lane_change
from scenarios.standards.motion import amplification, lateral_acceleration, point_path
from scenarios.standards.proving_ground import drive
from scenarios.standards.theory import linear_figures
from scenarios.validation.driver_checks import with_damping
from scenarios.validation.driver_loop import driver_modes
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.plant_changes import changed_vehicle
from vehicle.surface import Surface


def growth(vehicle: Vehicle, driven: Vehicle, kmh: float) -> float:
    return float(driver_modes(vehicle, driven, kmh / 3.6, vehicle.units[0].front_x).real.max())


@pytest.mark.parametrize("name", ["a_double", "rigid_truck_8x4", "desaxe_field_combination"])
@pytest.mark.parametrize("kmh", [1.0, 2.5, 10.0, 40.0, 90.0, 110.0])
def test_all_motion_decays_without_damping_of_the_tyres(name: str, kmh: float) -> None:
    """The slowest mode is the last trailer's or the path's; the loop makes none grow at any road speed."""
    vehicle = load_vehicle(name)
    assert growth(vehicle, with_damping(vehicle, 0.0), kmh) < 0.0


@pytest.mark.parametrize(("stiffness", "mass"), [(0.6, 1.0), (1.6, 1.0), (1.0, 1.15)])
def test_a_wrong_data_sheet_does_not_destabilise(stiffness: float, mass: float) -> None:
    """Tyres of other makes and other loads differ by as much."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    driven = with_damping(changed_vehicle(vehicle, {"cornering_stiffness_scale": stiffness, "mass_scale": mass}), 0.0)
    assert max(growth(vehicle, driven, kmh) for kmh in (2.5, 10.0, 90.0)) < 0.0


@pytest.mark.parametrize("wheelbase", [2.5, 7.0])
def test_other_wheelbases_are_stable_without_tuning(wheelbase: float) -> None:
    """Gains follow from the data sheet."""
    truck = load_vehicle("rigid_truck")
    unit = truck.units[0]
    scale = wheelbase / unit.axles[0].x
    front = unit.axles[0].model_copy(update={"x": wheelbase})
    inertia = {"yaw_inertia": unit.yaw_inertia * scale**2, "cg_x": unit.cg_x * scale}
    short = unit.model_copy(update={"axles": (front, *unit.axles[1:]), **inertia, "front_x": wheelbase + 1.4})
    vehicle = with_damping(truck.model_copy(update={"units": (short,)}), 0.0)
    assert max(growth(vehicle, vehicle, kmh) for kmh in (1.0, 2.5, 10.0, 50.0, 110.0)) < 0.0


def test_a_lane_change_is_that_of_the_linear_theory() -> None:
    """0.05 g at 88 km/h, the A-double on tyres without damping: its path, amplification, and the straight after it.

    Theory has the front axle exactly on the path and small motion: 3 % for both. The trailers' sway has decayed to
    millimetres 5 s after the change.
    """
    vehicle, speed = with_damping(load_vehicle("a_double"), 0.0), 88.0 / 3.6
    x, last = vehicle.units[0].steered_axles[0].x, vehicle.units[-1]
    course = lane_change(axle_x=x, speed=speed, peak_acceleration=0.05 * GRAVITY, preview=0.0, exit=150.0)
    log = drive(
        vehicle,
        Surface(friction=0.8),
        PreviewDriver(tractor_guided_at(vehicle, course.reference), course.path, speed),
        trailer_steering="none",
        speed=speed,
        done=lambda truth: bool(truth.poses[0, 0] >= course.length - x),
        patience=30.0,
    ).log
    front = point_path(log, vehicle.units[0].name, x)
    beside = front[:, 1] - np.interp(front[:, 0], *course.path.points(0.25).T)
    assert np.abs(beside).max() < 0.01  # a steering robot's 150 mm, by far
    assert math.sqrt(np.mean(beside[front[:, 0] > course.length - 30.0] ** 2)) < 0.002
    front_a_y = lateral_acceleration(log, vehicle.units[0].name, x)
    measured = amplification(lateral_acceleration(log, last.name, last.cg_x), front_a_y)
    assert measured == pytest.approx(linear_figures(vehicle)["rearward_amplification"], rel=0.03)
