"""Checks in the European roundabout: 360 degrees with the tractor's front corner on 12.5 m, against no-slip figures."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from scenarios import courses
from scenarios.assembly.adapters import outlines
from scenarios.courses import Course
from scenarios.results.swept_path import placed, tail_swings
from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.driving import along_path, poses_of
from scenarios.validation.no_slip import poses_along, rolling_chain
from scenarios.validation.vehicles import gripping, tractor_and_trailer
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.frames import FloatArray, Pose2

_RADIUS, _WIDTH = 12.5, 2.55  # [m]
_SPEED: Final = 1.0  # [m/s]; on stiff tyres slip moves a 12 m trailer outwards by 1 mm
_ENTRY: Final = 3.0  # [m], for the driver to settle
_SOURCE: Final = "independent kinematic calculation of the same turn"


class _Case(NamedTuple):
    """A trailer and its calculated reference figures."""

    name: str
    hitch_x: float  # kingpin ahead of the drive axle [m]
    length: float  # kingpin to axle [m]
    rear: float  # kingpin to rear end [m]
    inner: float  # smallest radius of the inner end of the axle [m]
    swept: float  # outer minus inner radius [m]
    swing: float  # of the rear corner [m]
    articulation: float  # at the end of the turn [deg]


_CASES: Final = (
    _Case("7.7 m trailer, kingpin 0.6 m ahead", 0.6, 7.7, 12.0, 5.313, 7.187, 0.257, 45.93),
    _Case("7.7 m trailer, kingpin 0.77 m ahead", 0.7744762, 7.7, 11.9, 5.330, 7.170, 0.241, 44.88),
    _Case("9.3 m trailer, kingpin 0.6 m ahead", 0.6, 9.3, 14.04, 3.133, 9.367, 0.317, 60.79),
)


def roundabout(quick: bool) -> Section:
    """Turns of 360 degrees, entered along the tangent, with three trailers."""
    turns = [(case, *_turned(case)) for case in (_CASES[-1:] if quick else _CASES)]
    return Section(
        title="Roundabout",
        text="The driver guides the tractor's outer front corner from the tangent once around a circle of 12.5 m, on "
        "stiff tyres at walking pace. The evaluation ends with the full circle.",
        checks=tuple(check for turn in turns for check in _checks(*turn)),
        plots=(_plan(*turns[-1]),),
    )


def _turned(case: _Case) -> tuple[Vehicle, Course, FloatArray]:
    vehicle = gripping(
        tractor_and_trailer(
            load_vehicle("eu_tractor_semitrailer"),
            length=case.length,
            hitch_x=case.hitch_x,
            rear=case.rear,
            width=_WIDTH,
        )
    )
    course = courses.roundabout(front_x=vehicle.units[0].front_x, width=_WIDTH, radius=_RADIUS, entry=_ENTRY, exit=1e-3)
    return vehicle, course, poses_of(along_path(vehicle, course.path, course.reference, _SPEED))


def _checks(case: _Case, vehicle: Vehicle, course: Course, poses: FloatArray) -> tuple[Check, ...]:
    inner, outer = _radii(vehicle, course, poses)
    swing = max(tail_swings(outlines(vehicle), (poses[:, 0], poses[:, 1])))
    rows = (
        ("smallest radius of the axle's inner end", inner, case.inner, 5e-3, "m"),
        ("swept width", outer - inner, case.swept, 10e-3, "m"),
        ("tail swing", swing, case.swing, 5e-3, "m"),
        (
            "articulation at the end",
            math.degrees(poses[-1, 0, 2] - poses[-1, 1, 2]),
            case.articulation,
            0.05,
            "°",
        ),
    )
    return tuple(
        Check(f"{case.name}: {name}", value, unit, target=target, tolerance=tolerance, source=_SOURCE)
        for name, value, target, tolerance, unit in rows
    )


def _radii(vehicle: Vehicle, course: Course, poses: FloatArray) -> tuple[float, float]:
    """Smallest radius of the trailer axle's inner end, and largest of the tractor's outer front corner [m]."""
    centre = course.path.start @ Pose2(_ENTRY, _RADIUS, 0.0)
    corner, inner = (np.hypot(path[:, 0] - centre.x, path[:, 1] - centre.y) for path in _paths(vehicle, poses))
    on_circle = int(
        np.argmax(_paths(vehicle, poses)[0][:, 0] >= centre.x)
    )  # it approaches along x, from outside the circle
    return float(inner.min()), float(corner[on_circle:].max())


def _paths(vehicle: Vehicle, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Paths (n, 2) of the tractor's outer front corner and the trailer axle's inner end."""
    tractor, trailer = vehicle.units
    corner = placed(np.array([[tractor.front_x, -0.5 * _WIDTH]]), poses[:, 0])[:, 0]
    return corner, placed(np.array([[trailer.axles[0].x, 0.5 * _WIDTH]]), poses[:, 1])[:, 0]


def _plan(case: _Case, vehicle: Vehicle, course: Course, poses: FloatArray) -> Plot:
    corner, inner = _paths(vehicle, poses)
    _, rolled = _paths(vehicle, poses_along(rolling_chain(vehicle), course.path, course.reference))
    return Plot(
        title=f"{case.name}: from above",
        x_label="x [m]",
        y_label="y [m]",
        series=(
            Series("tractor's front corner", corner[:, 0], corner[:, 1], "faint"),
            Series("inner end of the trailer's axle", inner[:, 0], inner[:, 1], "model"),
            Series("the same without slip", rolled[::50, 0], rolled[::50, 1], "reference points"),
        ),
        to_scale=True,
    )
