"""A combination driven slowly along a path, until its driver is at the end of it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from controllers.driver import PreviewDriver
from scenarios.assembly.adapters import tractor_geometry
from scenarios.assembly.courses import Course
from scenarios.standards.motion import point_path
from scenarios.standards.proving_ground import Drive, drive
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import Pose2
from vehicle.surface import Surface

SPEED: Final = 5.0 / 3.6  # the highest the low-speed turn allows [m/s]
STRAIGHTENING: Final = 10.0  # of exit beyond the combination's length, in which its last unit comes into line [m]
_DRY: Final = 0.8  # friction [-]
_PATIENCE: Final = 2.0  # times what the path takes at set speed


def driven_slowly(vehicle: Vehicle, course: Course, trailer_steering: str) -> Drive:
    """The course driven at 5 km/h on a dry road."""
    station = 0.0

    def at_the_end(truth: Truth) -> bool:
        nonlocal station
        point = Pose2(*truth.poses[0]) @ Pose2(*course.reference, 0.0)
        station = course.path.project(point.x, point.y, station)
        return station >= course.length

    driver = PreviewDriver(tractor_geometry(vehicle, course), course.path, SPEED)
    patience = _PATIENCE * course.length / SPEED
    return drive(
        vehicle,
        Surface(friction=_DRY),
        driver,
        trailer_steering=trailer_steering,
        speed=SPEED,
        done=at_the_end,
        patience=patience,
    )


def path_error(vehicle: Vehicle, course: Course, driven: Drive) -> float:
    """How far the guided point was off its path at most [m]."""
    station, errors = 0.0, []
    for x, y in point_path(driven.log, vehicle.units[0].name, *course.reference):
        station = course.path.project(float(x), float(y), station)
        on_path = course.path.pose(station)
        errors.append(math.hypot(on_path.x - x, on_path.y - y))
    return float(np.max(errors))
