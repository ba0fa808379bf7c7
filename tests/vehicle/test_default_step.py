"""The traps of low speed and low friction, at the plant's own step: where integrators fail silently."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest

from tests.vehicle.braking import without_governor
from vehicle.clock import TICK
from vehicle.combination.chain import derivative, relaxation
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Chain, Input, State, input_sizes, parts, state_sizes, wheels
from vehicle.engine.integrator import semi_implicit_step
from vehicle.frames import FloatArray


@lru_cache(maxsize=8)
def one_step(vehicle: Vehicle, h: float) -> ca.Function:
    """Function (state, input) -> state a step of h [s] later."""
    x, u = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))
    given = Input(*parts(u, input_sizes(vehicle)))

    def rate(y: ca.SX) -> ca.SX:
        return ca.vertcat(*derivative(Chain.of(vehicle), State(*parts(y, state_sizes(vehicle))), given))

    stiff = ca.vertcat(*relaxation(Chain.of(vehicle), State(*parts(x, state_sizes(vehicle))), given))
    return ca.Function("step", [x, u], [ca.cse(semi_implicit_step(rate, x, h, stiff))])


def rolling(vehicle: Vehicle, speed: float) -> State[FloatArray]:
    """The straight combination rolling freely."""
    s = State(*(np.zeros(n) for n in state_sizes(vehicle)))
    spin = [speed / wheel.axle.wheel_radius for wheel in wheels(vehicle)]
    return s._replace(v_x=np.array([speed]), omega=np.array(spin), brake_windup=np.full(len(spin), np.sign(speed)))


def given(
    vehicle: Vehicle, friction: float, acceleration: float, *, steer: float = 0.0, grade: float = 0.0, fall: float = 0.0
) -> Input[FloatArray]:
    """Input on ground that rises ahead by ``grade`` and falls to the right by ``fall``."""
    u = Input(*(np.zeros(n) for n in input_sizes(vehicle)))
    steered = np.zeros(len(u.steer))
    steered[0] = steer
    g = GRAVITY / np.sqrt(1.0 + grade**2 + fall**2)
    return u._replace(
        steer=steered,
        acceleration=np.array([acceleration]),
        gear=np.array([1.0]),
        friction=np.full(vehicle.n_wheels, friction),
        gravity_x=np.full(len(u.gravity_x), -g * grade),
        gravity_y=np.full(len(u.gravity_y), -g * fall),
    )


def after(
    vehicle: Vehicle, s: State[FloatArray], u: Input[FloatArray], seconds: float, h: float = TICK
) -> State[FloatArray]:
    steps = one_step(vehicle, h).fold(round(seconds / h))
    return State(*parts(np.array(steps(np.concatenate(s), np.concatenate(u))).ravel(), state_sizes(vehicle)))


def test_it_holds_on_a_hill(tractor_semitrailer: Vehicle) -> None:
    """Braked to rest on 5 %, it creeps less than 1 mm/s: RK4 at this step creeps at 45 mm/s."""
    u = given(tractor_semitrailer, 0.8, -2.0, grade=0.05)
    rest = after(tractor_semitrailer, rolling(tractor_semitrailer, 8.0), u, 9.0)
    later = after(tractor_semitrailer, rest, u, 4.0)
    assert abs(later.x[0] - rest.x[0]) / 4.0 < 1e-3
    assert abs(later.v_x[0]) < 1e-3


def test_rolling_drag_holds_too_where_the_slope_is_less(tractor_semitrailer: Vehicle) -> None:
    """0.3 % against 0.6 % of rolling resistance, nobody on the brake: when it has rocked out it stands still."""
    u = given(tractor_semitrailer, 0.8, 0.0, grade=0.003)
    rest = after(tractor_semitrailer, rolling(tractor_semitrailer, 0.0), u, 20.0)
    later = after(tractor_semitrailer, rest, u, 4.0)
    assert abs(later.x[0] - rest.x[0]) / 4.0 < 1e-3


def test_it_brakes_to_a_stop_on_ice_and_stays(tractor_semitrailer: Vehicle) -> None:
    """Wheels lock at friction 0.1 and stop with the vehicle; against a step ten times finer it ends within 1 cm."""
    u, start = given(tractor_semitrailer, 0.1, -6.0), rolling(tractor_semitrailer, 5.0)
    end = after(tractor_semitrailer, start, u, 8.0)
    finer = after(tractor_semitrailer, start, u, 8.0, TICK / 10.0)
    assert abs(end.v_x[0]) < 1e-3
    assert np.abs(end.omega).max() < 1e-2
    assert end.x[0] == pytest.approx(5.0**2 / (2.0 * 0.1 * GRAVITY * 0.92), rel=0.05)  # lags, and sliding at 0.92
    assert end.x[0] == pytest.approx(finer.x[0], abs=0.01)


def test_wheelspin_on_ice_is_that_of_a_finer_step(tractor_semitrailer: Vehicle) -> None:
    """Full power at friction 0.1: bounded, and within 5 mm of a step ten times finer after 4 s."""
    vehicle = without_governor(tractor_semitrailer)
    u, start = given(vehicle, 0.1, 1.5), rolling(vehicle, 0.0)
    end = after(vehicle, start, u, 4.0)
    finer = after(vehicle, start, u, 4.0, TICK / 10.0)
    assert end.omega[2] > 5.0 * end.v_x[0] / 0.5  # they spin
    assert end.x[0] == pytest.approx(finer.x[0], abs=5e-3)
    assert end.omega[2:4] == pytest.approx(finer.omega[2:4], rel=1e-3)


def test_it_stops_holds_and_starts_again_on_an_icy_cambered_slope(longer_semitrailer: Vehicle) -> None:
    """Friction 0.1, 3 % to the side, 0.5 % up: braking gently it stops and stands; then 0.2 m/s2 take it on, straight.

    The side slope asks for 0.3 of the friction; two driven wheels of ten can pull with 0.1 * 0.29 of the weight.
    """
    v = longer_semitrailer
    slope = {"grade": 0.005, "fall": 0.03}
    rest = after(v, rolling(v, 3.0), given(v, 0.1, -0.4, **slope), 12.0)
    held = after(v, rest, given(v, 0.1, -0.4, **slope), 4.0)
    assert max(abs(held.x[0] - rest.x[0]), abs(held.y[0] - rest.y[0])) / 4.0 < 1e-3  # [m/s] of creep
    assert np.abs(held.omega).max() < 0.02
    off = after(v, held, given(v, 0.1, 0.2, **slope), 6.0)
    assert off.v_x[0] > 0.3
    assert abs(off.psi - held.psi).max() < 0.05  # [rad]: nothing steers against the drift of 0.3 / (5 / 0.1) rad
    assert abs(off.y[0] - held.y[0]) < 0.15 * (off.x[0] - held.x[0])


@pytest.mark.parametrize("friction", [0.1, 0.8])
def test_halving_the_step_quarters_the_error(tractor_semitrailer: Vehicle, friction: float) -> None:
    """Second order with everything in it: steering and braking at once, down to the plant's own step."""
    u, start = given(tractor_semitrailer, friction, -0.5, steer=0.03), rolling(tractor_semitrailer, 8.0)
    exact = after(tractor_semitrailer, start, u, 1.5, TICK / 16.0)
    errors = []
    for h in (4.0 * TICK, 2.0 * TICK, TICK):
        end = after(tractor_semitrailer, start, u, 1.5, h)
        errors.append(np.hypot(end.x[0] - exact.x[0], end.y[0] - exact.y[0]))
    np.testing.assert_allclose(np.diff(np.log2(errors)), -2.0, atol=0.3)  # not quite asymptotic at 4 ms
    assert errors[-1] < 2e-3  # [m], over 11 m
