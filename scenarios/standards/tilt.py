"""Static rollover threshold: the ground is tilted until the combination falls.

Of a vehicle without suspensions, whose plant has fixed shares of the roll moment per axle, it is tilted until the first
wheel lifts, and the threshold is extrapolated: from the load transfer of a unit before that to a load transfer of 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from scenarios.results.log import Log, Signal
from scenarios.standards.conditions import STANDARD, Conditions
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.proving_ground import PERIOD, drive_log
from scenarios.standards.ramp import Ramp, Tipping, driven
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.plant import DivergedError, Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

NAMES: Final = ("rollover_threshold_g", "rollover_acceleration_m_s2", "wheel_lift_g", "wheel_lift_roll_rad")

_RATE: Final = 0.02  # of the slope [1/s]: about 1 deg/s; the body's roll lags by less than 0.1 %
_STEEPEST: Final = 1.0  # [-], 45 deg: every road vehicle tips before
_FRICTION: Final = 1.5  # [-]; on a real tilt table a rail stops sliding wheels
_LIFTED: Final = 0.005  # load of a lifted wheel over the mean load; the plant keeps some newtons on it
_SETTLED: Final = 0.8  # the extrapolation uses slopes above this share of the last one


@dataclass(frozen=True, slots=True, kw_only=True)
class TiltTable(Surface):
    """A plane of any slope."""

    def __post_init__(self) -> None:
        """Skip the limits of a road: its slope is at most 0.2."""


def tilt(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Tilt the combination on a table, left side up."""
    if vehicle.has_springs:
        return _tipped(vehicle)
    slopes, truths, outcome = _tilted(vehicle)
    log = _log(vehicle, slopes, truths)
    return _manoeuvre(
        "Standing on a plane that tilts by about 1° per second until the first wheel lifts. The slope at which the "
        "extrapolated load transfer of a unit is 1 equals the lateral acceleration in g that tips it.",
        outcome,
        measured(NAMES, outcome, lambda: _figures(vehicle, log, min(threshold(log, u.name) for u in vehicle.units))),
        log,
    )


def _tipped(vehicle: Vehicle) -> Manoeuvre:
    """Tilt until the combination falls; the threshold is the steepest slope on which it stands."""
    table = Ramp(
        surface=lambda slope: TiltTable(friction=_FRICTION, cross_fall=slope),
        steer=lambda _: 0.0,
        slope=lambda slope: slope,
        speed=0.0,
        rate=_RATE,
        highest=_STEEPEST,
    )
    tipping = driven(vehicle, table)
    log = _log(vehicle, tipping.levels, tipping.truths)
    return _manoeuvre(
        "Standing on a plane that tilts by about 1° per second until the combination falls. The threshold is the "
        "steepest slope on which it stands. The lateral acceleration in g that tips it in a turn is up to 4 % less, as "
        "the weight across a slope, and the roll that it adds, are less than on the level.",
        tipping.outcome,
        measured(
            NAMES, tipping.outcome, lambda: _figures(vehicle, log, float(tipping.levels[tipping.held]), _first(tipping))
        ),
        log,
    )


def _manoeuvre(how: str, outcome: str, figures: Figures, log: Log) -> Manoeuvre:
    title = "Static rollover threshold"
    return Manoeuvre(key="tilt", title=title, how=how, outcome=outcome, figures=figures, log=log)


def _log(vehicle: Vehicle, slopes: FloatArray, truths: list[Truth]) -> Log:
    slope = Signal("slope", "-", "lateral slope of the table, + left side up")
    return drive_log(vehicle, truths).with_columns([(slope, slopes)])


def _first(tipping: Tipping) -> int:
    """Row in which the first wheel lifts."""
    loads = np.array([truth.wheel_loads for truth in tipping.truths])
    return int(np.argmax(loads.min(axis=1) <= _LIFTED * loads.mean(axis=1)))


def _tilted(vehicle: Vehicle) -> tuple[FloatArray, list[Truth], str]:
    """Slopes, the truth at each of them, and the outcome."""
    idle = VehicleCommand(0.0, 0.0, (0.0,) * sum(len(unit.steered_axles) for unit in vehicle.units[1:]))
    state = Plant(vehicle, TiltTable(friction=_FRICTION)).initial_state(Pose2(0.0, 0.0, 0.0), 0.0)
    slopes: list[float] = []
    truths: list[Truth] = []
    for k in range(math.ceil(_STEEPEST / (_RATE * PERIOD * TICK))):
        slopes.append(_RATE * PERIOD * TICK * k)
        plant = Plant(vehicle, TiltTable(friction=_FRICTION, cross_fall=slopes[-1]))
        truths.append(plant.observe(state, PERIOD * k))
        loads = truths[-1].wheel_loads
        if loads.min() <= _LIFTED * loads.mean():
            return np.array(slopes), truths, "completed"
        try:
            state = plant.step(state, idle, PERIOD)
        except DivergedError:
            return np.array(slopes), truths, "diverged"
    return np.array(slopes), truths, "did not tip"


def threshold(log: Log, unit: str) -> float:
    """Slope [-] at which the load transfer of a unit, extrapolated from before the first wheel lifts, is 1."""
    slope, transfer = log["slope"], np.abs(log[f"load_transfer_{unit}"])
    settled = slope >= _SETTLED * slope[-1]
    gain, offset = np.polyfit(slope[settled], transfer[settled], 1)
    return float((1.0 - offset) / gain)


def _figures(vehicle: Vehicle, log: Log, tipping: float, lifts: int = -1) -> Figures:
    """Figures with the threshold [-] and the row in which the first wheel lifts."""
    slope = float(log["slope"][lifts])
    rolls = [abs(float(log[f"roll_{unit.name}"][lifts]) - math.atan(slope)) for unit in vehicle.units]
    return {
        "rollover_threshold_g": tipping,
        "rollover_acceleration_m_s2": GRAVITY * tipping,
        "wheel_lift_g": slope,
        "wheel_lift_roll_rad": max(rolls),
    }
