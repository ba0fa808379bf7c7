"""Rigid bodies in a plane, hinged in a chain: kinematics and equations of motion (Kane), for numbers or ``casadi.SX``.

The speeds are the velocity of the first unit's origin along its own axes T and the yaw rate of each unit. Every
point on the chain is reached from that origin over levers along the units' x axes: hitch to hitch, then to the point.
All vectors are along T, so only angles relative to the first unit enter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from vehicle.description import Vehicle
from vehicle.tyres import Num


class Vector(NamedTuple):
    """A planar vector along the axes of T."""

    x: Num
    y: Num


class Speeds(NamedTuple):
    """Velocity of the first unit's origin along T [m/s] and the yaw rates of all units [rad/s], or their rates."""

    v_x: Num
    v_y: Num
    yaw_rate: Sequence[Num]


Levers = list[tuple[int, float]]  # (unit, length along its x axis [m])


def levers_to(vehicle: Vehicle, unit: int, x: float) -> Levers:
    """Levers from the first unit's origin to the point x [m] on a unit's axis."""
    hitches = [(k, ahead.hitch_x or 0.0) for k, ahead in enumerate(vehicle.units[:unit])]
    return [*hitches, (unit, x)]


def axes(psi: Sequence[Num]) -> list[Vector]:
    """Direction of each unit's x axis in T, from the units' yaw angles [rad]."""
    return [Vector(ca.cos(angle - psi[0]), ca.sin(angle - psi[0])) for angle in psi]


def along(axis: Vector, v: Vector) -> Vector:
    """A vector given along T, along a unit's own axes."""
    return Vector(axis.x * v.x + axis.y * v.y, axis.x * v.y - axis.y * v.x)


def from_unit(axis: Vector, v: Vector) -> Vector:
    """A vector given along a unit's own axes, along T."""
    return Vector(axis.x * v.x - axis.y * v.y, axis.y * v.x + axis.x * v.y)


def velocity(levers: Levers, e: Sequence[Vector], speeds: Speeds) -> Vector:
    """Velocity [m/s] of the point at the end of the levers."""
    x, y = speeds.v_x, speeds.v_y
    for unit, length in levers:
        x = x - speeds.yaw_rate[unit] * length * e[unit].y
        y = y + speeds.yaw_rate[unit] * length * e[unit].x
    return Vector(x, y)


def acceleration(levers: Levers, e: Sequence[Vector], speeds: Speeds, rates: Speeds) -> Vector:
    """Acceleration [m/s2] of the point at the end of the levers, relative to W, along T."""
    tangential = velocity(levers, e, rates)
    centripetal = _centripetal(levers, e, speeds)
    return Vector(tangential.x + centripetal.x, tangential.y + centripetal.y)


def _centripetal(levers: Levers, e: Sequence[Vector], speeds: Speeds) -> Vector:
    """The part of the acceleration that is there without any rate of the speeds."""
    x, y = -speeds.yaw_rate[0] * speeds.v_y, speeds.yaw_rate[0] * speeds.v_x
    for unit, length in levers:
        x = x - speeds.yaw_rate[unit] ** 2 * length * e[unit].x
        y = y - speeds.yaw_rate[unit] ** 2 * length * e[unit].y
    return Vector(x, y)


def speed_rates(
    vehicle: Vehicle, psi: Sequence[Num], speeds: Speeds, forces: Sequence[Vector], moments: Sequence[Num]
) -> Speeds:
    """Rates of the speeds under a force [N, along T] at, and a moment [N m] about, each unit's centre of gravity."""
    e = axes(psi)
    n = 2 + len(vehicle.units)
    M: list[list[Num]] = [[0.0] * n for _ in range(n)]
    Q: list[Num] = [0.0] * n
    for i, unit in enumerate(vehicle.units):
        levers = levers_to(vehicle, i, unit.cg_x)
        bias = _centripetal(levers, e, speeds)
        effective = Vector(forces[i].x - unit.mass * bias.x, forces[i].y - unit.mass * bias.y)
        partials = _partial_velocities(levers, e)
        for a, p in partials.items():
            Q[a] = Q[a] + p.x * effective.x + p.y * effective.y
            for b, q in partials.items():
                M[a][b] = M[a][b] + unit.mass * (p.x * q.x + p.y * q.y)
        M[2 + i][2 + i] = M[2 + i][2 + i] + unit.yaw_inertia
        Q[2 + i] = Q[2 + i] + moments[i]
    v_x, v_y, *yaw = solve_ldl(M, Q)
    return Speeds(v_x, v_y, yaw)


def _partial_velocities(levers: Levers, e: Sequence[Vector]) -> dict[int, Vector]:
    """Velocity of the levers' end per unit of each speed (Kane's partial velocities), by the speed's number."""
    partials = {0: Vector(1.0, 0.0), 1: Vector(0.0, 1.0)}
    for unit, length in levers:
        partials[2 + unit] = Vector(-length * e[unit].y, length * e[unit].x)
    return partials


def solve_ldl(M: Sequence[Sequence[Num]], b: Sequence[Num]) -> list[Num]:
    """Solution of M x = b for a symmetric positive definite M, by its factors L D L^T without square roots."""
    n = len(b)
    L: list[list[Num]] = [[0.0] * n for _ in range(n)]
    D: list[Num] = [0.0] * n
    for j in range(n):
        D[j] = M[j][j] - sum(L[j][k] ** 2 * D[k] for k in range(j))
        for i in range(j + 1, n):
            L[i][j] = (M[i][j] - sum(L[i][k] * L[j][k] * D[k] for k in range(j))) / D[j]
    z: list[Num] = []
    for i in range(n):
        z.append(b[i] - sum(L[i][k] * z[k] for k in range(i)))
    x: list[Num] = [z[i] / D[i] for i in range(n)]
    for i in reversed(range(n)):
        x[i] = x[i] - sum(L[k][i] * x[k] for k in range(i + 1, n))
    return x
