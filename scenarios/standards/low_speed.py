"""Slow manoeuvres along a path: the turn by 90 degrees of performance-based standards, and a roundabout.

The roundabout is that of 97/27/EC: a full turn between two concentric circles of 12.50 m and 5.30 m.
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
from scenarios.assembly.adapters import outlines, tractor_geometry
from scenarios.courses import Course, corner
from scenarios.courses import roundabout as roundabout_course
from scenarios.options.course import outer_wall
from scenarios.results.swept_path import UnitOutline, placed, swept_path, tail_swings
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.motion import articulation, point_path, poses
from scenarios.standards.proving_ground import Drive, drive
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.polyline import arc_length
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


ROUNDABOUT: Final = (
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
        figures=measured(ROUNDABOUT, driven.outcome, lambda: _roundabout_figures(vehicle, course, driven)),
        log=driven.log,
        course=course.path.points(0.25),
    )


def _roundabout_figures(vehicle: Vehicle, course: Course, driven: Drive) -> Figures:
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


_SPACING = 0.1  # of the stations along the path [m]
_EDGE = 0.2  # between points along a body's edge [m]: an error of 0.4 mm inside a 12.5 m arc
_BEYOND = 40.0  # straight before and after the path [m]: longer than any combination
TURN: Final = (
    "swept_path_m",
    "frontal_swing_m",
    "frontal_swing_mod_m",
    "frontal_swing_dom_m",
    "tail_swing_entry_m",
    "tail_swing_exit_m",
    "steer_friction_demand",
    "turn_path_error_m",
)


@dataclass(frozen=True, slots=True, eq=False)
class _Reach:
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
        "steer_friction_demand": float(np.max(driven.log["friction_used_steer"])),
        "turn_path_error_m": path_error(vehicle, course, driven),
    }


def _largest(values: Iterable[float]) -> float:
    return max((float(value) for value in values), default=math.nan)


def _turns_left(path: Path) -> bool:
    """True if the path turns left in total."""
    return path.knots[-1].psi >= path.start.psi


def reach(outlines: Sequence[UnitOutline], poses: Sequence[FloatArray], path: Path) -> _Reach:
    """Reach of all bodies; ``poses`` (n, 3) of each unit over time."""
    swept = [placed(_edge(outline), _thinned(pose)) for outline, pose in zip(outlines, poses, strict=True)]
    return _reach(np.concatenate([points.reshape(-1, 2) for points in swept]), path)


def front_reach(outline: UnitOutline, poses: FloatArray, path: Path) -> FloatArray:
    """Reach of a unit's outer front corner to the outside, (m,) [m]; NaN at stations that it does not pass."""
    side = -1.0 if _turns_left(path) else 1.0
    corner = placed(np.array([[outline.front_x, side * 0.5 * outline.width]]), poses)[:, 0]
    return _reach(corner, path).outside(path)


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


def _reach(points: FloatArray, path: Path) -> _Reach:
    """Largest and smallest lateral offsets of points (k, 2) from the path at each station."""
    stations = np.arange(-_BEYOND, path.length + _BEYOND, _SPACING)
    x, y, psi = np.array([path.pose(float(s)) for s in stations]).T
    _, nearest = KDTree(np.column_stack([x, y])).query(points)
    lateral = (points[:, 1] - y[nearest]) * np.cos(psi[nearest]) - (points[:, 0] - x[nearest]) * np.sin(psi[nearest])
    left, right = np.full(len(stations), -math.inf), np.full(len(stations), math.inf)
    np.maximum.at(left, nearest, lateral)
    np.minimum.at(right, nearest, lateral)
    return _Reach(np.where(np.isfinite(left), left, math.nan), np.where(np.isfinite(right), right, math.nan))
