"""Static rollover of a vehicle whose suspensions are given: axles lift one after the other until nothing resists.

In a steady turn on level ground all axles carry side force in proportion to their load. The lateral acceleration rises
until the bodies have no stable equilibrium any more.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.multibody import Vector
from vehicle.combination.roll import Hitch, body_moments, hitch_loads, settled_rolls, springs_of
from vehicle.frames import FloatArray
from vehicle.tyres import Num

_STEP: Final = 0.1  # [m/s2] of the search; the equilibrium of one is near that of the next
_RESOLUTION: Final = 1e-4  # [m/s2] of the threshold
_HIGHEST: Final = 3.0 * GRAVITY  # [m/s2]
_ITERATIONS: Final = 30  # moments are linear between the points where an axle lifts: Newton's method needs few
_CONVERGED: Final = 1e-9  # [rad]
_NUDGE: Final = 1e-7  # [rad] of the numeric slope


class Rollover(NamedTuple):
    """Static rollover of a vehicle in a turn to the left."""

    threshold: float  # lateral acceleration beyond which it tips [m/s2]
    roll: tuple[float, ...]  # of every body just below it [rad]
    lifted: tuple[tuple[bool, ...], ...]  # axles of every unit of which a side has lifted there


class _Stand:
    """Moments on the bodies of a vehicle in a steady turn."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._springs = vehicle, springs_of(vehicle)
        self._loads = static_axle_loads(vehicle)
        self._hitch_loads = [float(load) for load in hitch_loads(vehicle, self._loads)[1:]]

    def moments(self, roll: FloatArray, acceleration: float) -> FloatArray:
        """Roll moments [N m] at these rolls [rad]; 0 in equilibrium."""
        share = acceleration / GRAVITY
        hitches = [Hitch(Vector(0.0, share * load), Vector(0.0, share * load), load, 1.0) for load in self._hitch_loads]
        held: list[list[Num]] = [
            [
                spring.body_moment(float(roll[i]), share * load, right_less_left)
                for spring, load, right_less_left in zip(springs.axles, self._loads[i], excess, strict=True)
            ]
            for i, (springs, excess) in enumerate(zip(self._springs, self.excess(roll, acceleration), strict=True))
        ]
        moments = body_moments(self._vehicle, self._springs, roll.tolist(), self._loads, held, hitches)
        return np.array([float(moment) for moment in moments])

    def excess(self, roll: FloatArray, acceleration: float) -> list[list[float]]:
        """Right less left wheel load of every axle of every unit [N]."""
        share = acceleration / GRAVITY
        return [
            [
                float(np.clip(2.0 * float(spring.transfer(float(roll[i]), share * load)), -load, load))
                for spring, load in zip(springs.axles, self._loads[i], strict=True)
            ]
            for i, springs in enumerate(self._springs)
        ]

    def slopes(self, roll: FloatArray, acceleration: float) -> FloatArray:
        """Moments over rolls [N m/rad]."""
        here = self.moments(roll, acceleration)
        nudges = _NUDGE * np.eye(len(roll))
        return np.column_stack([(self.moments(roll + nudge, acceleration) - here) / _NUDGE for nudge in nudges])

    def equilibrium(self, roll: FloatArray, acceleration: float) -> FloatArray | None:
        """Stable rolls [rad] near these; None if there are none."""
        for _ in range(_ITERATIONS):
            slopes = self.slopes(roll, acceleration)
            if np.linalg.eigvals(slopes).real.max() >= 0.0:
                return None
            step = np.linalg.solve(slopes, self.moments(roll, acceleration))
            roll = roll - step
            if np.abs(step).max() < _CONVERGED:
                return roll
        return None

    def lifted(self, roll: FloatArray, acceleration: float) -> tuple[tuple[bool, ...], ...]:
        """Axles of every unit of which a side has lifted."""
        return tuple(
            tuple(abs(excess) >= load for excess, load in zip(of_unit, loads, strict=True))
            for of_unit, loads in zip(self.excess(roll, acceleration), self._loads, strict=True)
        )


def static_rollover(vehicle: Vehicle) -> Rollover:
    """Static rollover of a vehicle whose suspensions are given.

    Raises:
        ValueError: if it does not stand, or tips at no acceleration of a road vehicle.
    """
    stand = _Stand(vehicle)
    roll: FloatArray | None = stand.equilibrium(np.zeros(len(vehicle.units)), 0.0)
    if roll is None:
        raise ValueError(f"{vehicle.name} falls over where it stands: its roll stiffness does not carry its bodies")
    low, step = 0.0, _STEP
    while step > _RESOLUTION:
        if low > _HIGHEST:
            raise ValueError(f"{vehicle.name} does not tip below {_HIGHEST / GRAVITY:g} g")
        found = stand.equilibrium(roll, low + step)
        if found is None:
            step *= 0.5
        else:
            roll, low = found, low + step
    return Rollover(low, tuple(roll.tolist()), stand.lifted(roll, low))


def roll_gradients(vehicle: Vehicle) -> tuple[float, ...]:
    """Roll of every body over lateral acceleration [rad/(m/s2)], all wheels on the ground."""
    if not vehicle.has_springs:
        return tuple(unit.roll_swing[0] for unit in vehicle.units)
    rolls = settled_rolls(vehicle, springs_of(vehicle), [1.0] * len(vehicle.units))
    return tuple(float(roll) for roll in rolls)
