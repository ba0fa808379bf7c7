"""The roundabout of 97/27/EC: a full turn between two concentric circles of 12.50 m and 5.30 m."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

from scenarios.assembly.adapters import outlines
from scenarios.courses import Course
from scenarios.courses import roundabout as roundabout_course
from scenarios.results.swept_path import swept_path
from scenarios.standards.low_speed import STRAIGHTENING, driven_slowly, path_error
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.motion import articulation, poses
from scenarios.standards.proving_ground import Drive
from vehicle.combination.description import Vehicle

NAMES: Final = (
    "roundabout_inner_radius_m",
    "roundabout_outer_radius_m",
    "roundabout_width_m",
    "roundabout_tail_swing_m",
    "roundabout_articulation_rad",
    "roundabout_path_error_m",
)


def roundabout(vehicle: Vehicle, trailer_steering: str) -> Manoeuvre:
    """Full turn with the tractor's outer front corner on 12.5 m, entered and left along tangents."""
    tractor = vehicle.units[0]
    course = roundabout_course(front_x=tractor.front_x, width=tractor.width, exit=vehicle.length + STRAIGHTENING)
    driven = driven_slowly(vehicle, course, trailer_steering)
    return Manoeuvre(
        key="roundabout",
        title="Roundabout between 12.50 m and 5.30 m",
        how="5 km/h, laden, 360° with the outer front corner on a circle of 12.5 m, along tangents in and out, "
        "friction 0.8.",
        outcome=driven.outcome,
        figures=measured(NAMES, driven.outcome, lambda: _figures(vehicle, course, driven)),
        log=driven.log,
        course=course.path.points(0.25),
    )


def _figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
    unit_poses = tuple(poses(driven.log, unit.name) for unit in vehicle.units)
    swept = swept_path(outlines(vehicle), unit_poses, course.surface_centre)
    names = [unit.name for unit in vehicle.units]
    angles = [articulation(driven.log, *pair).max() for pair in pairwise(names)]
    return {
        "roundabout_inner_radius_m": swept.min_inner_radius,
        "roundabout_outer_radius_m": swept.max_outer_radius,
        "roundabout_width_m": swept.max_width,
        "roundabout_tail_swing_m": swept.tail_swing,
        "roundabout_articulation_rad": max(angles, default=math.nan),
        "roundabout_path_error_m": path_error(vehicle, course, driven),
    }
