"""Rigid chains: the equations of motion against Lagrange's, and what a chain without forces conserves."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vehicle.combination.description import Vehicle
from vehicle.combination.multibody import Speeds, Vector, solve_ldl, speed_rates


class Lagrange:
    """Kinetic energy, momenta and Lagrange's equations from positions alone; q = (x, y, psi_1 ... psi_N)."""

    def __init__(self, vehicle: Vehicle) -> None:
        n = 2 + len(vehicle.units)
        q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
        hitch = q[:2]
        T, P, L = ca.SX(0), ca.SX.zeros(2), ca.SX(0)
        places = []
        for i, unit in enumerate(vehicle.units):
            axis = ca.vertcat(ca.cos(q[2 + i]), ca.sin(q[2 + i]))
            p = hitch + unit.cg_x * axis
            v = ca.jtimes(p, q, qd)
            T += 0.5 * unit.mass * ca.dot(v, v) + 0.5 * unit.yaw_inertia * qd[2 + i] ** 2
            P += unit.mass * v
            L += unit.mass * (p[0] * v[1] - p[1] * v[0]) + unit.yaw_inertia * qd[2 + i]
            places.append(p)
            hitch = hitch + (unit.hitch_x or 0.0) * axis
        momentum = ca.gradient(T, qd)
        residual = ca.jtimes(momentum, qd, qdd) + ca.jtimes(momentum, q, qd) - ca.gradient(T, q)
        self.residual = ca.Function("residual", [q, qd, qdd], [residual])  # = generalised force
        self.conserved = ca.Function("conserved", [q, qd], [ca.vertcat(T, P, L)])
        self.places = ca.Function("places", [q], [ca.vertcat(*places)])
        self.partials = ca.Function("partials", [q], [ca.jacobian(ca.vertcat(*places), q)])


def rates_in_world(vehicle: Vehicle, q: np.ndarray, qd: np.ndarray, F: np.ndarray, M: np.ndarray) -> np.ndarray:
    """qdd under forces (N, 2) [N, along W] at, and moments (N,) about, the centres of gravity."""
    c, s = np.cos(q[2]), np.sin(q[2])
    R_WT = np.array([[c, -s], [s, c]])
    v = R_WT.T @ qd[:2]
    forces = [Vector(*(R_WT.T @ f)) for f in F]
    rates = speed_rates(vehicle, list(q[2:]), Speeds(v[0], v[1], list(qd[2:])), forces, list(M))
    turning = qd[2] * np.array([-v[1], v[0]])  # the axes of T turn under the velocity
    return np.concatenate([R_WT @ (np.array([rates.v_x, rates.v_y]) + turning), rates.yaw_rate])


def random_motion(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q = np.concatenate([rng.uniform(-20, 20, 2), rng.uniform(-3, 3, n)])
    return q, np.concatenate([rng.uniform(-10, 10, 2), rng.uniform(-1, 1, n)])


@pytest.mark.parametrize("seed", range(5))
def test_the_equations_are_lagranges(chain: Vehicle, seed: int) -> None:
    """Two derivations, from levers about the common centre of mass and from positions: M qdd + ... = force."""
    n = len(chain.units)
    q, qd = random_motion(n, seed)
    rng = np.random.default_rng(seed + 100)
    F, M = rng.uniform(-1e5, 1e5, (n, 2)), rng.uniform(-1e5, 1e5, n)
    model = Lagrange(chain)
    qdd = rates_in_world(chain, q, qd, F, M)
    generalised = np.array(model.partials(q)).T @ F.ravel() + np.concatenate([[0, 0], M])
    got = np.array(model.residual(q, qd, qdd)).ravel()
    np.testing.assert_allclose(got, generalised, rtol=1e-10, atol=1e-6)  # 1e5 N, levers of 30 m, rounding of a solve


def test_a_chain_without_forces_conserves_energy_and_momenta(chain: Vehicle) -> None:
    """Twenty seconds of free tumbling, units turning over each other."""
    n = len(chain.units)
    q = np.concatenate([[3.0, -2.0], np.linspace(0.0, 1.0, n)])
    qd = np.concatenate([[8.0, 1.5], np.linspace(0.8, -1.1, n)])

    def f(_: float, y: np.ndarray) -> np.ndarray:
        half = 2 + n
        return np.concatenate([y[half:], rates_in_world(chain, y[:half], y[half:], np.zeros((n, 2)), np.zeros(n))])

    end = solve_ivp(f, (0.0, 20.0), np.concatenate([q, qd]), method="DOP853", rtol=3e-14, atol=1e-13).y[:, -1]
    conserved = Lagrange(chain).conserved
    before, after = np.array(conserved(q, qd)).ravel(), np.array(conserved(end[: 2 + n], end[2 + n :])).ravel()
    # Rounding over a thousand steps; angular momentum is a difference of products with positions of 150 m.
    np.testing.assert_array_less(np.abs(after / before - 1.0), [1e-12, 1e-11, 1e-11, 3e-10])


def test_gravity_does_the_work_of_the_descent(tractor_semitrailer: Vehicle) -> None:
    """On a uniform slope the kinetic energy gained is weight along the slope times way of each centre of gravity."""
    g = np.array([0.5, -0.3])  # [m/s2]
    masses = np.array([unit.mass for unit in tractor_semitrailer.units])
    q, qd = np.array([0.0, 0.0, 0.0, 0.5]), np.array([5.0, 0.0, 0.4, -0.3])

    def f(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [y[4:], rates_in_world(tractor_semitrailer, y[:4], y[4:], masses[:, None] * g, np.zeros(2))]
        )

    end = solve_ivp(f, (0.0, 10.0), np.concatenate([q, qd]), method="DOP853", rtol=3e-14, atol=1e-13).y[:, -1]
    model = Lagrange(tractor_semitrailer)
    ways = (np.array(model.places(end[:4])) - np.array(model.places(q))).reshape(2, 2)
    T = [float(model.conserved(y[:4], y[4:])[0]) for y in (np.concatenate([q, qd]), end)]
    assert T[1] - T[0] == pytest.approx(float(masses @ (ways @ g)), rel=1e-14)  # rounding of 1e6 J


@pytest.mark.parametrize("seed", range(5))
def test_the_symmetric_solver_solves(seed: int) -> None:
    """Random symmetric positive definite systems against LAPACK."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5))
    M, b = A @ A.T + np.eye(5), rng.normal(size=5)
    solution = np.array(solve_ldl(M.tolist(), b.tolist()), dtype=np.float64)
    np.testing.assert_allclose(solution, np.linalg.solve(M, b), rtol=1e-9)
