"""Slow turns with the centre of the front axle on an arc: AASHTO's templates, and the turn of the CTSW study.

AASHTO's design vehicles (A Policy on Geometric Design of Highways and Streets) and the Comprehensive Truck Size and
Weight study guide the front axle's centre, on 41 ft for combinations. What they call off-tracking and inside radius
follows from it. In a combination that does not slip, the inner end of the last axle is the body's nearest point to the
centre.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.courses import Course, corner
from scenarios.results.swept_path import inner_radius, tail_swings
from scenarios.standards.conditions import STANDARD, Conditions
from scenarios.standards.low_speed import STRAIGHTENING, driven_slowly, path_error, slow_drive
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.motion import point_path, poses
from scenarios.standards.proving_ground import Drive
from scenarios.standards.reach import reach
from vehicle.combination.description import Vehicle

RADIUS: Final = 41.0 * 0.3048  # [m]
_QUANTITIES: Final = (
    "inner_radius_m",
    "off_tracking_m",
    "width_m",
    "tail_swing_m",
    "friction_demand",
    "path_error_m",
)


def aashto_turn(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Turn by 180 degrees, as the templates of AASHTO's design vehicles."""
    return _turn("aashto", "AASHTO turn by 180°", 180.0, vehicle, trailer_steering, conditions)


def ctsw_turn(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Turn by 90 degrees, as in the Comprehensive Truck Size and Weight study."""
    return _turn("ctsw", "CTSW turn by 90°", 90.0, vehicle, trailer_steering, conditions)


def _turn(
    name: str, title: str, angle: float, vehicle: Vehicle, trailer_steering: str, conditions: Conditions
) -> Manoeuvre:
    radius = conditions.radius_or(RADIUS)
    course = corner(
        wheel_x=vehicle.units[0].steered_axles[0].x,
        direction=conditions.hand,
        radius=radius,
        turn=math.radians(angle),
        exit=vehicle.length + STRAIGHTENING,
    )
    driven = driven_slowly(vehicle, course, trailer_steering, conditions)
    names = tuple(f"{name}_{quantity}" for quantity in _QUANTITIES)
    return Manoeuvre(
        key=f"{name}_turn",
        title=title,
        how=f"{slow_drive(conditions)}, {angle:g}° to the {conditions.hand} with the centre of the front axle on an "
        f"arc of {radius:.2f} m, along tangents in and out.",
        outcome=driven.outcome,
        figures=measured(
            names, driven.outcome, lambda: dict(zip(names, _figures(vehicle, course, driven).values(), strict=True))
        ),
        log=driven.log,
        course=course.path.points(0.25),
    )


def _figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
    """Figures by the names of ``_QUANTITIES``."""
    bodies, last = outlines(vehicle), vehicle.units[-1]
    unit_poses = [poses(driven.log, unit.name) for unit in vehicle.units]
    middle = sum(axle.x for axle in last.axles) / len(last.axles)
    rear = point_path(driven.log, last.name, middle)
    (arc,) = course.arcs
    radius = next(1.0 / abs(segment.start_curvature) for segment in course.path.segments if segment.turn)
    figures = {
        "inner_radius_m": inner_radius(bodies, unit_poses, course.arcs),
        "off_tracking_m": max(0.0, radius - float(np.hypot(*(rear - np.array(arc.centre)).T).min())),
        "width_m": reach(bodies, unit_poses, course.path).width,
        "tail_swing_m": max(tail_swings(bodies, unit_poses)),
        "friction_demand": float(np.max(driven.log["friction_used_steer"])),
        "path_error_m": path_error(vehicle, course, driven),
    }
    return {name: figures[name] for name in _QUANTITIES}
