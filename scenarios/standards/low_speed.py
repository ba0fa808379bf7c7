"""A slow drive along a path to its end."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from controllers.driver import PreviewDriver
from scenarios.assembly.adapters import tractor_geometry
from scenarios.courses import Course
from scenarios.standards.motion import point_path
from scenarios.standards.proving_ground import Drive, drive
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import Pose2
from vehicle.surface import Surface

SPEED: Final = 5.0 / 3.6  # highest speed in the low-speed turn [m/s]
STRAIGHTENING: Final = 10.0  # exit beyond the combination's length, in which its last unit straightens [m]
_DRY: Final = 0.8  # friction [-]
_TIME_LIMIT: Final = 2.0  # over the time that the path takes at set speed


def driven_slowly(vehicle: Vehicle, course: Course, trailer_steering: str) -> Drive:
    """Drive a course at 5 km/h on a dry road."""
    station = 0.0

    def at_the_end(truth: Truth) -> bool:
        nonlocal station
        point = Pose2(*truth.poses[0]) @ Pose2(*course.reference, 0.0)
        station = course.path.project(point.x, point.y, station)
        return station >= course.length

    driver = PreviewDriver(tractor_geometry(vehicle, course), course.path, SPEED)
    patience = _TIME_LIMIT * course.length / SPEED
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
    """Largest distance of the guided point from its path [m]."""
    station, errors = 0.0, []
    for x, y in point_path(driven.log, vehicle.units[0].name, *course.reference):
        station = course.path.project(float(x), float(y), station)
        on_path = course.path.pose(station)
        errors.append(math.hypot(on_path.x - x, on_path.y - y))
    return float(np.max(errors))
