"""Full brake applications, and longitudinal capability: starting and climbing, acceleration, holding downhill.

Brakes: a preview driver keeps the guided point of the tractor on its path and brakes as hard as he can until the
combination stands. The straight stop follows the type-0 test of UN R13, the turn FMVSS 121: a lane of 12 ft on a curve
of 500 ft.

Capability: each quantity is the grade or speed at which the simulated combination neither gains nor loses speed;
acceleration is driven in full. Gears are a continuous ratio, so no time is lost by shifting.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import brentq

from controllers.driver import DriverCommand, DriverLike, DriverMemory, PreviewDriver
from offtrack.studies.standards.low_speed import reach
from offtrack.studies.standards.proving_ground import (
    KINDS,
    PERIOD,
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    Setting,
    drive_course,
    drive_log,
    largest_articulation,
    path_error,
    point_path,
    result,
)
from scenarios import courses
from scenarios.assembly.adapters import outlines
from scenarios.courses import Course, Turn
from scenarios.results.log import Log
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.combination import handling as theory
from vehicle.combination.actuators import retarder_capacity
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import SplitFriction, Surface

SPLIT: Final = (0.8, 0.2)  # friction left and right
_FULL: Final = 20.0  # demand of full brakes or full throttle [m/s2]; the plant limits it
_STANDS: Final = 0.2  # speed at which a stop has ended [m/s]
_SETTLED: Final = 60.0  # distance before the brakes are applied [m]
_ENTRY: Final = 20.0  # straight before the turn [m]


class _Memory(NamedTuple):
    """State of the driver."""

    driver: DriverMemory
    braking: bool


class BrakingDriver(DriverLike[_Memory]):
    """Keeps path and speed, and brakes fully from a point on."""

    def __init__(self, driver: PreviewDriver) -> None:
        """Steer like ``driver``; brake when the guided point has settled."""
        self._driver = driver

    def init(self) -> _Memory:
        """Memory at the start."""
        return _Memory(self._driver.init(), braking=False)

    def step(self, memory: _Memory, tick: int, ego: EgoState) -> tuple[_Memory, DriverCommand]:
        """New memory and command at ``tick``."""
        inner, command = self._driver.step(memory.driver, tick, ego)
        braking = memory.braking or inner.station >= _SETTLED
        demand = -_FULL if braking else command.acceleration
        return _Memory(inner, braking), command._replace(acceleration=demand)


def braking(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Straight stop on dry road."""
    at = KINDS["braking"].under(conditions)
    return _stop("braking", f"friction {at.friction:g}", vehicle, trailer_steering, at, at.surface)


