"""Full brake applications: straight ahead on dry, slippery and split friction, and in a turn.

A preview driver keeps the guided point of the tractor on its path and brakes as hard as he can until the combination
stands. The straight stop follows the type-0 test of UN R13, the turn FMVSS 121: a lane of 12 ft on a curve of 500 ft.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from controllers.driver import DriverCommand, DriverLike, DriverMemory, PreviewDriver
from offtrack.studies.standards.low_speed import reach
from offtrack.studies.standards.proving_ground import (
    STANDARD,
    Conditions,
    Figures,
    Manoeuvre,
    articulation,
    drive,
    measured,
    point_path,
    poses,
)
from scenarios.assembly.adapters import outlines, tractor_geometry
from scenarios.courses import Course, Turn, turns
from scenarios.courses import straight as straight_course
from scenarios.results.log import Log
from sensors.messages import EgoState
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.surface import SplitFriction, Surface

SPEED: Final = 60.0 / 3.6  # of the straight stops [m/s]
TURN_SPEED: Final = 30.0 * 0.44704  # [m/s]
RADIUS: Final = 500.0 * 0.3048  # of the turn [m]
LANE: Final = 12.0 * 0.3048  # width of the lane in the turn [m]
DRY: Final = 0.8  # friction [-]
SLIPPERY: Final = 0.3
SPLIT: Final = (0.8, 0.2)  # left and right
WET: Final = 0.5  # in the turn
_QUANTITIES: Final = (
    "distance_m",
    "mean_deceleration_m_s2",
    "path_error_m",
    "articulation_rad",
    "steer_deg",
)
_FULL: Final = 20.0  # demand [m/s2]; the plant limits it
_STANDS: Final = 0.2  # speed at which a stop has ended [m/s]
_SETTLED: Final = 60.0  # distance before the brakes are applied [m]
_ENTRY: Final = 20.0  # straight before the turn [m]

Friction: TypeAlias = float | SplitFriction


class _Memory(NamedTuple):
    """State of the driver."""

    driver: DriverMemory
    braking: bool


class BrakingDriver(DriverLike[_Memory]):
    """Keeps path and speed, and brakes fully from a point on."""

    def __init__(self, driver: PreviewDriver, station: float) -> None:
        """Steer like ``driver``; brake when the guided point has come to a ``station`` of the path [m]."""
        self._driver, self._station = driver, station

    def init(self) -> _Memory:
        """Memory at the start."""
        return _Memory(self._driver.init(), braking=False)

    def step(self, memory: _Memory, tick: int, ego: EgoState) -> tuple[_Memory, DriverCommand]:
        """New memory and command at ``tick``."""
        inner, command = self._driver.step(memory.driver, tick, ego)
        braking = memory.braking or inner.station >= self._station
        demand = -_FULL if braking else command.acceleration
        return _Memory(inner, braking), command._replace(acceleration=demand)


def braking(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Straight stop on dry road."""
    friction = conditions.friction_or(DRY)
    title, how = "Braking to a stop", f"friction {friction:g}"
    return _stop("braking", title, how, vehicle, trailer_steering, friction, conditions.speed_or(SPEED))


