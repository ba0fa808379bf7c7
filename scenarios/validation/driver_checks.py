"""Checks of the preview driver: stability, straight running and lane change of every shipped combination."""

from __future__ import annotations

from itertools import chain
from typing import Final

import numpy as np

from controllers.driver import PreviewDriver
from scenarios.assembly.tractor_data import tractor_guided_at
from scenarios.courses import Course, lane_change
from scenarios.standards.motion import amplification, lateral_acceleration, point_path
from scenarios.standards.proving_ground import drive
from scenarios.standards.theory import linear_figures
from scenarios.validation.check import Check, Section
from scenarios.validation.driver_loop import driver_modes
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.surface import Surface

SPEEDS: Final = (1.0, 2.5, 10.0, 20.0, 40.0, 65.0, 90.0, 110.0)  # [km/h]
DAMPINGS: Final = (0.0, 0.05)  # of the carcass at rest [s]
_SPEED: Final = 88.0 / 3.6  # of ISO 14791 [m/s]
_PEAK: Final = 0.05 * GRAVITY  # [m/s2]
_EXIT: Final = 250.0  # after the lane change [m]: 10 s, so that motion decays
_QUICK: Final = ("a_double", "rigid_truck")


def driver(quick: bool) -> Section:
    """Largest growth rate over speeds; path and amplification of a lane change under the driver."""
    vehicles = [load_vehicle(name) for name in (_QUICK if quick else vehicle_names())]
    checks = chain.from_iterable((_stability(vehicle), *_lane_change(vehicle)) for vehicle in vehicles)
    return Section(
        title="Driver",
        text="Stability: the linear motion of the combination, closed by the driver's code, from 1 to 110 km/h, with a "
        "tyre damping of 0 and of 0.05 s. Lane change: 0.4 Hz and 0.05 g of the front axle at 88 km/h, driven by the "
        "driver with the front axle guided.",
        checks=tuple(checks),
    )


def with_damping(vehicle: Vehicle, damping: float) -> Vehicle:
    """The vehicle with another ``damping`` [s] of all tyres."""
    units = []
    for unit in vehicle.units:
        tyres = [axle.tyre.model_copy(update={"damping": damping}) for axle in unit.axles]
        axles = [axle.model_copy(update={"tyre": t}) for axle, t in zip(unit.axles, tyres, strict=True)]
        units.append(unit.model_copy(update={"axles": tuple(axles)}))
    return vehicle.model_copy(update={"units": tuple(units)})


def _stability(vehicle: Vehicle) -> Check:
    ahead = vehicle.units[0].front_x
    growth = {
        (kmh, damping): float(driver_modes(vehicle, with_damping(vehicle, damping), kmh / 3.6, ahead).real.max())
        for damping in DAMPINGS
        for kmh in SPEEDS
    }
    kmh, damping = max(growth, key=lambda case: growth[case])
    return Check(
        f"{vehicle.name}: largest growth rate, if any",
        max(0.0, growth[kmh, damping]),
        "1/s",
        target=0.0,
        tolerance=1e-6,
        source="all modes decay",
        remark=f"slowest decay {growth[kmh, damping]:.3f} 1/s at {kmh:g} km/h, damping {damping:g} s",
    )


def _lane_change(vehicle: Vehicle) -> list[Check]:
    x, last = vehicle.units[0].steered_axles[0].x, vehicle.units[-1]
    course = lane_change(axle_x=x, speed=_SPEED, peak_acceleration=_PEAK, preview=0.0, exit=_EXIT)
    log = drive(
        vehicle,
        Surface(friction=0.8),
        PreviewDriver(tractor_guided_at(vehicle, course.reference), course.path, _SPEED),
        trailer_steering="none",
        speed=_SPEED,
        done=lambda truth: bool(truth.poses[0, 0] >= course.length - x),
        patience=60.0,
    ).log
    front = point_path(log, vehicle.units[0].name, x)
    offsets = np.array([_offset(course, *point) for point in front[:: len(front) // 500].tolist()])
    checks = [
        Check(
            f"{vehicle.name}: path error of the front axle",
            float(np.abs(offsets).max()),
            "m",
            target=0.0,
            tolerance=0.15,
            source="ISO 14791, from memory: path within 150 mm",
        ),
        Check(
            f"{vehicle.name}: RMS of the front axle beside the straight road after it",
            float(np.sqrt(np.mean(offsets[len(offsets) // 2 :] ** 2))),
            "m",
            target=0.0,
            tolerance=0.01,
            source="the project's bar for a smooth road",
        ),
    ]
    if len(vehicle.units) > 1:
        theory = linear_figures(vehicle)["rearward_amplification"]
        rear = lateral_acceleration(log, last.name, last.cg_x)
        ratio = amplification(rear, lateral_acceleration(log, vehicle.units[0].name, x))
        name = f"{vehicle.name}: rearward amplification"
        source = "linear theory with the same lags, front axle on its path"
        checks.append(Check(name, ratio, "-", target=theory, tolerance=0.03 * theory, source=source))
    return checks


def _offset(course: Course, x: float, y: float) -> float:
    """Lateral position beside the course's path [m]."""
    return y - course.path.pose(course.path.project(x, y, x - course.reference[0])).y
