"""Static rollover threshold: the ground tilted until one side of a unit carries nothing.

The first wheel to lift is usually not the last: an axle that can take no more leaves the rest of the roll moment to the
others. The plant has fixed shares of it for the axles, so the threshold is where the load transfer of a unit, carried
on in proportion from before the first wheel lifted, has become the whole load.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from scenarios.results.log import Log, Signal
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.proving_ground import PERIOD, drive_log
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.plant import DivergedError, Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

NAMES: Final = ("rollover_threshold_g", "rollover_acceleration_m_s2", "wheel_lift_g", "wheel_lift_roll_rad")

_RATE: Final = 0.02  # of the slope: about 1 deg/s, through which a body's roll follows within a thousandth [1/s]
_STEEPEST: Final = 1.0  # [-], 45 deg: no road vehicle stands on more, and its tyres would slide off
_FRICTION: Final = 1.5  # [-]; on a tilt table a rail keeps wheels from sliding
_LIFTED: Final = 0.005  # load of a wheel over the mean of all: the plant leaves some newtons to one in the air
_SETTLED: Final = 0.8  # share of the tilt from which on the load transfer is carried on in proportion


@dataclass(frozen=True, slots=True, kw_only=True)
class TiltTable(Surface):
    """A plane as steep as one likes."""

    def __post_init__(self) -> None:
        """Roads end at a slope of 0.2, tables do not."""


def tilt(vehicle: Vehicle) -> Manoeuvre:
    """The combination on a tilting table, its left side going up."""
    slopes, truths, outcome = _tilted(vehicle)
    log = drive_log(vehicle, truths).with_signals(
        [Signal("slope", "-", "of the table across, + left side up")], [slopes]
    )
    return Manoeuvre(
        key="tilt",
        title="Static rollover threshold",
        how="Standing on a plane that tilts by about 1° a second until the first wheel lifts; where a unit's load "
        "transfer, carried on in proportion, becomes 1, the slope is the lateral acceleration in g that tips it.",
        outcome=outcome,
        figures=measured(NAMES, outcome, lambda: _figures(vehicle, log)),
        log=log,
    )


def _tilted(vehicle: Vehicle) -> tuple[FloatArray, list[Truth], str]:
    """Slopes, what was so at each of them, and the outcome."""
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
    """Slope at which the load transfer of a unit becomes 1, carried on from before the first wheel lifted [-]."""
    slope, transfer = log["slope"], np.abs(log[f"load_transfer_{unit}"])
    settled = slope >= _SETTLED * slope[-1]
    gain, offset = np.polyfit(slope[settled], transfer[settled], 1)
    return float((1.0 - offset) / gain)


def _figures(vehicle: Vehicle, log: Log) -> Figures:
    tipping = min(threshold(log, unit.name) for unit in vehicle.units)
    slope = float(log["slope"][-1])
    rolls = [abs(float(log[f"roll_{unit.name}"][-1]) - math.atan(slope)) for unit in vehicle.units]
    return {
        "rollover_threshold_g": tipping,
        "rollover_acceleration_m_s2": GRAVITY * tipping,
        "wheel_lift_g": slope,
        "wheel_lift_roll_rad": max(rolls),
    }
