"""Rollover thresholds by slow ramps: of the ground on a tilt table, and of the steer angle in a closing curve.

Of a vehicle without suspensions, whose plant has fixed shares of the roll moment per axle, it is tilted until the first
wheel lifts, and the threshold is extrapolated: from the load transfer of a unit before that to a load transfer of 1.

The ramp goes on until a body has fallen beyond return, which takes a second or two after the equilibrium is lost. So
the threshold is found by holding levels of the ramp, each from the state in which the ramp passed it: the highest at
which the combination stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from offtrack.studies.standards.proving_ground import (
    PERIOD,
    STANDARD,
    Conditions,
    Figures,
    Manoeuvre,
    drive_log,
    measured,
)
from scenarios.results.log import Log, Signal
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.linear import lateral_model
from vehicle.combination.plant import DivergedError, Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

_FALLEN: Final = math.radians(30.0)  # body roll; laden heavy vehicles lose their balance at 5 to 12 deg
_HELD: Final = 16.0  # [s] a level is held; bodies whose axles have lifted swing once in 10 s, and a fall takes 4 s
_RESTING: Final = 1e-4  # [rad] change of the rolls in a second below which it stands
_CRUISE_GAIN: Final = 2.0  # acceleration demand per speed error [1/s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp:
    """A level that rises slowly."""

    surface: Callable[[float], Surface]  # by level
    steer: Callable[[float], float]  # road-wheel angle [rad] by level
    slope: Callable[[float], float]  # of the ground [-] by level
    speed: float  # [m/s]
    rate: float  # of the level [1/s]
    highest: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tipping:
    """A ramp driven until the combination fell, and the highest level that it holds."""

    outcome: str  # "completed": it fell
    levels: FloatArray  # (n,)
    truths: list[Truth]  # n, one at each level
    held: int  # number of the highest level at which it stands
    steady: Truth  # after standing there


class _Run:
    """Steps of a combination under a level."""

    def __init__(self, vehicle: Vehicle, ramp: Ramp) -> None:
        self.vehicle, self.ramp = vehicle, ramp
        self.idle = (0.0,) * vehicle.n_by_law

    def plant(self, level: float) -> Plant:
        return Plant(self.vehicle, self.ramp.surface(level))

    def step(self, plant: Plant, state: FloatArray, truth: Truth, level: float, ticks: int = PERIOD) -> FloatArray:
        speed = self.ramp.speed
        push = _CRUISE_GAIN * (speed - float(truth.velocities[0, 0])) if speed else 0.0
        return plant.step(state, VehicleCommand(self.ramp.steer(level), push, self.idle), ticks)

    def rolls(self, truth: Truth, level: float) -> FloatArray:
        """Roll of every body over the ground [rad]."""
        bank = math.atan(self.ramp.slope(level))
        return np.arctan2(truth.bodies[:, 2, 1], truth.bodies[:, 2, 2]) - bank

    def fallen(self, truth: Truth, level: float) -> bool:
        return bool(np.abs(self.rolls(truth, level)).max() > _FALLEN)

    def stands(self, state: FloatArray, level: float, tick: int) -> Truth | None:
        """Ground truth after standing at a level; None if it falls."""
        plant = self.plant(level)
        truth = plant.observe(state, tick)
        rolls = [self.rolls(truth, level)]  # once a second
        for k in range(1, round(_HELD / TICK / PERIOD) + 1):
            try:
                state = self.step(plant, state, truth, level)
            except DivergedError:
                return None
            truth = plant.observe(state, tick + k * PERIOD)
            if self.fallen(truth, level):
                return None
            if k * PERIOD % round(1.0 / TICK) == 0:
                rolls.append(self.rolls(truth, level))
                if np.abs(rolls[-1] - rolls[-2]).max() < _RESTING:
                    return truth
        return None if falls(np.abs(rolls).max(axis=1)) else truth


def falls(leans: FloatArray) -> bool:
    """True if the largest lean of the bodies, one a second, ends beyond all before and grows ever faster.

    Near the threshold a combination falls slowly. One that stands on few axles swings about its equilibrium for long.
    """
    last, leaning = np.diff(leans)[-2:]
    return bool(leans[-1] > leans[:-1].max() and leaning > max(float(last), _RESTING))


def driven(vehicle: Vehicle, ramp: Ramp) -> Tipping:
    """Drive the ramp until the combination falls, and search the highest level that it holds."""
    run = _Run(vehicle, ramp)
    state = run.plant(0.0).initial_state(Pose2(0.0, 0.0, 0.0), ramp.speed)
    states: list[FloatArray] = []
    truths: list[Truth] = []
    step = ramp.rate * PERIOD * TICK
    levels: FloatArray = step * np.arange(math.ceil(ramp.highest / step), dtype=np.float64)
    outcome = "did not tip"
    for k, level in enumerate(levels.tolist()):
        plant = run.plant(level)
        states.append(state)
        truths.append(plant.observe(state, PERIOD * k))
        if run.fallen(truths[-1], level):
            outcome = "completed"
            break
        try:
            state = run.step(plant, state, truths[-1], level)
        except DivergedError:
            outcome = "diverged"
            break
    levels = levels[: len(truths)]
    held, steady = _highest_held(run, levels, states) if outcome == "completed" else (len(truths) - 1, truths[-1])
    return Tipping(outcome=outcome, levels=levels, truths=truths, held=held, steady=steady)


def _highest_held(run: _Run, levels: FloatArray, states: list[FloatArray]) -> tuple[int, Truth]:
    """Number of the highest level at which it stands, by bisection, and the ground truth there."""
    low, high = 0, len(levels) - 1
    steady = run.plant(0.0).observe(states[0], 0)
    while high - low > 1:
        middle = (low + high) // 2
        truth = run.stands(states[middle], float(levels[middle]), PERIOD * middle)
        if truth is None:
            high = middle
        else:
            low, steady = middle, truth
    return low, steady


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
    idle = VehicleCommand(0.0, 0.0, (0.0,) * vehicle.n_by_law)
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


CURVE_SPEED: Final = 60.0 / 3.6  # [m/s]
CURVE_NAMES: Final = ("curve_rollover_g", "curve_rollover_roll_rad", "curve_rollover_steer_rad")

_JERK: Final = 0.2  # [m/s3] of the lateral acceleration at first: it follows without lag, within 1 % of the threshold
_CURVE_FRICTION: Final = 0.8  # a dry road [-]
_LARGEST: Final = math.radians(30.0)  # steer angle [rad]


def closing_curve(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Steer slowly further into a curve at constant speed until the combination falls."""
    speed, friction = conditions.speed_or(CURVE_SPEED), conditions.friction_or(_CURVE_FRICTION)
    model = lateral_model(vehicle, speed, outputs=("lateral_acceleration",))
    gain = abs(model.steady_gain("lateral_acceleration_0"))
    ramp = Ramp(
        surface=lambda _: Surface(friction=friction),
        steer=lambda angle: conditions.side * angle,
        slope=lambda _: 0.0,
        speed=speed,
        rate=_JERK / gain,
        highest=_LARGEST,
    )
    tipping = driven(vehicle, ramp)
    demand = Signal("steer_demand", "rad", "demanded road-wheel angle, + left")
    log = drive_log(vehicle, tipping.truths).with_columns([(demand, conditions.side * tipping.levels)])
    return Manoeuvre(
        key="closing_curve",
        title="Rollover in a closing curve",
        how=f"{3.6 * speed:g} km/h and friction {friction:g}; the steer angle grows slowly, at first by {_JERK:g} m/s³ "
        "of lateral acceleration, until the combination falls. The threshold is the lateral acceleration at the "
        "largest steer angle that it holds, the mean of its units by mass.",
        outcome=tipping.outcome,
        figures=measured(CURVE_NAMES, tipping.outcome, lambda: _curve_figures(vehicle, tipping, log)),
        log=log,
    )


def _curve_figures(vehicle: Vehicle, tipping: Tipping, log: Log) -> Figures:
    truth = tipping.steady
    masses = np.array([unit.mass for unit in vehicle.units])
    # In a steady turn the acceleration of each centre of gravity towards the turning centre, along the unit's y axis.
    accelerations = truth.velocities[:, 0] * truth.velocities[:, 2]
    rolls = np.arctan2(truth.bodies[:, 2, 1], truth.bodies[:, 2, 2])
    return {
        "curve_rollover_g": float(abs(masses @ accelerations) / masses.sum() / GRAVITY),
        "curve_rollover_roll_rad": float(np.abs(rolls).max()),
        "curve_rollover_steer_rad": float(tipping.levels[tipping.held]),
    }
