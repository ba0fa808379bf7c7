"""The preview driver in closed loop with whole combinations: stable at any speed, and on the path."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.driver import PreviewDriver
from offtrack.studies.standards.assessment import linear_figures
from offtrack.studies.standards.proving_ground import amplification, drive, lateral_acceleration, point_path
from offtrack.studies.validation.driver_checks import driver_modes, with_damping
from scenarios.assembly.adapters import tractor_guided_at
from scenarios.courses import corner, lane_change, straight
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.truth import Truth
from vehicle.combination.variants import changed_vehicle
from vehicle.surface import Surface
from vehicle.tyres.laws import TYRES


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


@pytest.mark.slow
def test_a_lane_change_is_that_of_the_linear_theory() -> None:
    """0.05 g at 88 km/h, the A-double on tyres without damping: its path, amplification, and the straight after it.

    Theory has the front axle exactly on the path and small motion: 3 % for both. The trailers' sway has decayed to
    millimetres 5 s after the change.
    """
    vehicle, speed = with_damping(load_vehicle("a_double"), 0.0), 88.0 / 3.6
    x, last = vehicle.units[0].steered_axles[0].x, vehicle.units[-1]
    course = lane_change(axle_x=x, speed=speed, peak_acceleration=0.05 * GRAVITY, exit=150.0)
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "kmh", "lateral", "friction"),
    [
        ("brush", 60.0, 0.2, 0.8),
        ("brush", 90.0, 0.15, 0.3),
        ("magic_formula", 20.0, 0.2, 0.8),
        ("linear", 2.5, 0.0, 0.8),
    ],
)
def test_curves_are_driven_without_weaving_on_any_tyre(law: str, kmh: float, lateral: float, friction: float) -> None:
    """Undamped tyres of other laws, half of the friction used, a quarter turn at creep.

    A kink of the path costs millimetres; after it the steer only settles.
    """
    vehicle, speed = with_tyres(load_vehicle("eu_tractor_semitrailer"), law), kmh / 3.6
    x = vehicle.units[0].steered_axles[0].x
    radius = speed**2 / (lateral * GRAVITY) if lateral else 12.5
    turn = min(math.tau, 6.0 * speed / radius) if lateral else 0.25 * math.tau
    course = corner(wheel_x=x, radius=radius, turn=turn, entry=20.0, exit=5.0 * speed + 10.0)
    end = course.path.pose(course.length)
    log = drive(
        vehicle,
        Surface(friction=friction),
        PreviewDriver(tractor_guided_at(vehicle, course.reference), course.path, speed),
        trailer_steering="none",
        speed=speed,
        done=lambda truth: math.dist((truth.poses[0] + x * np.array([*heading(truth), 0.0]))[:2], end[:2]) < 1.0,
        patience=1.3 * course.length / speed,
    ).log
    station, offsets = 0.0, []
    for at_x, at_y in point_path(log, vehicle.units[0].name, x).tolist():
        station = course.path.project(at_x, at_y, station)
        offsets.append(math.dist((at_x, at_y), course.path.pose(station)[:2]))
    assert max(offsets) < 0.02
    last = log["steer_tractor"][log["time"] > log["time"][-1] - 1.5]
    assert np.abs(np.diff(last)).sum() - abs(last[-1] - last[0]) < math.radians(0.1)


def heading(truth: Truth) -> tuple[float, float]:
    return math.cos(truth.poses[0, 2]), math.sin(truth.poses[0, 2])


def with_tyres(vehicle: Vehicle, law: str) -> Vehicle:
    """Undamped tyres of another law with the stiffness of the vehicle's own."""
    units = []
    for unit in vehicle.units:
        axles = []
        for axle in unit.axles:
            stiffness, own = axle.tyre.nominal_stiffness, axle.tyre
            shape = {"shape": 1.3, "curvature": -1.0} if law == "magic_formula" else {}
            tyre = TYRES[law].model_validate(
                {
                    "model": law,
                    **{name: getattr(own, name) for name in ("nominal_load", "relaxation_length", "pneumatic_trail")},
                    "rolling_resistance": own.rolling_resistance,
                    "damping": 0.0,
                    "longitudinal_stiffness": float(stiffness.x),
                    "cornering_stiffness": float(stiffness.y),
                    "load_sensitivity": 0.1,
                    **shape,
                }
            )
            axles.append(axle.model_copy(update={"tyre": tyre}))
        units.append(unit.model_copy(update={"axles": tuple(axles)}))
    return vehicle.model_copy(update={"units": tuple(units)})


def test_on_a_cross_fall_the_front_axle_stays_on_the_line() -> None:
    """1 km at 90 km/h; the body travels at an angle of 5 mrad, so a point 5 m ahead would be 27 mm off."""
    vehicle, speed = load_vehicle("rigid_truck"), 25.0
    x = vehicle.units[0].steered_axles[0].x
    course = straight(front_x=x, length=1000.0)
    log = drive(
        vehicle,
        Surface(friction=0.8, cross_fall=0.03),
        PreviewDriver(tractor_guided_at(vehicle, course.reference), course.path, speed),
        trailer_steering="none",
        speed=speed,
        done=lambda truth: bool(truth.poses[0, 0] >= course.length),
        patience=60.0,
    ).log
    assert math.sqrt(np.mean(point_path(log, vehicle.units[0].name, x)[:, 1] ** 2)) < 0.001  # of the entry: 0.2 mm
