"""Rollover thresholds by slow ramps: of the ground on a tilt table, and of the steer angle in a closing curve.

Of a vehicle without suspensions, whose plant has fixed shares of the roll moment per axle, it is tilted until the first
wheel lifts, and the threshold is extrapolated: from the load transfer of a unit before that to a load transfer of 1.

The ramp goes on until a body has fallen beyond return, which takes a second or two after the equilibrium is lost. So
the threshold is found by holding levels of the ramp, each from the state in which the ramp passed it: the highest at
which the combination stands.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from offtrack.studies.standards.braking_and_drive import Incline
from offtrack.studies.standards.proving_ground import (
    KINDS,
    PERIOD,
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    drive_log,
    result,
)
from scenarios.results.log import Log, Signal
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.functions import with_numbers
from vehicle.combination.handling import static_rollover_threshold
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
    """A combination under a level that rises slowly."""

    vehicle: Vehicle
    surface: Callable[[float], Surface]  # by level
    steer: Callable[[float], float] = lambda level: 0.0  # road-wheel angle [rad] by level
    slope: Callable[[float], float] = lambda level: 0.0  # of the ground [-] by level
    speed: float = 0.0  # [m/s]
    rate: float  # of the level [1/s]
    highest: float

    def plant(self, level: float) -> Plant:
        """The plant at a level."""
        return Plant(self.vehicle, self.surface(level))

    def step(self, plant: Plant, state: FloatArray, truth: Truth, level: float) -> FloatArray:
        """State after a period at a level."""
        push = _CRUISE_GAIN * (self.speed - float(truth.velocities[0, 0])) if self.speed else 0.0
        return plant.step(state, VehicleCommand(self.steer(level), push, (0.0,) * self.vehicle.n_by_law), PERIOD)

    def rolls(self, truth: Truth, level: float) -> FloatArray:
        """Roll of every body over the ground [rad]."""
        return np.arctan2(truth.bodies[:, 2, 1], truth.bodies[:, 2, 2]) - math.atan(self.slope(level))

    def fallen(self, truth: Truth, level: float) -> bool:
        """True if a body has fallen beyond return."""
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


class Ascent(NamedTuple):
    """A ramp until its end."""

    outcome: str  # "completed": it ended as it should
    levels: FloatArray  # (n,)
    states: list[FloatArray]  # n, one at each level
    truths: list[Truth]


def driven(ramp: Ramp, ended: Callable[[Truth, float], bool]) -> Ascent:
    """Drive the ramp until the combination has ``ended`` as it should."""
    state = ramp.plant(0.0).initial_state(Pose2(0.0, 0.0, 0.0), ramp.speed)
    states: list[FloatArray] = []
    truths: list[Truth] = []
    step = ramp.rate * PERIOD * TICK
    levels: FloatArray = step * np.arange(math.ceil(ramp.highest / step), dtype=np.float64)
    outcome = "did not tip"
    for k, level in enumerate(levels.tolist()):
        plant = ramp.plant(level)
        states.append(state)
        truths.append(plant.observe(state, PERIOD * k))
        if ended(truths[-1], level):
            outcome = "completed"
            break
        try:
            state = ramp.step(plant, state, truths[-1], level)
        except DivergedError:
            outcome = "diverged"
            break
    return Ascent(outcome, levels[: len(truths)], states, truths)


def highest_held(ramp: Ramp, ascent: Ascent) -> tuple[float, Truth]:
    """The highest level at which it stands, by bisection, and the ground truth there."""
    low, high = 0, len(ascent.levels) - 1
    steady = ascent.truths[0]
    while high - low > 1:
        middle = (low + high) // 2
        truth = ramp.stands(ascent.states[middle], float(ascent.levels[middle]), PERIOD * middle)
        if truth is None:
            high = middle
        else:
            low, steady = middle, truth
    return float(ascent.levels[low]), steady


_RATE: Final = 0.02  # of the slope [1/s]: about 1 deg/s; the body's roll lags by less than 0.1 %
_STEEPEST: Final = 1.0  # [-], 45 deg: every road vehicle tips before
_FRICTION: Final = 1.5  # [-]; on a real tilt table a rail stops sliding wheels
_LIFTED: Final = 0.005  # load of a lifted wheel over the mean load; the plant keeps some newtons on it
_SETTLED: Final = 0.8  # the extrapolation uses slopes above this share of the last one


def tilt(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Tilt the combination on a table, left side up."""
    table = Ramp(
        vehicle=vehicle,
        surface=lambda slope: Incline(friction=_FRICTION, cross_fall=slope),
        slope=lambda slope: slope,
        rate=_RATE,
        highest=_STEEPEST,
    )
    ascent = driven(table, table.fallen if vehicle.has_springs else _lifted)
    slope = Signal("slope", "-", "lateral slope of the table, + left side up")
    log = drive_log(vehicle, ascent.truths).with_columns([(slope, ascent.levels)])
    if vehicle.has_springs:
        how = (
            "until the combination falls. The threshold is the steepest slope on which it stands. The lateral "
            "acceleration in g that tips it in a turn is up to 4 % less, as the weight across a slope, and the roll "
            "that it adds, are less than on the level. Its range is for what data sheets of suspensions leave open: "
            "roll stiffness 30 %, tyres 15 %, roll centres 50 mm, all of them soft or stiff at once, and 50 mm of "
            "lateral shift by tyres and leaf springs, which the model has not."
        )
    else:
        how = (
            "until the first wheel lifts. The slope at which the extrapolated load transfer of a unit is 1 equals the "
            "lateral acceleration in g that tips it."
        )

    def figures() -> Figures:
        if vehicle.has_springs:
            tips, lifts = highest_held(table, ascent)[0], [_lifted(truth, 0.0) for truth in ascent.truths].index(True)
        else:
            tips, lifts = min(threshold(log, unit.name) for unit in vehicle.units), len(log) - 1
        slope = float(log["slope"][lifts])
        rolls = [abs(float(log[f"roll_{unit.name}"][lifts]) - math.atan(slope)) for unit in vehicle.units]
        softest, stiffest = spread(vehicle)
        return {
            "rollover_threshold_g": tips,
            "rollover_threshold_low_g": softest * tips,
            "rollover_threshold_high_g": stiffest * tips,
            "rollover_acceleration_m_s2": GRAVITY * tips,
            "wheel_lift_g": slope,
            "wheel_lift_roll_rad": max(rolls),
        }

    how = f"Standing on a plane that tilts by about 1° per second {how}"
    return result("tilt", how, Drive(outcome=ascent.outcome, log=log), figures)


