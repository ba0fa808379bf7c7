"""Two independent derivations of a chain's equations of motion, to check ``vehicle.combination.multibody`` against.

The first uses Lagrange's equations, derived by hand from the kinetic energy; the second the equations of Newton and
Euler for each body, with the hitch forces as unknowns. Both use axes of W and numpy, and share only the data with the
model: masses, inertias and positions.

With e_a the direction of unit a and n_a square to it, a centre of gravity lies at r_i = p + sum_a c_ia e_a, where c_ia
is the distance between the hitches of each unit ahead, and the position of the centre of gravity in its own unit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vehicle.combination.description import Vehicle
from vehicle.combination.multibody import Speeds, Vector, speed_rates
from vehicle.frames import FloatArray


class Motion(NamedTuple):
    """State of motion of a chain, along W."""

    psi: FloatArray  # (N,) yaw of each unit [rad]
    velocity: FloatArray  # (2,) of the first unit's origin [m/s]
    yaw_rate: FloatArray  # (N,) [rad/s]


class Accelerations(NamedTuple):
    """Accelerations of a chain, along W."""

    origin: FloatArray  # (2,) of the first unit's origin [m/s2]
    yaw: FloatArray  # (N,) [rad/s2]


def modelled(vehicle: Vehicle, now: Motion, forces: FloatArray, moments: FloatArray) -> Accelerations:
    """Accelerations as from ``lagrange``, by the model, with vectors rotated between W and the tractor's axes."""
    c, s = math.cos(now.psi[0]), math.sin(now.psi[0])
    R_WT = np.array([[c, -s], [s, c]])
    v_x, v_y = (R_WT.T @ now.velocity).tolist()
    on_units = [Vector(*(R_WT.T @ force).tolist()) for force in forces]
    speeds = Speeds(v_x, v_y, now.yaw_rate.tolist())
    rates = speed_rates(vehicle, now.psi.tolist(), speeds, on_units, moments.tolist())
    turning = now.yaw_rate[0] * np.array([-v_y, v_x])  # due to the rotation of the tractor's axes
    return Accelerations(R_WT @ (np.array([rates.v_x, rates.v_y]) + turning), np.array(rates.yaw_rate))


def lagrange(vehicle: Vehicle, now: Motion, forces: FloatArray, moments: FloatArray) -> Accelerations:
    """Accelerations under forces (N, 2) at, and moments (N,) about, the centres of gravity [N, N m, along W].

    T = m p'^2 / 2 + sum_a B_a psi_a' (p' n_a) + sum_ab A_ab psi_a' psi_b' cos(psi_a - psi_b) / 2, with
    B_a = sum_i m_i c_ia and A_ab = sum_i m_i c_ia c_ib + I_a [a = b]; d/dt dT/dq' - dT/dq = Q gives

    m p'' + sum_a B_a (psi_a'' n_a - psi_a'^2 e_a) = sum_i F_i
    B_a (n_a p'') + sum_b A_ab (cos(psi_a - psi_b) psi_b'' + sin(psi_a - psi_b) psi_b'^2) = M_a + n_a sum_i c_ia F_i
    """
    c, e, n, mass = _levers(vehicle), _along(now.psi), _across(now.psi), _masses(vehicle)
    A = np.einsum("i,ia,ib->ab", mass, c, c) + np.diag([unit.yaw_inertia for unit in vehicle.units])
    B = mass @ c
    between = now.psi[:, None] - now.psi[None, :]
    M = np.block([[mass.sum() * np.eye(2), (B[:, None] * n).T], [B[:, None] * n, A * np.cos(between)]])
    on_origin = forces.sum(axis=0) + (B * now.yaw_rate**2) @ e
    on_yaw = moments + np.sum(n * (c.T @ forces), axis=1) - (A * np.sin(between)) @ now.yaw_rate**2
    solution: FloatArray = np.linalg.solve(M, np.concatenate([on_origin, on_yaw]))
    return Accelerations(solution[:2], solution[2:])


def newton_euler(
    vehicle: Vehicle, now: Motion, forces: FloatArray, moments: FloatArray
) -> tuple[Accelerations, FloatArray]:
    """Accelerations as from ``lagrange``, and the force (N - 1, 2) at each hitch on the unit behind it [N, along W].

    Unknowns are the acceleration of every centre of gravity, every yaw acceleration, and the hitch forces H:
    m a = F + H ahead - H behind, I psi'' = M + moments of both, and at each hitch both units accelerate alike.
    """
    units, N = vehicle.units, len(vehicle.units)
    e, n = _along(now.psi), _across(now.psi)
    yaw, hitch, size = 2 * N, 3 * N, 3 * N + 2 * (N - 1)
    K: FloatArray = np.zeros((size, size))
    b: FloatArray = np.zeros(size)
    for i, unit in enumerate(units):
        row = slice(2 * i, 2 * i + 2)
        K[row, row] = unit.mass * np.eye(2)
        K[yaw + i, yaw + i] = unit.yaw_inertia
        b[row], b[yaw + i] = forces[i], moments[i]
    for k in range(N - 1):
        H = slice(hitch + 2 * k, hitch + 2 * k + 2)
        arms = (k, (units[k].hitch_x or 0.0) - units[k].cg_x, +1.0), (k + 1, -units[k + 1].cg_x, -1.0)
        for i, arm, side in arms:  # the hitch force acts backwards on the unit ahead, forwards on the one behind
            row = slice(2 * i, 2 * i + 2)
            K[row, H] += side * np.eye(2)
            K[yaw + i, H] += side * arm * n[i]
            K[H, row] += side * np.eye(2)
            K[H, yaw + i] += side * arm * n[i]
            b[H] += side * arm * now.yaw_rate[i] ** 2 * e[i]
    solution = np.linalg.solve(K, b).astype(np.float64)
    spin, turn = solution[yaw], now.yaw_rate[0]
    origin = solution[:2] - units[0].cg_x * (spin * n[0] - turn**2 * e[0])
    return Accelerations(origin, solution[yaw:hitch]), solution[hitch:].reshape(N - 1, 2)


def _levers(vehicle: Vehicle) -> FloatArray:
    """c[i, a]: distance along unit a on the way from the origin to the centre of gravity of unit i [m]."""
    hitches = np.array([unit.hitch_x or 0.0 for unit in vehicle.units])
    return np.tril(np.tile(hitches, (len(hitches), 1)), -1) + np.diag([unit.cg_x for unit in vehicle.units])


def _masses(vehicle: Vehicle) -> FloatArray:
    return np.array([unit.mass for unit in vehicle.units])


def _along(psi: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(psi), np.sin(psi)])


def _across(psi: FloatArray) -> FloatArray:
    return np.column_stack([-np.sin(psi), np.cos(psi)])
