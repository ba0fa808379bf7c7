"""Slow manoeuvres along a path: the turn by 90 degrees of performance-based standards, and the EU circle.

The EU circle is that of 96/53/EC and 97/27/EC: a full turn between two concentric circles of 12.50 m and 5.30 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Final

import numpy as np

from controllers.driver import PreviewDriver
from scenarios.assembly.adapters import outlines, tractor_geometry
from scenarios.courses import Course, corner
from scenarios.courses import roundabout as roundabout_course
from scenarios.options.course import outer_wall
from scenarios.results.swept_path import inner_radius, swept_path, tail_swings
from scenarios.standards.conditions import STANDARD, Conditions
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.motion import articulation, point_path, poses
from scenarios.standards.proving_ground import Drive, drive
from scenarios.standards.reach import front_reach, reach
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import Pose2
from vehicle.surface import Surface

RADIUS: Final = 12.5  # of the guided point's path [m]
SPEED: Final = 5.0 / 3.6  # highest speed in the low-speed turn [m/s]
STRAIGHTENING: Final = 10.0  # exit beyond the combination's length, in which its last unit straightens [m]
DRY: Final = 0.8  # friction [-]
_TIME_LIMIT: Final = 2.0  # over the time that the path takes at set speed


def driven_slowly(vehicle: Vehicle, course: Course, trailer_steering: str, conditions: Conditions) -> Drive:
    """Drive a course, by default at 5 km/h on a dry road."""
    speed = conditions.speed_or(SPEED)
    station = 0.0

    def at_the_end(truth: Truth) -> bool:
        nonlocal station
        point = Pose2(*truth.poses[0]) @ Pose2(*course.reference, 0.0)
        station = course.path.project(point.x, point.y, station)
        return station >= course.length

    driver = PreviewDriver(tractor_geometry(vehicle, course), course.path, speed)
    patience = _TIME_LIMIT * course.length / speed
    return drive(
        vehicle,
        Surface(friction=conditions.friction_or(DRY)),
        driver,
        trailer_steering=trailer_steering,
        speed=speed,
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


def slow_drive(conditions: Conditions) -> str:
    """Speed and friction of a slow drive in words."""
    return f"{3.6 * conditions.speed_or(SPEED):g} km/h, friction {conditions.friction_or(DRY):g}"


ROUNDABOUT: Final = (
    "roundabout_inner_radius_m",
    "roundabout_outer_radius_m",
    "roundabout_width_m",
    "roundabout_tail_swing_m",
    "roundabout_articulation_rad",
    "roundabout_friction_demand",
    "roundabout_path_error_m",
)


def roundabout(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Full turn with the tractor's outer front corner on 12.5 m, entered and left along tangents."""
    tractor, radius = vehicle.units[0], conditions.radius_or(RADIUS)
    course = roundabout_course(
        front_x=tractor.front_x,
        width=tractor.width,
        direction=conditions.hand,
        radius=radius,
        exit=vehicle.length + STRAIGHTENING,
    )
    driven = driven_slowly(vehicle, course, trailer_steering, conditions)
    return Manoeuvre(
        key="roundabout",
        title="Roundabout between 12.50 m and 5.30 m",
        how=f"{slow_drive(conditions)}, 360° to the {conditions.hand} with the outer front corner on a circle of "
        f"{radius:g} m, along tangents in and out.",
        outcome=driven.outcome,
        figures=measured(ROUNDABOUT, driven.outcome, lambda: _roundabout_figures(vehicle, course, driven)),
        log=driven.log,
        course=course.path.points(0.25),
    )


def _roundabout_figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
    unit_poses = tuple(poses(driven.log, unit.name) for unit in vehicle.units)
    swept = swept_path(outlines(vehicle), unit_poses, course.surface_centre)
    names = [unit.name for unit in vehicle.units]
    side = 1.0 if course.path.curvature(0.5 * course.length) > 0.0 else -1.0
    angles = [(side * articulation(driven.log, *pair)).max() for pair in pairwise(names)]
    return {
        "roundabout_inner_radius_m": swept.min_inner_radius,
        "roundabout_outer_radius_m": swept.max_outer_radius,
        "roundabout_width_m": swept.max_width,
        "roundabout_tail_swing_m": swept.tail_swing,
        "roundabout_articulation_rad": max(angles, default=math.nan),
        "roundabout_friction_demand": float(np.max(driven.log["friction_used_steer"])),
        "roundabout_path_error_m": path_error(vehicle, course, driven),
    }


TURN: Final = (
    "swept_path_m",
    "frontal_swing_m",
    "frontal_swing_mod_m",
    "frontal_swing_dom_m",
    "tail_swing_entry_m",
    "tail_swing_exit_m",
    "turn_inner_radius_m",
    "steer_friction_demand",
    "turn_path_error_m",
)


def turn(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Turn by 90 degrees with the outer wall of the outer steered tyre on an arc of 12.5 m."""
    tractor, radius = vehicle.units[0], conditions.radius_or(RADIUS)
    course = corner(
        wheel_x=tractor.steered_axles[0].x,
        wheel_y=outer_wall(tractor),
        direction=conditions.hand,
        radius=radius,
        exit=vehicle.length + STRAIGHTENING,
    )
    driven = driven_slowly(vehicle, course, trailer_steering, conditions)
    return Manoeuvre(
        key="turn",
        title="Turn by 90° at low speed",
        how=f"{slow_drive(conditions)}, 90° to the {conditions.hand} with the outer wall of the outer steered tyre on "
        f"an arc of {radius:g} m.",
        outcome=driven.outcome,
        figures=measured(TURN, driven.outcome, lambda: _turn_figures(vehicle, course, driven)),
        log=driven.log,
        course=course.path.points(0.25),
    )


def _turn_figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
    bodies = outlines(vehicle)
    unit_poses = [poses(driven.log, unit.name) for unit in vehicle.units]
    fronts = [front_reach(body, pose, course.path) for body, pose in zip(bodies, unit_poses, strict=True)]
    farthest = [float(np.nanmax(front)) for front in fronts]
    at_entry, at_exit = tail_swings(bodies, unit_poses)
    return {
        "swept_path_m": reach(bodies, unit_poses, course.path).width,
        "frontal_swing_m": farthest[0],
        "frontal_swing_mod_m": _largest(np.nanmax(front - fronts[0]) for front in fronts[1:]),
        "frontal_swing_dom_m": _largest(far - farthest[0] for far in farthest[1:]),
        "tail_swing_entry_m": at_entry,
        "tail_swing_exit_m": at_exit,
        "turn_inner_radius_m": inner_radius(bodies, unit_poses, course.arcs),
        "steer_friction_demand": float(np.max(driven.log["friction_used_steer"])),
        "turn_path_error_m": path_error(vehicle, course, driven),
    }


def _largest(values: Iterable[float]) -> float:
    return max((float(value) for value in values), default=math.nan)
