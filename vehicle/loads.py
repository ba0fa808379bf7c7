"""Vertical tyre loads: quasi-static equilibrium of the chain in pitch and in roll, for numbers or ``casadi.SX``.

Tractor axles are equal springs under a beam, the axles of a towed unit share their load equally (a compensated
suspension). Lateral load transfer is shared among a unit's axles in proportion to their static loads. Accelerations
are specific forces (gravity's part along the ground taken off), so that slopes load the wheels as they should.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import casadi as ca

from vehicle.description import GRAVITY, Unit, Vehicle
from vehicle.multibody import Vector, along, from_unit
from vehicle.tyres import Num

_LIFT_OFF: Final = 50.0  # smooths the moment a wheel leaves the ground [N]: small against any truck wheel's load


def static_axle_loads(vehicle: Vehicle) -> list[list[float]]:
    """Load [N] of each axle of each unit, standing on level ground."""
    n = len(vehicle.units)
    at_rest, ahead = Vector(0.0, 0.0), Vector(1.0, 0.0)
    loads = axle_loads(vehicle, [GRAVITY] * n, [0.0] * n, [at_rest] * n, [ahead] * n)
    return [[float(load) for load in of_unit] for of_unit in loads]


def axle_loads(
    vehicle: Vehicle,
    gravity: Sequence[Num],
    a_x: Sequence[Num],
    hitch_forces: Sequence[Vector],
    e: Sequence[Vector],
) -> list[list[Num]]:
    """Load [N] of each axle of each unit.

    ``gravity`` is its component normal to the ground under each unit and ``a_x`` each unit's specific force along its
    x axis [m/s2]; ``hitch_forces[i]`` acts on unit i at its front hitch, along unit i's axes [N] (unit 0: none);
    ``e`` are the directions of the units' x axes.
    """
    loads: list[list[Num]] = [[] for _ in vehicle.units]
    below: Num = 0.0  # what the hitch of the unit at hand carries [N]
    for i in reversed(range(len(vehicle.units))):
        unit = vehicle.units[i]
        weight = unit.mass * gravity[i]
        # Pitching moment about the origin on the ground, nose down: gravity, inertia, and the hitch behind.
        moment = unit.cg_x * weight - unit.cg_height * unit.mass * a_x[i]
        if unit.hitch_x is not None and i + 1 < len(vehicle.units):
            pull = along(e[i], from_unit(e[i + 1], hitch_forces[i + 1]))
            moment = moment + unit.hitch_x * below - (unit.hitch_height or 0.0) * pull.x
        if i == 0:
            loads[0] = _beam(unit, weight + below, moment)
            break
        front = vehicle.units[i - 1].hitch_height or 0.0
        group = (moment + front * hitch_forces[i].x) / (sum(axle.x for axle in unit.axles) / len(unit.axles))
        loads[i] = [group / len(unit.axles)] * len(unit.axles)
        below = weight + below - group
    return loads


def _beam(unit: Unit, weight: Num, moment: Num) -> list[Num]:
    """Axle loads of a beam on equal springs that carries a weight [N] with a moment about the origin [N m]."""
    x = [axle.x for axle in unit.axles]
    n, s_1, s_2 = len(x), sum(x), sum(position**2 for position in x)
    determinant = n * s_2 - s_1**2
    level = (s_2 * weight - s_1 * moment) / determinant
    slope = (n * moment - s_1 * weight) / determinant
    return [level + slope * position for position in x]


def roll_moments(vehicle: Vehicle, a_y: Sequence[Num]) -> list[Num]:
    """Roll moment [N m] that the axles of each unit carry, + to the right wheels."""
    moments: list[Num] = [0.0] * len(vehicle.units)
    passed: Num = 0.0
    for i in reversed(range(len(vehicle.units))):
        unit = vehicle.units[i]
        total = unit.mass * unit.cg_height * a_y[i] + passed
        passed = unit.hitch_roll_share * total if i > 0 else 0.0
        moments[i] = total - passed
    return moments


def wheel_load(axle_load: Num, transfer: Num, side: int) -> Num:
    """Load [N] of the left (side +1) or right (-1) wheel; ``transfer`` is what the axle moves to the right [N]."""
    load = 0.5 * axle_load - side * transfer
    return 0.5 * (load + ca.sqrt(load * load + _LIFT_OFF**2))
