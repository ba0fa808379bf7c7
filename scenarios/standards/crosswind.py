"""Gust across the road with the steering held, as in ISO 12021: deviation, yaw rate and load transfer."""

from __future__ import annotations

from typing import Final

import numpy as np

from scenarios.results.log import Log
from scenarios.standards.conditions import STANDARD, Conditions
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.motion import point_path
from scenarios.standards.pilots import SteerProgramme
from scenarios.standards.proving_ground import PERIOD, drive
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.surface import Gust, Surface

SPEED: Final = 80.0 / 3.6  # [m/s]
WIND: Final = 20.0  # [m/s]
NAMES: Final = (
    "crosswind_deviation_m",
    "crosswind_last_deviation_m",
    "crosswind_yaw_rate_deg_s",
    "crosswind_load_transfer",
)

_FRICTION: Final = 0.8  # a dry road [-]
_START: Final = 30.0  # of the gust, ahead of the foremost point [m]
_LENGTH: Final = 30.0  # of the gust [m]
_AFTER: Final = 2.0  # [s] from reaching the gust to the deviation, as of a driver who does not yet react
_DURATION: Final = 6.0  # [s] from there: the last unit has left the gust and swings


def crosswind(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Drive straight ahead with the steering held through a gust that pushes to the chosen side."""
    speed, friction = conditions.speed_or(SPEED), conditions.friction_or(_FRICTION)
    start = vehicle.units[0].front_x + _START
    gust = Gust(speed=conditions.side * WIND, start=start, length=_LENGTH)
    entered = _START / speed
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
        f"across the road over {_LENGTH:g} m.",
        outcome=driven.outcome,
        figures=measured(NAMES, driven.outcome, lambda: _figures(vehicle, driven.log, entered)),
        log=driven.log,
    )


def _figures(vehicle: Vehicle, log: Log, entered: float) -> Figures:
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
