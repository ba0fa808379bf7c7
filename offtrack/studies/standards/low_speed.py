"""Slow turns along a path: turn by 90 degrees, EU circle, AASHTO's and CTSW's turns, and the reach of bodies.

The EU circle is that of 96/53/EC and 97/27/EC: a full turn between two concentric circles of 12.50 m and 5.30 m.

AASHTO's design vehicles (A Policy on Geometric Design of Highways and Streets) and the Comprehensive Truck Size and
Weight study guide the front axle's centre, on 41 ft for combinations. What they call off-tracking and inside radius
follows from it. In a combination that does not slip, the inner end of the last axle is the body's nearest point to the
centre.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from controllers.path import Path
from offtrack.studies.standards.proving_ground import (
    KINDS,
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    Setting,
    drive_course,
    largest_articulation,
    path_error,
    point_path,
    result,
)
from scenarios import courses
from scenarios.assembly.adapters import outlines
from scenarios.courses import Course
from scenarios.options.course import outer_wall
from scenarios.results.swept_path import UnitOutline, inner_radius, placed, swept_path, tail_swings
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2, arc_length

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


STRAIGHTENING: Final = 10.0  # exit beyond the combination's length, in which its last unit straightens [m]


def roundabout(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Full turn with the tractor's outer front corner on 12.5 m, entered and left along tangents."""
    tractor, at = vehicle.units[0], KINDS["roundabout"].under(conditions)
    course = courses.roundabout(
        front_x=tractor.front_x,
        width=tractor.width,
        direction=at.hand,
        radius=at.radius,
        exit=vehicle.length + STRAIGHTENING,
    )
    how = (
        f"360° to the {at.hand} with the outer front corner on a circle of {at.radius:g} m, along tangents in and out."
    )
    return _driven_slowly("roundabout", how, vehicle, course, trailer_steering, at, _roundabout_figures)


def turn(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Turn by 90 degrees with the outer wall of the outer steered tyre on an arc of 12.5 m."""
    at = KINDS["turn"].under(conditions)
    course = _corner(vehicle, at, 90.0, outer_wall(vehicle.units[0]))
    how = f"90° to the {at.hand} with the outer wall of the outer steered tyre on an arc of {at.radius:g} m."
    return _driven_slowly("turn", how, vehicle, course, trailer_steering, at, _turn_figures)


def aashto_turn(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Turn by 180 degrees, as the templates of AASHTO's design vehicles."""
    return _template_turn("aashto", 180.0, vehicle, trailer_steering, conditions)


def ctsw_turn(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Turn by 90 degrees, as in the Comprehensive Truck Size and Weight study."""
    return _template_turn("ctsw", 90.0, vehicle, trailer_steering, conditions)


def _template_turn(
    name: str, angle: float, vehicle: Vehicle, trailer_steering: str, conditions: Conditions
) -> Manoeuvre:
    at = KINDS[f"{name}_turn"].under(conditions)
    how = (
        f"{angle:g}° to the {at.hand} with the centre of the front axle on an arc of {at.radius:.2f} m, along tangents "
        "in and out."
    )

    def figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
        return {f"{name}_{key}": value for key, value in _template_figures(vehicle, course, driven).items()}

    course = _corner(vehicle, at, angle)
    return _driven_slowly(f"{name}_turn", how, vehicle, course, trailer_steering, at, figures)


def _corner(vehicle: Vehicle, at: Setting, angle: float, wheel_y: float = 0.0) -> Course:
    """Turn by an angle [deg] of a point beside the first steered axle."""
    return courses.corner(
        wheel_x=vehicle.units[0].steered_axles[0].x,
        wheel_y=wheel_y,
        direction=at.hand,
        radius=at.radius,
        turn=math.radians(angle),
        exit=vehicle.length + STRAIGHTENING,
    )


def _driven_slowly(
    key: str,
    how: str,
    vehicle: Vehicle,
    course: Course,
    trailer_steering: str,
    at: Setting,
    figures: Callable[[Vehicle, Course, Drive], Figures],
) -> Manoeuvre:
    station = 0.0

    def at_the_end(truth: Truth) -> bool:
        nonlocal station
        point = Pose2(*truth.poses[0]) @ Pose2(*course.reference, 0.0)
        station = course.path.project(point.x, point.y, station)
        return station >= course.length

    driven = drive_course(
        vehicle, course, at.surface, speed=at.speed, trailer_steering=trailer_steering, done=at_the_end
    )
    return result(
        key,
        f"{3.6 * at.speed:g} km/h, friction {at.friction:g}, {how}",
        driven,
        lambda: figures(vehicle, course, driven),
        course=course.path.points(0.25),
    )


def _roundabout_figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
    bodies = outlines(vehicle)
    swept = swept_path(bodies, tuple(body.poses(driven.log) for body in bodies), course.surface_centre)
    side = 1.0 if course.path.curvature(0.5 * course.length) > 0.0 else -1.0
    return {
        "roundabout_inner_radius_m": swept.min_inner_radius,
        "roundabout_outer_radius_m": swept.max_outer_radius,
        "roundabout_width_m": swept.max_width,
        "roundabout_tail_swing_m": swept.tail_swing,
        "roundabout_articulation_rad": largest_articulation(vehicle, driven.log, side),
        "roundabout_friction_demand": _friction_demand(driven),
        "roundabout_path_error_m": _path_error(vehicle, course, driven),
    }


def _turn_figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
    bodies = outlines(vehicle)
    unit_poses = [body.poses(driven.log) for body in bodies]
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
        "steer_friction_demand": _friction_demand(driven),
        "turn_path_error_m": _path_error(vehicle, course, driven),
    }


def _template_figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
    """Figures of the turns of AASHTO and CTSW, by the endings of their names."""
    bodies, last = outlines(vehicle), vehicle.units[-1]
    unit_poses = [body.poses(driven.log) for body in bodies]
    middle = sum(axle.x for axle in last.axles) / len(last.axles)
    rear = point_path(driven.log, last.name, middle)
    (arc,) = course.arcs
    radius = next(1.0 / abs(segment.start_curvature) for segment in course.path.segments if segment.turn)
    return {
        "inner_radius_m": inner_radius(bodies, unit_poses, course.arcs),
        "off_tracking_m": max(0.0, radius - float(np.hypot(*(rear - np.array(arc.centre)).T).min())),
        "width_m": reach(bodies, unit_poses, course.path).width,
        "tail_swing_m": max(tail_swings(bodies, unit_poses)),
        "friction_demand": _friction_demand(driven),
        "path_error_m": _path_error(vehicle, course, driven),
    }


def _largest(values: Iterable[float]) -> float:
    return max((float(value) for value in values), default=math.nan)


def _friction_demand(driven: Drive) -> float:
    """Largest share of the available friction that the steered wheels use [-]."""
    return float(np.max(driven.log["friction_used_steer"]))


def _path_error(vehicle: Vehicle, course: Course, driven: Drive) -> float:
    """Largest distance of the guided point from its path [m]."""
    return path_error(point_path(driven.log, vehicle.units[0].name, *course.reference), course)
