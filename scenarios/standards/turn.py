"""The low-speed turn of performance-based standards: swept path, frontal swing, tail swing, friction demand."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.courses import Course, corner
from scenarios.options.course import outer_wall
from scenarios.results.swept_path import tail_swings
from scenarios.standards.low_speed import STRAIGHTENING, driven_slowly, path_error
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.motion import poses
from scenarios.standards.proving_ground import Drive
from scenarios.standards.room import front_reach, reach
from vehicle.combination.description import Vehicle

NAMES: Final = (
    "swept_path_m",
    "frontal_swing_m",
    "frontal_swing_mod_m",
    "frontal_swing_dom_m",
    "tail_swing_entry_m",
    "tail_swing_exit_m",
    "steer_friction_demand",
    "turn_path_error_m",
)


def turn(vehicle: Vehicle, trailer_steering: str) -> Manoeuvre:
    """Turn by 90 degrees with the outer wall of the outer steered tyre on an arc of 12.5 m."""
    tractor = vehicle.units[0]
    wheel_x, wheel_y = tractor.steered_axles[0].x, outer_wall(tractor)
    course = corner(wheel_x=wheel_x, wheel_y=wheel_y, exit=vehicle.length + STRAIGHTENING)
    driven = driven_slowly(vehicle, course, trailer_steering)
    return Manoeuvre(
        key="turn",
        title="Turn by 90° at low speed",
        how="5 km/h, laden, the outer wall of the outer steered tyre on an arc of 12.5 m, friction 0.8.",
        outcome=driven.outcome,
        figures=measured(NAMES, driven.outcome, lambda: _figures(vehicle, course, driven)),
        log=driven.log,
        course=course.path.points(0.25),
    )


def _figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
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
        "steer_friction_demand": float(np.max(driven.log["friction_used_steer"])),
        "turn_path_error_m": path_error(vehicle, course, driven),
    }


def _largest(values: Iterable[float]) -> float:
    return max((float(value) for value in values), default=math.nan)
