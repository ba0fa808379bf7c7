"""Straight driving: swept width on a rough road with cross-fall, and a gust as in ISO 12021."""

from __future__ import annotations

from typing import Final

import numpy as np

from controllers.driver import PreviewDriver
from offtrack.studies.standards.proving_ground import (
    PERIOD,
    STANDARD,
    Conditions,
    Figures,
    Manoeuvre,
    SteerProgramme,
    drive,
    measured,
    point_path,
    poses,
)
from scenarios.assembly.adapters import outlines, tractor_geometry
from scenarios.courses import straight as straight_course
from scenarios.results.log import Log
from scenarios.results.swept_path import placed
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.surface import Gust, Roughness, RoughProfile, Surface

SPEED: Final = 90.0 / 3.6  # [m/s]
CROSS_FALL: Final = 0.03  # to the right [-]
ROUGHNESS: Final = "B"  # ISO 8608
NAMES: Final = ("tracking_width_m", "tracking_offset_m", "tracking_path_error_m")

_FRICTION: Final = 0.8  # a dry road [-]
_LENGTH: Final = 1000.0  # [m]
_SETTLED: Final = 200.0  # distance in which the combination settles at its crab angle: 8 s, several periods [m]
_SEED: Final = 1  # of the road's profile, the same for every combination
_STATION: Final = 0.5  # between cross-sections [m]: the distance travelled per row of the log
_PERCENTILE: Final = 99.0  # of the widths, which leaves out single peaks: tracking ability in PBS, from memory [%]


def straight(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """One kilometre of straight road at 90 km/h with a driver who keeps the line."""
    axle_x = vehicle.units[0].steered_axles[0].x
    speed, friction = conditions.speed_or(SPEED), conditions.friction_or(_FRICTION)
    course = straight_course(front_x=axle_x, length=_LENGTH)
    surface = Surface(
        friction=friction,
        cross_fall=CROSS_FALL,
        roughness=Roughness(profile=RoughProfile(np.random.default_rng(_SEED), ROUGHNESS)),
    )
    driven = drive(
        vehicle,
        surface,
        PreviewDriver(tractor_geometry(vehicle, course), course.path, speed),
        trailer_steering=trailer_steering,
        speed=speed,
        done=lambda truth: bool(truth.poses[0, 0] >= _LENGTH),
        patience=2.0 * _LENGTH / speed,
    )
    return Manoeuvre(
        key="straight",
        title="Tracking on a straight road",
        how=f"{3.6 * speed:g} km/h over 1000 m of straight road with 3 % cross-fall to the right and roughness of "
        f"class B in ISO 8608, friction {friction:g}. The width is the 99th percentile over 0.5 m of road each.",
        outcome=driven.outcome,
        figures=measured(NAMES, driven.outcome, lambda: _figures(vehicle, driven.log)),
        log=driven.log,
    )


def _figures(vehicle: Vehicle, log: Log) -> Figures:
    x = np.arange(_SETTLED, _LENGTH - vehicle.length, _STATION)
    corners = [
        placed(body.corners, poses(log, body.name)).transpose(1, 0, 2)  # (4, n, 2)
        for body in outlines(vehicle)
    ]
    lateral = np.array([np.interp(x, *corner.T) for corner in np.concatenate(corners)])
    first, last = vehicle.units[0], vehicle.units[-1]
    front = point_path(log, first.name, first.steered_axles[0].x)
    rear = point_path(log, last.name, last.axles[-1].x)
    return {
        "tracking_width_m": float(np.percentile(np.ptp(lateral, axis=0), _PERCENTILE)),
        "tracking_offset_m": float(np.max(np.abs(np.interp(x, *rear.T) - np.interp(x, *front.T)))),
        "tracking_path_error_m": float(np.max(np.abs(np.interp(x, *front.T)))),
    }


GUST_ROAD_SPEED: Final = 80.0 / 3.6  # [m/s]
WIND: Final = 20.0  # [m/s]
GUST_NAMES: Final = (
    "crosswind_deviation_m",
    "crosswind_last_deviation_m",
    "crosswind_yaw_rate_deg_s",
    "crosswind_load_transfer",
)

_GUST_FRICTION: Final = 0.8  # a dry road [-]
_GUST_START: Final = 30.0  # of the gust, ahead of the foremost point [m]
_GUST_LENGTH: Final = 30.0  # of the gust [m]
_AFTER: Final = 2.0  # [s] from reaching the gust to the deviation, as of a driver who does not yet react
_DURATION: Final = 6.0  # [s] from there: the last unit has left the gust and swings


def crosswind(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Drive straight ahead with the steering held through a gust that pushes to the chosen side."""
    speed, friction = conditions.speed_or(GUST_ROAD_SPEED), conditions.friction_or(_GUST_FRICTION)
    start = vehicle.units[0].front_x + _GUST_START
    gust = Gust(speed=conditions.side * WIND, start=start, length=_GUST_LENGTH)
    entered = _GUST_START / speed
    driven = drive(
        vehicle,
        Surface(friction=friction, gust=gust),
        SteerProgramme(np.zeros(1), speed, PERIOD),
        trailer_steering=trailer_steering,
        speed=speed,
        done=lambda truth: truth.tick * TICK >= entered + _DURATION,
        patience=2.0 * (entered + _DURATION),
    )
    return Manoeuvre(
        key="crosswind",
        title="Gust across the road",
        how=f"{3.6 * speed:g} km/h straight ahead, steering held, friction {friction:g}; wind of {WIND:g} m/s "
        f"across the road over {_GUST_LENGTH:g} m.",
        outcome=driven.outcome,
        figures=measured(GUST_NAMES, driven.outcome, lambda: _gust_figures(vehicle, driven.log, entered)),
        log=driven.log,
    )


def _gust_figures(vehicle: Vehicle, log: Log, entered: float) -> Figures:
    first, last = vehicle.units[0], vehicle.units[-1]
    front = point_path(log, first.name, first.steered_axles[0].x)
    rear = point_path(log, last.name, last.axles[-1].x)
    time = log["time"]
    return {
        "crosswind_deviation_m": float(abs(np.interp(entered + _AFTER, time, front[:, 1]))),
        "crosswind_last_deviation_m": float(np.max(np.abs(rear[:, 1] - np.interp(rear[:, 0], *front.T)))),
        "crosswind_yaw_rate_deg_s": float(np.degrees(np.max(np.abs(log[f"yaw_rate_{last.name}"])))),
        "crosswind_load_transfer": max(float(np.max(np.abs(log[f"load_transfer_{u.name}"]))) for u in vehicle.units),
    }