def braking_slippery(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Straight stop on packed snow."""
    friction = conditions.friction_or(SLIPPERY)
    title, how = "Braking on slippery road", f"friction {friction:g}"
    return _stop("braking_slippery", title, how, vehicle, trailer_steering, friction, conditions.speed_or(SPEED))


def braking_split(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Straight stop with the wheels of one side on slippery road."""
    left, right = SPLIT if conditions.side > 0.0 else SPLIT[::-1]
    friction = SplitFriction(left=left, right=right, line=np.array([[0.0, 0.0], [1.0, 0.0]]))
    title, how = "Braking on split friction", f"friction {left:g} left and {right:g} right"
    return _stop("braking_split", title, how, vehicle, trailer_steering, friction, conditions.speed_or(SPEED))


def braking_in_turn(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Stop in a turn, by default to the left."""
    radius, friction = conditions.radius_or(RADIUS), conditions.friction_or(WET)
    speed = conditions.speed_or(TURN_SPEED)
    length = _SETTLED + speed**2 / (friction * 4.0) + 50.0
    tractor = vehicle.units[0]
    course = turns(
        front_x=tractor.front_x,
        width=tractor.width,
        sequence=[Turn(conditions.hand, radius, length / radius, 50.0)],
        entry=_ENTRY,
    )
    name, how = f"radius {radius:g} m to the {conditions.hand}", f"friction {friction:g}"
    return _driven(
        "braking_in_turn", "Braking in a turn", f"{name}, {how}", vehicle, trailer_steering, friction, speed, course
    )


def _stop(
    key: str, title: str, how: str, vehicle: Vehicle, trailer_steering: str, friction: Friction, speed: float
) -> Manoeuvre:
    course = straight_course(front_x=vehicle.units[0].steered_axles[0].x, length=_SETTLED + speed**2 + 100.0)
    return _driven(key, title, how, vehicle, trailer_steering, friction, speed, course)


def _driven(
    key: str,
    title: str,
    how: str,
    vehicle: Vehicle,
    trailer_steering: str,
    friction: Friction,
    speed: float,
    course: Course,
) -> Manoeuvre:
    preview = PreviewDriver(tractor_geometry(vehicle, course), course.path, speed)
    driven = drive(
        vehicle,
        Surface(friction=friction),
        BrakingDriver(preview, _SETTLED),
        trailer_steering=trailer_steering,
        speed=speed,
        done=_stands,
        patience=300.0,
    )
    names = tuple(f"{key}_{quantity}" for quantity in _QUANTITIES)
    names += ("braking_lane_m",) if key == "braking_in_turn" else ()
    return Manoeuvre(
        key=key,
        title=title,
        how=f"{3.6 * speed:.1f} km/h, full brake application, {how}; a driver keeps the path.",
        outcome=driven.outcome,
        figures=measured(names, driven.outcome, lambda: _figures(key, vehicle, driven.log, course)),
        log=driven.log,
        course=np.array([course.path.pose(s)[:2] for s in np.arange(0.0, course.path.length, 1.0)]),
    )


def _stands(truth: Truth) -> bool:
    return bool(truth.velocities[0, 0] < _STANDS)


def _figures(key: str, vehicle: Vehicle, log: Log, course: Course) -> Figures:
    tractor, names = vehicle.units[0].name, [unit.name for unit in vehicle.units]
    guided = point_path(log, tractor, *course.reference)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(guided, axis=0).T))])
    speed, applied = log[f"v_x_{tractor}"], int(np.searchsorted(driven, _SETTLED))
    folded = [np.abs(articulation(log, *pair)) for pair in pairwise(names)]
    figures = {
        "distance_m": driven[-1] - driven[applied],
        "mean_deceleration_m_s2": _mean_deceleration(speed[applied:], driven[applied:]),
        "path_error_m": _path_error(guided, course),
        "articulation_rad": max((float(angle.max()) for angle in folded), default=0.0),
        "steer_deg": math.degrees(float(np.max(np.abs(log["steer_tractor"])))),
    }
    named = {f"{key}_{name}": float(value) for name, value in figures.items()}
    return named | ({"braking_lane_m": _lane(vehicle, log, course)} if key == "braking_in_turn" else {})


def _mean_deceleration(speed: FloatArray, driven: FloatArray) -> float:
    """Mean fully developed deceleration [m/s2]: over the distance from 0.8 to 0.1 of the initial speed."""
    first, last = (int(np.argmax(speed < share * speed[0])) for share in (0.8, 0.1))
    return float(speed[first] ** 2 - speed[last] ** 2) / (2.0 * float(driven[last] - driven[first]))


def _path_error(guided: FloatArray, course: Course) -> float:
    """Largest distance of the guided point from its path [m]."""
    station, errors = 0.0, []
    for x, y in guided:
        station = course.path.project(float(x), float(y), station)
        on_path = course.path.pose(station)
        errors.append(math.dist((x, y), on_path[:2]))
    return max(errors)


def _lane(vehicle: Vehicle, log: Log, course: Course) -> float:
    """Width of the lane about the guided point's path that all bodies need [m]."""
    swept = reach(outlines(vehicle), [poses(log, unit.name) for unit in vehicle.units], course.path)
    return 2.0 * float(max(np.nanmax(swept.left), np.nanmax(-swept.right)))
