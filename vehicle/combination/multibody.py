"""Rigid bodies in a plane, hinged in a chain: kinematics and equations of motion, for numbers or ``casadi.SX``.

The speeds are the velocity of the first unit's origin along its own axes T and the yaw rate of each unit. Every
point on the chain is reached from that origin over levers along the units' x axes e_j: hitch to hitch, then to the
point. All vectors are along T, so only angles relative to the first unit matter.

Seen from the common centre of mass, centre of gravity k lies at sum_j d_kj e_j, with constant levers of which
sum_k m_k d_kj = 0. So the yaw rates' equations contain no other speed: with mu_ij = sum_k m_k d_ki d_kj and e' the
normal to the left of e, d'Alembert's principle for a turn of unit i gives
I_i r_i' + sum_j mu_ij (e_i . e_j r_j' - e_i' . e_j r_j^2) = M_i + e_i' . sum_k d_ki F_k.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import casadi as ca

from vehicle.combination.description import Vehicle
from vehicle.tyres import Num


@dataclass(frozen=True, slots=True)
class Vector:
    """A planar vector along the axes of T."""

    x: Num
    y: Num

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.x + other.x, self.y + other.y)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.x - other.x, self.y - other.y)

    def __mul__(self, factor: Num) -> "Vector":
        return Vector(factor * self.x, factor * self.y)


ZERO: Final = Vector(0.0, 0.0)


class Speeds(NamedTuple):
    """Velocity of the first unit's origin along T [m/s] and the yaw rates of all units [rad/s], or their rates."""

    v_x: Num
    v_y: Num
    yaw_rate: Sequence[Num]


Levers = list[tuple[int, float]]  # (unit, length along its x axis [m])


def levers_to(vehicle: Vehicle, unit: int, x: float) -> Levers:
    """Levers from the first unit's origin to the point x [m] on a unit's axis."""
    hitches = [(k, ahead.rear_hitch[0]) for k, ahead in enumerate(vehicle.units[:unit])]
    return [*hitches, (unit, x)]


def axes(psi: Sequence[Num]) -> list[Vector]:
    """Direction of each unit's x axis in T, from the units' yaw angles [rad]."""
    return [Vector(ca.cos(angle - psi[0]), ca.sin(angle - psi[0])) for angle in psi]


def along(axis: Vector, v: Vector) -> Vector:
    """Components along a unit's axes, from those along T."""
    return Vector(axis.x * v.x + axis.y * v.y, axis.x * v.y - axis.y * v.x)


def from_unit(axis: Vector, v: Vector) -> Vector:
    """Components along T, from those along a unit's axes."""
    return Vector(axis.x * v.x - axis.y * v.y, axis.y * v.x + axis.x * v.y)


def velocity(levers: Levers, e: Sequence[Vector], speeds: Speeds) -> Vector:
    """Velocity [m/s] of the point at the end of the levers."""
    x, y = speeds.v_x, speeds.v_y
    for unit, length in levers:
        swing = length * speeds.yaw_rate[unit]
        x = x - swing * e[unit].y
        y = y + swing * e[unit].x
    return Vector(x, y)


def acceleration(levers: Levers, e: Sequence[Vector], speeds: Speeds, rates: Speeds) -> Vector:
    """Acceleration [m/s2] of the point at the end of the levers, relative to W, along T."""
    r = speeds.yaw_rate[0]
    origin = Vector(rates.v_x - r * speeds.v_y, rates.v_y + r * speeds.v_x)
    swings = _swings(e, speeds.yaw_rate, rates.yaw_rate)
    return sum((swings[unit] * length for unit, length in levers), origin)


def speed_rates(
    vehicle: Vehicle, psi: Sequence[Num], speeds: Speeds, forces: Sequence[Vector], moments: Sequence[Num]
) -> Speeds:
    """Rates of the speeds under a force [N, along T] at, and a moment [N m] about, each unit's centre of gravity."""
    e, units = axes(psi), range(len(vehicle.units))
    masses = [unit.mass for unit in vehicle.units]
    levers = [dict(levers_to(vehicle, k, unit.cg_x)) for k, unit in enumerate(vehicle.units)]
    whole = 1.0 / sum(masses)
    means = [whole * sum(masses[k] * levers[k].get(j, 0.0) for k in units) for j in units]
    d = [[levers[k].get(j, 0.0) - means[j] for j in units] for k in units]
    mu = [[sum(masses[k] * d[k][i] * d[k][j] for k in units) for j in units] for i in units]
    r = speeds.yaw_rate
    J: list[list[Num]] = [[0.0] * len(units) for _ in units]
    turning: list[Num] = []
    for i, unit in enumerate(vehicle.units):
        pull = sum((forces[k] * d[k][i] for k in units), ZERO)
        turning.append(moments[i] + along(e[i], pull).y)
        J[i][i] = unit.yaw_inertia + mu[i][i]
    for i in units:
        for j in range(i):
            between = along(e[i], e[j])  # cosine and sine of the angle from unit i to unit j
            J[i][j] = J[j][i] = mu[i][j] * between.x
            across = mu[i][j] * between.y
            turning[i] = turning[i] + across * r[j] ** 2
            turning[j] = turning[j] - across * r[i] ** 2
    yaw = solve_ldl(J, turning)
    centre = Vector(whole * sum(F.x for F in forces), whole * sum(F.y for F in forces))  # its acceleration
    swings = _swings(e, r, yaw)
    origin = sum((swings[j] * -means[j] for j in units), centre)
    return Speeds(origin.x + r[0] * speeds.v_y, origin.y - r[0] * speeds.v_x, yaw)


def _swings(e: Sequence[Vector], yaw_rate: Sequence[Num], rates: Sequence[Num]) -> list[Vector]:
    """Second derivative of each unit's axis: tangential and centripetal acceleration on a lever of 1 m."""
    return [
        from_unit(axis, Vector(-(rate**2), acceleration))
        for axis, rate, acceleration in zip(e, yaw_rate, rates, strict=True)
    ]


def solve_ldl(M: Sequence[Sequence[Num]], b: Sequence[Num]) -> list[Num]:
    """Solution of M x = b for a symmetric positive definite M, by its factors L D L^T without square roots."""
    n = len(b)
    L: list[list[Num]] = [[0.0] * n for _ in range(n)]
    D: list[Num] = [0.0] * n
    inverse: list[Num] = [0.0] * n
    for j in range(n):
        D[j] = M[j][j] - sum(L[j][k] ** 2 * D[k] for k in range(j))
        inverse[j] = 1.0 / D[j]
        for i in range(j + 1, n):
            L[i][j] = (M[i][j] - sum(L[i][k] * L[j][k] * D[k] for k in range(j))) * inverse[j]
    z: list[Num] = []
    for i in range(n):
        z.append(b[i] - sum(L[i][k] * z[k] for k in range(i)))
    x: list[Num] = [z[i] * inverse[i] for i in range(n)]
    for i in reversed(range(n)):
        x[i] = x[i] - sum(L[k][i] * x[k] for k in range(i + 1, n))
    return x
