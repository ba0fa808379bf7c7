"""Hitch forces against those that hold free bodies together, the solver of the equations, and the integrator."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from offtrack.studies.validation.mechanics import ChainMotion, newton_euler, random_inputs, random_states
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import compiled_derivative, compiled_output
from vehicle.combination.layout import Input, Output, State, input_sizes, output_sizes, parts, state_sizes
from vehicle.combination.multibody import solve_ldl
from vehicle.engine.integrator import exact_diagonal, semi_implicit_step
from vehicle.frames import FloatArray, Pose2


def test_a_trailer_pulled_straight_takes_its_share_of_the_force(tractor_semitrailer: Vehicle) -> None:
    """In line, the hitch carries what accelerates the trailer's mass; square to it a free-standing one swings."""
    trailer = tractor_semitrailer.units[1]
    still = ChainMotion(np.zeros(2), np.zeros(2), np.zeros(2))
    pull = np.array([[1e4, 0.0], [0.0, 0.0]])
    got, hitch = newton_euler(tractor_semitrailer, still, pull, np.zeros(2))
    assert got.origin[0] == pytest.approx(1e4 / tractor_semitrailer.mass)
    np.testing.assert_allclose(hitch, [[1e4 * trailer.mass / tractor_semitrailer.mass, 0.0]], atol=1e-9)


def test_hitch_forces_are_those_that_hold_the_bodies_together(chain: Vehicle) -> None:
    """The hitch force a chain settles on, from its own tyre forces and gravity in random states, body by body."""
    told, rate = compiled_output(chain), compiled_derivative(chain)
    rng = np.random.default_rng(7)
    for _ in range(20):
        s, u = random_states(chain, rng, 1)[:, 0], random_inputs(chain, rng, 1)[:, 0]
        ground = Output(*parts(np.array(told(s, u)).ravel(), output_sizes(chain)))
        now, inputs = State(*parts(s, state_sizes(chain))), Input(*parts(u, input_sizes(chain)))
        rates = State(*parts(np.array(rate(s, u)).ravel(), state_sizes(chain)))
        c, si = math.cos(now.psi[0]), math.sin(now.psi[0])
        R_WT = np.array([[c, -si], [si, c]])
        weights = np.array([unit.mass for unit in chain.units])
        gravity = weights[:, None] * np.column_stack([inputs.gravity_x, inputs.gravity_y])
        forces = np.column_stack([ground.force_x, ground.force_y]) @ R_WT.T + gravity
        motion = ChainMotion(now.psi, R_WT @ np.array([now.v_x[0], now.v_y[0]]), now.yaw_rate)
        accelerations, hitches = newton_euler(chain, motion, forces, ground.moment)
        np.testing.assert_allclose(rates.yaw_rate, accelerations.yaw, rtol=1e-9, atol=1e-9)  # forces of 1e6 N
        lag = np.array([unit.hitch_lag for unit in chain.units[1:]])
        # the state follows the force within that lag: rate = (force - state) / lag
        got = np.column_stack([now.hitch_x + lag * rates.hitch_x, now.hitch_y + lag * rates.hitch_y])
        own = [Pose2(0.0, 0.0, -psi).apply(F[None])[0] for psi, F in zip(now.psi[1:], hitches, strict=True)]
        np.testing.assert_allclose(got, np.reshape(own, (-1, 2)), rtol=1e-9, atol=1e-3)  # of 1e6 N


@pytest.mark.parametrize("seed", range(5))
def test_the_symmetric_solver_solves(seed: int) -> None:
    """Random symmetric positive definite systems against LAPACK."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5))
    M, b = A @ A.T + np.eye(5), rng.normal(size=5)
    solution = np.array(solve_ldl(M.tolist(), b.tolist()), dtype=np.float64)
    np.testing.assert_allclose(solution, np.linalg.solve(M, b), rtol=1e-9)


def integrate(f: ca.Function, x: FloatArray, h: float, end: float, blocks: list[tuple[int, int]]) -> FloatArray:
    symbol = ca.SX.sym("x", len(x))
    relaxation = -exact_diagonal(f(symbol), symbol, blocks)
    step = ca.Function("step", [symbol], [semi_implicit_step(f, symbol, h, relaxation)])
    return np.array(step.fold(round(end / h))(x)).ravel()


@pytest.mark.parametrize("blocks", [[], [(0, 1)], [(0, 2)]])
def test_the_order_is_two_with_any_part_of_the_diagonal(blocks: list[tuple[int, int]]) -> None:
    """Halving the step quarters the error: a W-method needs no exact Jacobian for its order."""
    x = ca.SX.sym("x", 2)
    f = ca.Function("f", [x], [ca.vertcat(-x[0] * x[1] - x[0], ca.sin(x[0]) - x[1] ** 2)])
    start = np.array([1.0, 0.5])
    exact = integrate(f, start, 1e-4, 1.0, blocks)
    errors = [np.abs(integrate(f, start, h, 1.0, blocks) - exact).max() for h in (0.05, 0.025, 0.0125)]
    slopes = np.diff(np.log2(errors))
    np.testing.assert_allclose(slopes, -2.0, atol=0.15)  # the next order of the error at these steps


def test_a_mode_thousand_times_faster_than_the_step_decays() -> None:
    """An explicit method would explode by 1e6 a step; this one follows the slow manifold y = cos t."""
    x = ca.SX.sym("x", 2)  # y, t
    f = ca.Function("f", [x], [ca.vertcat(-1e6 * (x[0] - ca.cos(x[1])), 1.0)])
    end = integrate(f, np.array([0.0, 0.0]), 1e-3, 1.0, [(0, 1)])
    assert end[0] == pytest.approx(math.cos(1.0), abs=2e-3)  # a step's worth of lag behind cos t
