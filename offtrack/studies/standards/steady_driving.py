"""Steady driving: swept width on a rough road with cross-fall, a gust as in ISO 12021, and a circle after ISO 14792.

Circle: a steering robot keeps the curvature of the rear axle's path, and lateral acceleration rises so slowly that all
motion is steady. On a constant radius the slope of the steer angle over the acceleration is the understeer gradient.
"""

import dataclasses
import math
from typing import Final, NamedTuple

import numpy as np

from controllers.driver import DriverCommand
from offtrack.studies.standards.proving_ground import (
    KINDS,
    PERIOD,
    STANDARD,
    Conditions,
    Figures,
    Manoeuvre,
    Setting,
    SpeedHold,
    axle_paths,
    drive,
    drive_course,
    drive_programme,
    largest_load_transfer,
    lateral_acceleration,
    result,
)
from scenarios import courses
from scenarios.assembly.adapters import outlines
from scenarios.results.log import Log
from scenarios.results.swept_path import placed
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray
from vehicle.surface import Gust, Roughness, RoughProfile, Surface

CROSS_FALL: Final = 0.03  # to the right [-]
ROUGHNESS: Final = "B"  # ISO 8608
_LENGTH: Final = 1000.0  # [m]
_SETTLED: Final = 200.0  # distance in which the combination settles at its crab angle: 8 s, several periods [m]
_SEED: Final = 1  # of the road's profile, the same for every combination
_STATION: Final = 0.5  # between cross-sections [m]: the distance travelled per row of the log
_PERCENTILE: Final = 99.0  # of the widths, which leaves out single peaks: tracking ability in PBS, from memory [%]


