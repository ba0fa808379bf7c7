"""The integrator: second order whatever the diagonal, stable where the diagonal is stiff."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from vehicle.combination.description import Vehicle
from vehicle.combination.functions import compiled_derivative
from vehicle.combination.layout import Input, State, input_sizes, state_sizes, wheels
from vehicle.engine.integrator import semi_implicit_step
from vehicle.frames import FloatArray


def integrate(f: ca.Function, x: FloatArray, h: float, end: float, blocks: list[tuple[int, int]]) -> FloatArray:
    symbol = ca.SX.sym("x", len(x))
    step = ca.Function("step", [symbol], [semi_implicit_step(f, symbol, h, blocks)])
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


def test_the_vehicle_converges_with_order_two(tractor_semitrailer: Vehicle) -> None:
    """Steering into a bend while pulling: position error against the step, from 8 ms down to the 1 ms of the plant."""
    v = tractor_semitrailer
    s = State(*(np.zeros(n) for n in state_sizes(v)))
    s = s._replace(v_x=np.array([6.0]), omega=np.array([6.0 / w.axle.wheel_radius for w in wheels(v)]))
    u = Input(*(np.zeros(n) for n in input_sizes(v)))
    u = u._replace(steer=np.array([0.05]), acceleration=np.array([0.5]), gear=np.array([1.0]))
    u = u._replace(friction=np.full(v.n_wheels, 0.8))
    whole = compiled_derivative(v)
    x = ca.SX.sym("x", whole.numel_in(0))
    f = ca.Function("f", [x], [whole(x, np.concatenate(u))])
    names = list(State._fields)
    starts = np.concatenate([[0], np.cumsum(state_sizes(v))])
    stiff = ("omega", "deflection_x", "deflection_y", "brake_windup")
    blocks = [(starts[names.index(name)], starts[names.index(name) + 1]) for name in stiff]
    exact = integrate(f, np.concatenate(s), 1.25e-4, 2.0, blocks)
    steps = [4e-3, 2e-3, 1e-3]
    errors = [np.hypot(*(integrate(f, np.concatenate(s), h, 2.0, blocks) - exact)[:2]) for h in steps]
    np.testing.assert_allclose(np.diff(np.log2(errors)), -2.0, atol=0.4)  # not quite asymptotic at 4 ms
    assert errors[-1] < 1e-3  # [m], over 12 m: a tenth of what a reference GNSS/INS unit could tell
