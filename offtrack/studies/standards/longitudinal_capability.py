"""Longitudinal capability by simulation: starting and climbing, speed on a grade, acceleration, holding downhill.

Each quantity is the grade or speed at which the simulated combination neither gains nor loses speed; acceleration is
driven in full. Gears are a continuous ratio, so no time is lost by shifting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq

from offtrack.studies.standards.proving_ground import (
    PERIOD,
    STANDARD,
    Conditions,
    Figures,
    Manoeuvre,
    drive_log,
    measured,
)
from scenarios.results.log import Log
from vehicle.clock import TICK
from vehicle.combination import handling as theory
from vehicle.combination.actuators import retarder_capacity
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import Pose2
from vehicle.surface import Surface

NAMES: Final = (
    "startability",
    "gradeability",
    "gradeability_speed_m_s",
    "acceleration_100_m_s",
    "holding_grade",
)
GRADEABILITY_SPEED: Final = 10.0 / 3.6  # at which the steepest grade is kept [m/s]
GRADE: Final = 0.01  # on which the speed is measured [-]
HOLDING_SPEED: Final = 30.0 / 3.6  # [m/s]
DISTANCE: Final = 100.0  # of the acceleration test [m]

_FULL: Final = 20.0  # full throttle [m/s2]; the plant limits it
_SETTLE: Final = 3000  # until force and loads have settled [ticks]
_SPAN: Final = 1000  # over which the gain of speed is measured [ticks]
_RESOLUTION: Final = 1e-4  # of grades [-] and speeds [m/s]
_WALKING: Final = 1.0  # speed at which startability is measured, clutch slipping [m/s]
_LONGEST: Final = 120.0  # of the acceleration test [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Incline(Surface):
    """A plane of any grade."""

    def __post_init__(self) -> None:
        """Skip the limits of a road: its grade is at most 0.2."""


def longitudinal(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Starting, climbing, accelerating and holding the combination, straight ahead."""
    friction = conditions.friction_or(theory.DRY)
    truths = _accelerated(vehicle, friction)
    log = drive_log(vehicle, truths)
    outcome = "completed" if truths[-1].poses[0, 0] >= DISTANCE else "timed out"
    return Manoeuvre(
        key="longitudinal",
        title="Longitudinal capability",
        how=f"Full throttle, friction {friction:g}: grades on which it keeps {_WALKING:g} m/s and "
        f"{3.6 * GRADEABILITY_SPEED:g} km/h, speed on {100.0 * GRADE:g} %, time from rest over {DISTANCE:g} m of level "
        "road, no shifts of gear. Downhill: grade on which the endurance brake alone keeps "
        f"{3.6 * HOLDING_SPEED:g} km/h.",
        outcome=outcome,
        figures=measured(NAMES, outcome, lambda: _figures(vehicle, friction, log)),
        log=log,
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


def _figures(vehicle: Vehicle, friction: float, log: Log) -> Figures:
    station = log[f"x_{vehicle.units[0].name}"]
    figures = {
        "startability": _root(lambda grade: _gain(vehicle, friction, grade, _WALKING, _FULL), 0.0, 1.0),
        "gradeability": _root(lambda grade: _gain(vehicle, friction, grade, GRADEABILITY_SPEED, _FULL), 0.0, 1.0),
        "gradeability_speed_m_s": _root(lambda v: _gain(vehicle, friction, GRADE, v, _FULL), 1.0, 60.0),
        "acceleration_100_m_s": float(np.interp(DISTANCE, station, log["time"])),
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
    plant = Plant(vehicle, Incline(friction=friction, grade=grade))
    state = plant.step(plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), _command(vehicle, demand), _SETTLE)
    before = plant.observe(state, 0).velocities[0, 0]
    after = plant.observe(plant.step(state, _command(vehicle, demand), _SPAN), 0).velocities[0, 0]
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