def straight(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """One kilometre of straight road at 90 km/h with a driver who keeps the line."""
    at = KINDS["straight"].under(conditions)
    profile = RoughProfile(np.random.default_rng(_SEED), ROUGHNESS)
    driven = drive_course(
        vehicle,
        courses.straight(front_x=vehicle.units[0].steered_axles[0].x, length=_LENGTH),
        Surface(friction=at.friction, cross_fall=CROSS_FALL, roughness=Roughness(profile=profile)),
        speed=at.speed,
        trailer_steering=trailer_steering,
        done=lambda truth: bool(truth.poses[0, 0] >= _LENGTH),
    )
    return result(
        "straight",
        f"{3.6 * at.speed:g} km/h over 1000 m of straight road with 3 % cross-fall to the right and roughness of class "
        f"B in ISO 8608, friction {at.friction:g}. The width is the 99th percentile over 0.5 m of road each.",
        driven,
        lambda: _straight_figures(vehicle, driven.log),
    )


def _straight_figures(vehicle: Vehicle, log: Log) -> Figures:
    x = np.arange(_SETTLED, _LENGTH - vehicle.length, _STATION)
    # of each body over time, (4, n, 2) [m]
    corners = [placed(body.corners, body.poses(log)).transpose(1, 0, 2) for body in outlines(vehicle)]
    lateral = np.array([np.interp(x, *corner.T) for corner in np.concatenate(corners)])
    front, rear = (np.interp(x, *path.T) for path in axle_paths(vehicle, log))
    return {
        "tracking_width_m": float(np.percentile(np.ptp(lateral, axis=0), _PERCENTILE)),
        "tracking_offset_m": float(np.max(np.abs(rear - front))),
        "tracking_path_error_m": float(np.max(np.abs(front))),
    }


WIND: Final = 20.0  # [m/s]
_GUST_START: Final = 30.0  # of the gust, ahead of the foremost point [m]
_GUST_LENGTH: Final = 30.0  # of the gust [m]
_AFTER: Final = 2.0  # [s] from reaching the gust to the deviation, as of a driver who does not yet react
_DURATION: Final = 6.0  # [s] from there: the last unit has left the gust and swings


def crosswind(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Drive straight ahead with the steering held through a gust that pushes to the chosen side."""
    at = KINDS["crosswind"].under(conditions)
    gust = Gust(speed=at.side * WIND, start=vehicle.units[0].front_x + _GUST_START, length=_GUST_LENGTH)
    entered = _GUST_START / at.speed
    driven = drive_programme(
        vehicle,
        Surface(friction=at.friction, gust=gust),
        np.zeros(math.ceil((entered + _DURATION) / (PERIOD * TICK))),
        speed=at.speed,
        trailer_steering=trailer_steering,
    )
    return result(
        "crosswind",
        f"{3.6 * at.speed:g} km/h straight ahead, steering held, friction {at.friction:g}; wind of {WIND:g} m/s across "
        f"the road over {_GUST_LENGTH:g} m.",
        driven,
        lambda: _gust_figures(vehicle, driven.log, entered),
    )


def _gust_figures(vehicle: Vehicle, log: Log, entered: float) -> Figures:
    front, rear = axle_paths(vehicle, log)
    return {
        "crosswind_deviation_m": float(abs(np.interp(entered + _AFTER, log["time"], front[:, 1]))),
        "crosswind_last_deviation_m": float(np.max(np.abs(rear[:, 1] - np.interp(rear[:, 0], *front.T)))),
        "crosswind_yaw_rate_deg_s": float(np.degrees(np.max(np.abs(log[f"yaw_rate_{vehicle.units[-1].name}"])))),
        "crosswind_load_transfer": largest_load_transfer(vehicle, log),
    }


HIGHEST: Final = 0.25 * GRAVITY  # lateral acceleration at the end [m/s2]: below the rollover of laden vehicles
AT: Final = 0.2 * GRAVITY  # at which off-tracking and load transfer are measured [m/s2]
_LOWEST: Final = 0.02 * GRAVITY  # lateral acceleration at the start [m/s2]
_SETTLING: Final = 20.0  # at the start [s]: 90 m, several lengths
_RAMP: Final = 60.0  # of rising acceleration [s]: 0.004 g a second
_LINEAR: Final = (0.04 * GRAVITY, 0.1 * GRAVITY)  # range of the understeer gradient [m/s2]
_AROUND: Final = 0.02 * GRAVITY  # of the gradient at 0.2 g to either side [m/s2]
_GAIN: Final = 2.0  # of the curvature's integral control [1/s]: slow beside tyres and yaw


class _Memory(NamedTuple):
    """State of the robot."""

    held: float  # acceleration that holds the speed [m/s2]
    steer: float  # [rad]


class _CircleRobot:
    """Keeps a curvature while lateral acceleration rises steadily."""

    def __init__(self, tractor: Unit, curvature: float) -> None:
        """Drive the ``curvature`` [1/m], + left, with this tractor."""
        self._wheelbase, self._curvature = tractor.steered_axles[0].x, curvature

    def init(self) -> _Memory:
        """Memory before the first step."""
        return _Memory(0.0, math.atan(self._wheelbase * self._curvature))

    def step(self, memory: _Memory, tick: int, ego: EgoState) -> tuple[_Memory, DriverCommand]:
        """New memory and command at ``tick``."""
        speed = set_speed(tick * TICK, 1.0 / abs(self._curvature))
        held, acceleration = SpeedHold.step(memory.held, speed - ego.v_x, PERIOD * TICK)
        error = self._curvature - ego.yaw_rate / max(ego.v_x, 1.0)
        steer = memory.steer + _GAIN * self._wheelbase * error * PERIOD * TICK
        return _Memory(held, steer), DriverCommand(steer=steer, acceleration=acceleration)


def set_speed(time: float, radius: float) -> float:
    """Speed [m/s] at a time [s] from the start."""
    share = min(max((time - _SETTLING) / _RAMP, 0.0), 1.0)
    return math.sqrt((_LOWEST + share * (HIGHEST - _LOWEST)) * radius)


def steady_circle(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Circle of constant radius, driven faster and faster up to 0.25 g."""
    at = KINDS["steady_circle"].under(conditions)
    driven = drive(
        vehicle,
        at.surface,
        _CircleRobot(vehicle.units[0], at.side / at.radius),
        trailer_steering=trailer_steering,
        speed=set_speed(0.0, at.radius),
        done=lambda truth: truth.tick * TICK >= _SETTLING + _RAMP,
        patience=2.0 * (_SETTLING + _RAMP),
    )
    reached = float(np.max(steer_over_acceleration(vehicle, driven.log)[0], initial=0.0))
    if driven.outcome == "completed" and reached < AT + _AROUND:  # for lack of power, or of friction
        driven = dataclasses.replace(driven, outcome=f"did not reach {(AT + _AROUND) / GRAVITY:.2f} g")
    return result(
        "steady_circle",
        f"Circle of {at.radius:g} m to the {at.hand}, lateral acceleration rising from 0.02 to 0.25 g in {_RAMP:g} s, "
        f"friction {at.friction:g}; constant-radius test after ISO 14792.",
        driven,
        lambda: _circle_figures(vehicle, driven.log, at),
    )


def steer_over_acceleration(vehicle: Vehicle, log: Log) -> tuple[FloatArray, FloatArray]:
    """Lateral acceleration of the tractor [m/s2] and its steer angle [rad] over time, + into the turn."""
    tractor, settled = vehicle.units[0], log["time"] > _SETTLING
    acceleration = lateral_acceleration(log, tractor.name, tractor.cg_x)[settled]
    side = np.sign(acceleration[-1]) if len(acceleration) else 1.0
    return side * acceleration, side * log["steer_tractor"][settled]


def _circle_figures(vehicle: Vehicle, log: Log, at: Setting) -> Figures:
    acceleration, steer = steer_over_acceleration(vehicle, log)
    row = len(log) - len(acceleration) + int(np.argmin(np.abs(acceleration - AT)))
    first, last = vehicle.units[0], vehicle.units[-1]

    def slope(low: float, high: float) -> float:
        within = (acceleration >= low) & (acceleration <= high)
        return math.degrees(float(np.polyfit(acceleration[within], steer[within], 1)[0])) * GRAVITY

    def radius(unit: Unit, x: float) -> float:
        """Radius of the path of a point on a unit's axis at 0.2 g [m]."""
        v_x, v_y, r = (float(log[f"{name}_{unit.name}"][row]) for name in ("v_x", "v_y", "yaw_rate"))
        return math.hypot(v_x, v_y + x * r) / abs(r)

    return {
        "understeer_gradient_deg_per_g": slope(*_LINEAR),
        "understeer_gradient_at_0_2_g_deg_per_g": slope(AT - _AROUND, AT + _AROUND),
        "circle_steer_deg": math.degrees(float(at.side * log["steer_tractor"][row])),
        "circle_off_tracking_m": radius(first, first.steered_axles[0].x) - radius(last, last.axles[-1].x),
        "circle_load_transfer": max(abs(float(log[f"load_transfer_{unit.name}"][row])) for unit in vehicle.units),
    }