# What data sheets of suspensions leave open. Stiffnesses and roll centres: the ranges that the sources of the shipped
# vehicles state. Shift of the bodies towards the outside, which the model has not: 30 mm by the tyres (4 of 0.3 MN/m
# under 36 kN) and 20 mm by the lash of leaf springs (1 deg at 1.2 m); both are assumed.
_STIFFNESS: Final = 0.3
_TYRES: Final = 0.15
_ROLL_CENTRE: Final = 0.05  # [m]
_SHIFT: Final = 0.05  # [m]


def spread(vehicle: Vehicle) -> tuple[float, float]:
    """Least and largest rollover threshold over that of the vehicle file, for what is not known of suspensions.

    By theory, with all suspensions at one end of what is usual, and at the least also a shift of the bodies that the
    model has not. NaN without suspensions.
    """
    if not vehicle.has_springs:
        return math.nan, math.nan
    least, known, most = (static_rollover_threshold(_with_suspensions(vehicle, side)) for side in (-1.0, 0.0, 1.0))
    height = sum(unit.mass * unit.cg_height for unit in vehicle.units) / vehicle.mass
    return (least - GRAVITY * _SHIFT / height) / known, most / known


def _with_suspensions(vehicle: Vehicle, side: float) -> Vehicle:
    """The vehicle with soft (-1) or stiff (+1) suspensions, all numbers at that end of their ranges."""
    changes: dict[str, Callable[[float], float]] = {
        "suspension.roll_stiffness": lambda value: (1.0 + side * _STIFFNESS) * value,
        "suspension.tyre_stiffness": lambda value: (1.0 + side * _TYRES) * value,
        "suspension.roll_centre_height": lambda value: value + side * _ROLL_CENTRE,
    }

    def number(path: str, value: float) -> float:
        change = next((change for end, change in changes.items() if path.endswith(end)), None)
        return value if change is None else change(value)

    changed: Vehicle = with_numbers(vehicle, number)
    return changed


def _lifted(truth: Truth, slope: float) -> bool:
    """True if a wheel has lifted."""
    return bool(truth.wheel_loads.min() <= _LIFTED * truth.wheel_loads.mean())


def threshold(log: Log, unit: str) -> float:
    """Slope [-] at which the load transfer of a unit, extrapolated from before the first wheel lifts, is 1."""
    slope, transfer = log["slope"], np.abs(log[f"load_transfer_{unit}"])
    settled = slope >= _SETTLED * slope[-1]
    gain, offset = np.polyfit(slope[settled], transfer[settled], 1)
    return float((1.0 - offset) / gain)


_JERK: Final = 0.2  # [m/s3] of the lateral acceleration at first: it follows without lag, within 1 % of the threshold
_LARGEST: Final = math.radians(30.0)  # steer angle [rad]


def closing_curve(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Steer slowly further into a curve at constant speed until the combination falls."""
    at = KINDS["closing_curve"].under(conditions)
    model = lateral_model(vehicle, at.speed, outputs=("lateral_acceleration",))
    ramp = Ramp(
        vehicle=vehicle,
        surface=lambda _: at.surface,
        steer=lambda angle: at.side * angle,
        speed=at.speed,
        rate=_JERK / abs(model.steady_gain("lateral_acceleration_0")),
        highest=_LARGEST,
    )
    ascent = driven(ramp, ramp.fallen)
    demand = Signal("steer_demand", "rad", "demanded road-wheel angle, + left")
    log = drive_log(vehicle, ascent.truths).with_columns([(demand, at.side * ascent.levels)])

    def figures() -> Figures:
        steer, truth = highest_held(ramp, ascent)
        masses = np.array([unit.mass for unit in vehicle.units])
        # In a steady turn the acceleration of each centre of gravity towards the turning centre, along its unit's y.
        accelerations = truth.velocities[:, 0] * truth.velocities[:, 2]
        return {
            "curve_rollover_g": float(abs(masses @ accelerations) / masses.sum() / GRAVITY),
            "curve_rollover_roll_rad": float(np.abs(ramp.rolls(truth, steer)).max()),
            "curve_rollover_steer_rad": steer,
        }

    return result(
        "closing_curve",
        f"{3.6 * at.speed:g} km/h and friction {at.friction:g}; the steer angle grows slowly, at first by {_JERK:g} "
        "m/s³ of lateral acceleration, until the combination falls. The threshold is the lateral acceleration at the "
        "largest steer angle that it holds, the mean of its units by mass.",
        Drive(outcome=ascent.outcome, log=log),
        figures,
    )
