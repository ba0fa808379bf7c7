"""Slow ramps up to rolling over: the highest level of a slope or a steer angle at which a combination still stands.

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

from scenarios.standards.proving_ground import PERIOD
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
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
        self.idle = (0.0,) * sum(len(unit.steered_axles) for unit in vehicle.units[1:])

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