def braking_slippery(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Straight stop on packed snow."""
    at = KINDS["braking_slippery"].under(conditions)
    return _stop("braking_slippery", f"friction {at.friction:g}", vehicle, trailer_steering, at, at.surface)


def braking_split(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Straight stop with the wheels of one side on slippery road."""
    at = KINDS["braking_split"].under(conditions)
    left, right = SPLIT if at.side > 0.0 else SPLIT[::-1]
    split = SplitFriction(left=left, right=right, line=np.array([[0.0, 0.0], [1.0, 0.0]]))
    how = f"friction {left:g} left and {right:g} right"
    return _stop("braking_split", how, vehicle, trailer_steering, at, Surface(friction=split))


def braking_in_turn(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Stop in a turn, by default to the left."""
    at, tractor = KINDS["braking_in_turn"].under(conditions), vehicle.units[0]
    length = _SETTLED + at.speed**2 / (at.friction * 4.0) + 50.0
    turn = Turn(at.hand, at.radius, length / at.radius, 50.0)
    course = courses.turns(front_x=tractor.front_x, width=tractor.width, sequence=[turn], entry=_ENTRY)
    how = f"radius {at.radius:g} m to the {at.hand}, friction {at.friction:g}"
    return _stop("braking_in_turn", how, vehicle, trailer_steering, at, at.surface, course)


def _stop(
    key: str,
    how: str,
    vehicle: Vehicle,
    trailer_steering: str,
    at: Setting,
    surface: Surface,
    course: Course | None = None,
) -> Manoeuvre:
    """A stop on a course, by default straight ahead."""
    length = _SETTLED + at.speed**2 + 100.0
    course = course or courses.straight(front_x=vehicle.units[0].steered_axles[0].x, length=length)
    driven = drive_course(
        vehicle,
        course,
        surface,
        speed=at.speed,
        trailer_steering=trailer_steering,
        done=lambda truth: bool(truth.velocities[0, 0] < _STANDS),
        driver=BrakingDriver,
        patience=300.0,
    )
    return result(
        key,
        f"{3.6 * at.speed:.1f} km/h, full brake application, {how}; a driver keeps the path.",
        driven,
        lambda: _stop_figures(key, vehicle, driven.log, course),
        course=np.array([course.path.pose(s)[:2] for s in np.arange(0.0, course.path.length, 1.0)]),
    )


def _stop_figures(key: str, vehicle: Vehicle, log: Log, course: Course) -> Figures:
    tractor = vehicle.units[0].name
    guided = point_path(log, tractor, *course.reference)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(guided, axis=0).T))])
    speed, applied = log[f"v_x_{tractor}"], int(np.searchsorted(driven, _SETTLED))
    bodies = outlines(vehicle)
    swept = reach(bodies, [body.poses(log) for body in bodies], course.path)
    return {
        f"{key}_distance_m": driven[-1] - driven[applied],
        f"{key}_mean_deceleration_m_s2": _mean_deceleration(speed[applied:], driven[applied:]),
        f"{key}_path_error_m": path_error(guided, course),
        f"{key}_articulation_rad": largest_articulation(vehicle, log) if len(vehicle.units) > 1 else 0.0,
        f"{key}_steer_deg": math.degrees(float(np.max(np.abs(log["steer_tractor"])))),
        "braking_lane_m": 2.0 * float(max(np.nanmax(swept.left), np.nanmax(-swept.right))),  # about the path
    }


def _mean_deceleration(speed: FloatArray, driven: FloatArray) -> float:
    """Mean fully developed deceleration [m/s2]: over the distance from 0.8 to 0.1 of the initial speed."""
    first, last = (int(np.argmax(speed < share * speed[0])) for share in (0.8, 0.1))
    return float(speed[first] ** 2 - speed[last] ** 2) / (2.0 * float(driven[last] - driven[first]))


GRADEABILITY_SPEED: Final = 10.0 / 3.6  # at which the steepest grade is kept [m/s]
GRADE: Final = 0.01  # on which the speed is measured [-]
HOLDING_SPEED: Final = 30.0 / 3.6  # [m/s]
DISTANCE: Final = 100.0  # of the acceleration test [m]
_SETTLE: Final = 3000  # until force and loads have settled [ticks]
_SPAN: Final = 1000  # over which the gain of speed is measured [ticks]
_RESOLUTION: Final = 1e-4  # of grades [-] and speeds [m/s]
_WALKING: Final = 1.0  # speed at which startability is measured, clutch slipping [m/s]
_LONGEST: Final = 120.0  # of the acceleration test [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Incline(Surface):
    """A plane of any slope."""

    def __post_init__(self) -> None:
        """Skip the limits of a road: its slopes are at most 0.2."""


def longitudinal(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Starting, climbing, accelerating and holding the combination, straight ahead."""
    at = KINDS["longitudinal"].under(conditions)
    truths = _accelerated(vehicle, at.friction)
    outcome = "completed" if truths[-1].poses[0, 0] >= DISTANCE else "timed out"
    driven = Drive(outcome=outcome, log=drive_log(vehicle, truths))
    return result(
        "longitudinal",
        f"Full throttle, friction {at.friction:g}: grades on which it keeps {_WALKING:g} m/s and "
        f"{3.6 * GRADEABILITY_SPEED:g} km/h, speed on {100.0 * GRADE:g} %, time from rest over {DISTANCE:g} m of level "
        "road, no shifts of gear. Downhill: grade on which the endurance brake alone keeps "
        f"{3.6 * HOLDING_SPEED:g} km/h.",
        driven,
        lambda: _capability(vehicle, at.friction, driven.log),
    )


def longitudinal_theory(vehicle: Vehicle, friction: float = theory.DRY) -> Figures:
    """The same quantities computed from the vehicle's data."""
    figures = {
        "startability": theory.startability(vehicle, friction),
        "gradeability": theory.gradeability(vehicle, GRADEABILITY_SPEED, friction),
        "gradeability_speed_m_s": theory.climbing_speed(vehicle, GRADE, friction),
        "acceleration_100_m_s": theory.acceleration_time(vehicle, DISTANCE, friction),
    }
    if float(retarder_capacity(vehicle, HOLDING_SPEED)) == 0.0:
        return figures
    return figures | {"holding_grade": theory.holding_grade(vehicle, HOLDING_SPEED, friction)}


def _capability(vehicle: Vehicle, friction: float, log: Log) -> Figures:
    figures = {
        "startability": _root(lambda grade: _gain(vehicle, friction, grade, _WALKING, _FULL), 0.0, 1.0),
        "gradeability": _root(lambda grade: _gain(vehicle, friction, grade, GRADEABILITY_SPEED, _FULL), 0.0, 1.0),
        "gradeability_speed_m_s": _root(lambda v: _gain(vehicle, friction, GRADE, v, _FULL), 1.0, 60.0),
        "acceleration_100_m_s": float(np.interp(DISTANCE, log[f"x_{vehicle.units[0].name}"], log["time"])),
    }
    capacity = float(retarder_capacity(vehicle, HOLDING_SPEED))
    if capacity == 0.0:
        return figures
    alone, demand = _retarded(vehicle), -capacity / vehicle.mass
    return figures | {
        "holding_grade": _root(lambda grade: -_gain(alone, friction, -grade, HOLDING_SPEED, demand), 0.0, 1.0)
    }


def _retarded(vehicle: Vehicle) -> Vehicle:
    """The vehicle while the driver brakes with its endurance brake."""
    if vehicle.powertrain is None or vehicle.powertrain.retarder is None:
        return vehicle
    retarder = vehicle.powertrain.retarder.model_copy(update={"acts_first": True})
    return vehicle.model_copy(update={"powertrain": vehicle.powertrain.model_copy(update={"retarder": retarder})})


def _gain(vehicle: Vehicle, friction: float, grade: float, speed: float, demand: float) -> float:
    """Gain of speed [m/s2] under a held demand, once forces have settled."""
    plant, command = Plant(vehicle, Incline(friction=friction, grade=grade)), _command(vehicle, demand)
    state = plant.step(plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), command, _SETTLE)
    before = plant.observe(state, 0).velocities[0, 0]
    after = plant.observe(plant.step(state, command, _SPAN), 0).velocities[0, 0]
    return float(after - before) / (_SPAN * TICK)


def _root(gain: Callable[[float], float], low: float, high: float) -> float:
    """Argument at which a falling gain of speed vanishes; the end that it does not reach, or 0 if it never gains."""
    if gain(low) <= 0.0:
        return 0.0
    return high if gain(high) >= 0.0 else float(brentq(gain, low, high, xtol=_RESOLUTION))


def _command(vehicle: Vehicle, demand: float) -> VehicleCommand:
    return VehicleCommand(0.0, demand, (0.0,) * vehicle.n_by_law)


def _accelerated(vehicle: Vehicle, friction: float) -> list[Truth]:
    """Full throttle from rest on level road, until the distance or the longest time is over."""
    plant = Plant(vehicle, Surface(friction=friction))
    state, truths = plant.initial_state(Pose2(0.0, 0.0, 0.0), 0.0), []
    for tick in range(0, round(_LONGEST / TICK), PERIOD):
        truths.append(plant.observe(state, tick))
        if truths[-1].poses[0, 0] >= DISTANCE:
            break
        state = plant.step(state, _command(vehicle, _FULL), PERIOD)
    return truths
