"""The equations of motion against two derivations that share nothing with them: Lagrange by hand, Newton and Euler."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from offtrack.studies.validation.mechanics import Accelerations, Motion, lagrange, modelled, newton_euler
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import compiled_derivative, compiled_output
from vehicle.combination.layout import Input, Output, State, input_sizes, output_sizes, parts, state_sizes
from vehicle.frames import FloatArray, Pose2

seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=100)  # the first example loads CasADi


def random_chain(vehicle: Vehicle, n: int, rng: np.random.Generator) -> Vehicle:
    """n units of random masses, inertias and places, from a cart to a laden road train."""
    unit = vehicle.units[-1]
    units = tuple(
        unit.model_copy(
            update={
                "mass": rng.uniform(500.0, 40000.0),
                "yaw_inertia": rng.uniform(500.0, 500000.0),
                "cg_x": rng.uniform(-8.0, 3.0),
                "hitch_x": rng.uniform(-12.0, 2.0),
            }
        )
        for _ in range(n)
    )
    return vehicle.model_copy(update={"units": units})


def random_motion(n: int, rng: np.random.Generator) -> tuple[Motion, FloatArray, FloatArray]:
    """Any headings, 10 m/s and 1 rad/s to any side, and forces and moments on every unit."""
    now = Motion(rng.uniform(-math.pi, math.pi, n), rng.uniform(-10.0, 10.0, 2), rng.uniform(-1.0, 1.0, n))
    return now, rng.uniform(-1e5, 1e5, (n, 2)), rng.uniform(-1e5, 1e5, n)


def random_state(vehicle: Vehicle, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """State and input vectors, wilder than any drive."""
    sizes, given = state_sizes(vehicle), input_sizes(vehicle)
    s = State(*(rng.uniform(-0.1, 0.1, n) for n in sizes))._replace(
        psi=rng.uniform(-1.0, 1.0, sizes.psi),
        v_x=rng.uniform(5.0, 20.0, 1),
        v_y=rng.uniform(-2.0, 2.0, 1),
        yaw_rate=rng.uniform(-0.5, 0.5, sizes.yaw_rate),
        omega=rng.uniform(10.0, 40.0, sizes.omega),
        hitch_x=rng.uniform(-1e4, 1e4, sizes.hitch_x),
        hitch_y=rng.uniform(-1e4, 1e4, sizes.hitch_y),
    )
    u = Input(*(np.zeros(n) for n in given))._replace(
        friction=rng.uniform(0.2, 1.0, given.friction),
        gravity_x=rng.uniform(-1.0, 1.0, given.gravity_x),
        gravity_y=rng.uniform(-1.0, 1.0, given.gravity_y),
    )
    return np.concatenate(s), np.concatenate(u)


def agree(got: Accelerations, expected: Accelerations) -> None:
    """To 1e-9 of the largest acceleration: rounding, times the condition of a system of masses and inertias."""
    scale = max(np.abs(expected.origin).max(), np.abs(expected.yaw).max())
    np.testing.assert_allclose(got.origin, expected.origin, rtol=0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(got.yaw, expected.yaw, rtol=0.0, atol=1e-9 * scale)


@pytest.mark.parametrize("n", [1, 2, 3])
@many
@given(seed=seeds)
def test_the_model_is_lagranges(tractor_semitrailer: Vehicle, n: int, seed: int) -> None:
    """Energies know nothing of hitch forces or partial velocities."""
    rng = np.random.default_rng(seed)
    chain = random_chain(tractor_semitrailer, n, rng)
    now, forces, moments = random_motion(n, rng)
    agree(modelled(chain, now, forces, moments), lagrange(chain, now, forces, moments))


@pytest.mark.parametrize("n", [1, 2, 3])
@many
@given(seed=seeds)
def test_the_model_is_newtons_and_eulers(tractor_semitrailer: Vehicle, n: int, seed: int) -> None:
    """Each body on its own, held to its neighbours by unknown forces."""
    rng = np.random.default_rng(seed)
    chain = random_chain(tractor_semitrailer, n, rng)
    now, forces, moments = random_motion(n, rng)
    got, _ = newton_euler(chain, now, forces, moments)
    agree(modelled(chain, now, forces, moments), got)


def test_a_trailer_pulled_straight_takes_its_share_of_the_force(tractor_semitrailer: Vehicle) -> None:
    """In line, the hitch carries what accelerates the trailer's mass; square to it a free-standing one swings."""
    trailer = tractor_semitrailer.units[1]
    still = Motion(np.zeros(2), np.zeros(2), np.zeros(2))
    pull = np.array([[1e4, 0.0], [0.0, 0.0]])
    got, hitch = newton_euler(tractor_semitrailer, still, pull, np.zeros(2))
    assert got.origin[0] == pytest.approx(1e4 / tractor_semitrailer.mass)
    np.testing.assert_allclose(hitch, [[1e4 * trailer.mass / tractor_semitrailer.mass, 0.0]], atol=1e-9)


def test_hitch_forces_are_those_that_hold_the_bodies_together(chain: Vehicle) -> None:
    """The hitch force a chain settles on, from its own tyre forces and gravity in random states, body by body."""
    told, rate = compiled_output(chain), compiled_derivative(chain)
    rng = np.random.default_rng(7)
    for _ in range(20):
        s, u = random_state(chain, rng)
        ground = Output(*parts(np.array(told(s, u)).ravel(), output_sizes(chain)))
        now, inputs = State(*parts(s, state_sizes(chain))), Input(*parts(u, input_sizes(chain)))
        rates = State(*parts(np.array(rate(s, u)).ravel(), state_sizes(chain)))
        c, si = math.cos(now.psi[0]), math.sin(now.psi[0])
        R_WT = np.array([[c, -si], [si, c]])
        weights = np.array([unit.mass for unit in chain.units])
        gravity = weights[:, None] * np.column_stack([inputs.gravity_x, inputs.gravity_y])
        forces = np.column_stack([ground.force_x, ground.force_y]) @ R_WT.T + gravity
        motion = Motion(now.psi, R_WT @ np.array([now.v_x[0], now.v_y[0]]), now.yaw_rate)
        accelerations, hitches = newton_euler(chain, motion, forces, ground.moment)
        np.testing.assert_allclose(rates.yaw_rate, accelerations.yaw, rtol=1e-9, atol=1e-9)  # forces of 1e6 N
        lag = np.array([unit.hitch_lag for unit in chain.units[1:]])
        # the state follows the force within that lag: rate = (force - state) / lag
        got = np.column_stack([now.hitch_x + lag * rates.hitch_x, now.hitch_y + lag * rates.hitch_y])
        own = [Pose2(0.0, 0.0, -psi).apply(F[None])[0] for psi, F in zip(now.psi[1:], hitches, strict=True)]
        np.testing.assert_allclose(got, np.reshape(own, (-1, 2)), rtol=1e-9, atol=1e-3)  # of 1e6 N
