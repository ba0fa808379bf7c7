"""The whole equations of motion: forces between bodies, symmetries, relaxation rates, slip angles."""

import math
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import TypeVar

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from offtrack.studies.validation.equations import ChainMotion, newton_euler, random_inputs, random_states
from tests.vehicle.chains import outputs, rates
from vehicle.combination.chain import derivative, relaxation
from vehicle.combination.description import Vehicle, brake_channels
from vehicle.combination.layout import Chain, Input, State, input_sizes, parts, state_sizes, wheels
from vehicle.combination.linear import SIGNS
from vehicle.engine.integrator import exact_diagonal
from vehicle.frames import Pose2

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=40)  # the first example of a chain compiles it

LATERAL_INPUT = Input(
    steer=-1,
    acceleration=1,
    gear=1,
    friction=1,
    gravity_x=1,
    gravity_y=-1,
    road=1,
    wind=-1,
    drive_torque=1,
    brake_torque=1,
    brake_share=1,
)
PER_WHEEL = {"omega", "deflection_x", "deflection_y", "brake_windup", "friction", "road"}


def random_state(vehicle: Vehicle, seed: int) -> tuple[State[np.ndarray], Input[np.ndarray]]:
    rng = np.random.default_rng(seed)
    x, u = random_states(vehicle, rng, 2)[:, 0], random_inputs(vehicle, rng, 2)[:, seed % 2]  # in either gear
    return State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle)))


def close(got: State[np.ndarray], expected: State[np.ndarray]) -> None:
    for name, a, b in zip(State._fields, got, expected, strict=True):
        # Rounding only, relative to the largest entry; accelerations come from forces of 1e6 N that nearly cancel.
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(b).max(initial=0.0)), err_msg=name)


def test_hitch_forces_are_those_that_hold_the_bodies_together(chain: Vehicle) -> None:
    """The hitch force a chain settles on, under its own tyre forces and gravity, body by body."""
    for seed in range(20):
        now, inputs = random_state(chain, seed)
        ground, rate = outputs(chain, now, inputs), rates(chain, now, inputs)
        c, si = math.cos(now.psi[0]), math.sin(now.psi[0])
        R_WT = np.array([[c, -si], [si, c]])
        weights = np.array([unit.mass for unit in chain.units])
        gravity = weights[:, None] * np.column_stack([inputs.gravity_x, inputs.gravity_y])
        forces = np.column_stack([ground.force_x, ground.force_y]) @ R_WT.T + gravity
        motion = ChainMotion(now.psi, R_WT @ np.array([now.v_x[0], now.v_y[0]]), now.yaw_rate)
        _, hitches = newton_euler(chain, motion, forces, ground.moment)
        lag = np.array([unit.hitch_lag for unit in chain.units[1:]])
        # the state follows the force within that lag: rate = (force - state) / lag
        got = np.column_stack([now.hitch_x + lag * rate.hitch_x, now.hitch_y + lag * rate.hitch_y])
        own = [Pose2(0.0, 0.0, -psi).apply(F[None])[0] for psi, F in zip(now.psi[1:], hitches, strict=True)]
        np.testing.assert_allclose(got, np.reshape(own, (-1, 2)), rtol=1e-9, atol=1e-3)  # of 1e6 N


Named = TypeVar("Named", State[np.ndarray], Input[np.ndarray])


def mirrored(vehicle: Vehicle, named: Named, signs: State[int] | Input[int]) -> Named:
    swap = np.arange(vehicle.n_wheels).reshape(-1, 2)[:, ::-1].ravel()
    channels = brake_channels(vehicle)
    pressures = np.array([channel.mirrored for channel in channels], dtype=int)
    modulated = [channel for channel in channels if channel.valve is not None]
    valves = np.array([channels[channel.mirrored].valve for channel in modulated], dtype=int)
    swaps = {**dict.fromkeys(PER_WHEEL, swap), "brake_pressure": pressures, "brake_valve": valves}
    swaps |= dict.fromkeys(("twin_x", "twin_y"), np.arange(state_sizes(vehicle).twin_x).reshape(-1, 2)[:, ::-1].ravel())
    fields = zip(named._fields, named, signs, strict=True)
    return type(named)(*(sign * (part[swaps[name]] if name in swaps else part) for name, part, sign in fields))


@few
@given(seeds)
def test_mirror_symmetry(chain: Vehicle, seed: int) -> None:
    """Swapping left and right must flip every lateral quantity: this pins all the signs at once."""
    s, u = random_state(chain, seed)
    got = rates(chain, mirrored(chain, s, SIGNS), mirrored(chain, u, LATERAL_INPUT))
    close(got, mirrored(chain, rates(chain, s, u), SIGNS))


@few
@given(seeds, st.floats(-3.0, 3.0))
def test_nothing_depends_on_where_north_is(chain: Vehicle, seed: int, turn: float) -> None:
    s, u = random_state(chain, seed)
    c, si = math.cos(turn), math.sin(turn)
    ds = rates(chain, s, u)
    turned = u._replace(gravity_x=c * u.gravity_x - si * u.gravity_y, gravity_y=si * u.gravity_x + c * u.gravity_y)
    got = rates(chain, s._replace(psi=s.psi + turn, x=s.x + 7.0), turned)
    close(got, ds._replace(x=c * ds.x - si * ds.y, y=si * ds.x + c * ds.y))


@lru_cache(maxsize=4)
def both_diagonals(vehicle: Vehicle) -> ca.Function:
    """Function (state, input) -> relaxation as the chain gives it, and as differentiation does [1/s]."""
    x, u = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))
    named = State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle)))
    at = State(*pairwise(accumulate(state_sizes(vehicle), initial=0)))
    blocks = [at.omega, at.deflection_x, at.deflection_y, at.brake_windup]
    exact = exact_diagonal(ca.vertcat(*derivative(Chain.of(vehicle), *named)), x, blocks)
    return ca.Function("both", [x, u], [ca.vertcat(*relaxation(Chain.of(vehicle), *named)), -exact])


@few
@given(seeds)
def test_the_relaxation_is_the_jacobians_diagonal(chain: Vehicle, seed: int) -> None:
    """Exactly that of tyre deflections and brakes; of a wheel's spin where its tyre sticks or slides all over.

    In between a law's own curvature is left out: the method's order does not need it. A deflection along the wheel
    relaxes more slowly than stated, by 1 + damping times the stated rate: the damped carcass is in series with sliding.
    """
    both = both_diagonals(chain)
    s, given = random_state(chain, seed)
    got, expected = (np.array(one).ravel() for one in both(np.concatenate(s), np.concatenate(given)))
    at = State(*pairwise(accumulate(state_sizes(chain), initial=0)))
    spin = np.zeros(len(got), dtype=bool)
    spin[slice(*at.omega)] = True
    damped = np.ones(len(got))
    along = slice(*at.deflection_x)
    damped[along] += np.array([wheel.axle.tyre.damping for wheel in wheels(chain)]) * got[along]
    np.testing.assert_allclose((got / damped)[~spin], expected[~spin], rtol=1e-9, atol=1e-9)
    assert (got >= 0.0).all()
    rolling = [s.v_x[0] / wheel.axle.wheel_radius for wheel in wheels(chain)]
    calm = State(*(np.zeros(n) for n in state_sizes(chain)))._replace(v_x=s.v_x, omega=np.array(rolling))
    got, expected = (np.array(one).ravel()[spin] for one in both(np.concatenate(calm), np.concatenate(given)))
    np.testing.assert_allclose(got, expected, rtol=1e-3)  # the power limit of the engine, the rounding of no slip
