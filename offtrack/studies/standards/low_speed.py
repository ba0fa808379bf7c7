"""Slow turns along a path: turn by 90 degrees, EU circle, AASHTO's and CTSW's turns, and the reach of bodies.

The EU circle is that of 96/53/EC and 97/27/EC: a full turn between two concentric circles of 12.50 m and 5.30 m.

AASHTO's design vehicles (A Policy on Geometric Design of Highways and Streets) and the Comprehensive Truck Size and
Weight study guide the front axle's centre, on 41 ft for combinations. What they call off-tracking and inside radius
follows from it. In a combination that does not slip, the inner end of the last axle is the body's nearest point to the
centre.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from controllers.driver import PreviewDriver
from controllers.path import Path
from offtrack.studies.standards.proving_ground import (
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    articulation,
    drive,
    measured,
    point_path,
    poses,
)
from scenarios.assembly.adapters import outlines, tractor_geometry
from scenarios.courses import Course, corner
from scenarios.courses import roundabout as roundabout_course
from scenarios.options.course import outer_wall
from scenarios.results.swept_path import UnitOutline, inner_radius, placed, swept_path, tail_swings
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2, arc_length
from vehicle.surface import Surface

_SPACING: Final = 0.1  # of the stations along the path [m]
_EDGE: Final = 0.2  # between points along a body's edge [m]: an error of 0.4 mm inside a 12.5 m arc
_BEYOND: Final = 40.0  # straight before and after the path [m]: longer than any combination


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Reach of bodies to the left and right of a path, at stations along it; NaN at stations without a body."""

    left: FloatArray  # (m,) [m], + left
    right: FloatArray  # (m,) [m], + left too

    @property
    def width(self) -> float:
        """Largest width, square to the path [m]."""
        return float(np.nanmax(self.left - self.right))

    def outside(self, path: Path) -> FloatArray:
        """Reach to the outside of the path's turn, (m,) [m]."""
        return -self.right if _turns_left(path) else self.left


def _turns_left(path: Path) -> bool:
    """True if the path turns left in total."""
    return path.knots[-1].psi >= path.start.psi


def reach(outlines: Sequence[UnitOutline], poses: Sequence[FloatArray], path: Path) -> Reach:
    """Reach of all bodies; ``poses`` (n, 3) of each unit over time."""
    swept = [placed(_edge(outline), _thinned(pose)) for outline, pose in zip(outlines, poses, strict=True)]
    return _reach_of(np.concatenate([points.reshape(-1, 2) for points in swept]), path)


def front_reach(outline: UnitOutline, poses: FloatArray, path: Path) -> FloatArray:
    """Reach of a unit's outer front corner to the outside, (m,) [m]; NaN at stations that it does not pass."""
    side = -1.0 if _turns_left(path) else 1.0
    corner = placed(np.array([[outline.front_x, side * 0.5 * outline.width]]), poses)[:, 0]
    return _reach_of(corner, path).outside(path)


def _edge(outline: UnitOutline) -> FloatArray:
    """Points around a body, shape (m, 2) in its frame."""
    ends = zip(outline.corners, np.roll(outline.corners, -1, axis=0), strict=True)
    sides = [np.linspace(a, b, math.ceil(np.hypot(*(b - a)) / _EDGE), endpoint=False) for a, b in ends]
    return np.concatenate(sides)


def _thinned(poses: FloatArray) -> FloatArray:
    """Poses at about the spacing of stations."""
    along = arc_length(poses[:, :2])
    rows = np.searchsorted(along, np.arange(0.0, along[-1], _SPACING))
    thinned: FloatArray = poses[np.unique(np.append(rows, len(poses) - 1))]
    return thinned


def _reach_of(points: FloatArray, path: Path) -> Reach:
    """Largest and smallest lateral offsets of points (k, 2) from the path at each station."""
    stations = np.arange(-_BEYOND, path.length + _BEYOND, _SPACING)
    x, y, psi = np.array([path.pose(float(s)) for s in stations]).T
    _, nearest = KDTree(np.column_stack([x, y])).query(points)
    lateral = (points[:, 1] - y[nearest]) * np.cos(psi[nearest]) - (points[:, 0] - x[nearest]) * np.sin(psi[nearest])
    left, right = np.full(len(stations), -math.inf), np.full(len(stations), math.inf)
    np.maximum.at(left, nearest, lateral)
    np.minimum.at(right, nearest, lateral)
    return Reach(np.where(np.isfinite(left), left, math.nan), np.where(np.isfinite(right), right, math.nan))


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


ARC_RADIUS: Final = 41.0 * 0.3048  # [m]
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
    radius = conditions.radius_or(ARC_RADIUS)
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
            names, driven.outcome, lambda: dict(zip(names, _arc_figures(vehicle, course, driven).values(), strict=True))
        ),
        log=driven.log,
        course=course.path.points(0.25),
    )


def _arc_figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
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
