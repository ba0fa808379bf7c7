"""The whole equations of motion: power balance, symmetries, and the linear theory they contain."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import TypeVar

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle.combination.chain import derivative, relaxation
from vehicle.combination.description import GRAVITY, Vehicle, brake_channels
from vehicle.combination.functions import compiled_derivative, compiled_output
from vehicle.combination.layout import (
    Chain,
    Input,
    Output,
    State,
    input_sizes,
    output_sizes,
    parts,
    state_sizes,
    wheels,
)
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Unit
from vehicle.engine.integrator import exact_diagonal
from vehicle.tyres import ROLLING_SPEED_FLOOR

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=40)  # the first example of a chain compiles it

SCALE = State(  # typical sizes, to draw random states from
    x=50.0,
    y=50.0,
    psi=3.0,
    v_x=15.0,
    v_y=3.0,
    yaw_rate=0.5,
    heave=0.03,
    pitch=0.01,
    roll=0.03,
    heave_spring=0.2,
    pitch_spring=0.05,
    roll_spring=0.2,
    load_shift=1e4,
    side_force=3e4,
    hitch_x=3e4,
    hitch_y=3e4,
    omega=40.0,
    deflection_x=0.05,
    deflection_y=0.15,
    brake_windup=1.0,
    twin_x=0.1,
    twin_y=0.1,
    steer=0.4,
    acceleration=3.0,
    brake_pressure=1.0,
    brake_valve=1.0,
)
LATERAL = State(  # +1: stays in a mirror, -1: flips
    x=1,
    y=-1,
    psi=-1,
    v_x=1,
    v_y=-1,
    yaw_rate=-1,
    heave=1,
    pitch=1,
    roll=-1,
    heave_spring=1,
    pitch_spring=1,
    roll_spring=-1,
    load_shift=1,
    side_force=-1,
    hitch_x=1,
    hitch_y=-1,
    omega=1,
    deflection_x=1,
    deflection_y=-1,
    brake_windup=1,
    twin_x=1,
    twin_y=-1,
    steer=-1,
    acceleration=1,
    brake_pressure=1,
    brake_valve=1,
)
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
    s = State(*(scale * rng.uniform(-1, 1, n) for scale, n in zip(SCALE, state_sizes(vehicle), strict=True)))
    sizes = input_sizes(vehicle)
    u = Input(
        steer=rng.uniform(-0.5, 0.5, sizes.steer),
        acceleration=rng.uniform(-5, 2, 1),
        gear=np.array([1.0 if seed % 2 else -1.0]),
        friction=rng.uniform(0.1, 1.0, sizes.friction),
        gravity_x=rng.uniform(-1, 1, sizes.gravity_x),
        gravity_y=rng.uniform(-1, 1, sizes.gravity_y),
        road=rng.uniform(-0.02, 0.02, sizes.road),
        wind=rng.uniform(-20, 20, sizes.wind),
        drive_torque=rng.uniform(-5e3, 5e3, sizes.drive_torque),
        brake_torque=rng.uniform(0, 1e4, sizes.brake_torque),
        brake_share=rng.uniform(0, 1, sizes.brake_share),
    )
    return s, u


def rate(vehicle: Vehicle, s: State[np.ndarray], u: Input[np.ndarray]) -> State[np.ndarray]:
    dx = np.array(compiled_derivative(vehicle)(np.concatenate(s), np.concatenate(u))).ravel()
    return State(*parts(dx, state_sizes(vehicle)))


def told(vehicle: Vehicle, s: State[np.ndarray], u: Input[np.ndarray]) -> Output[np.ndarray]:
    out = np.array(compiled_output(vehicle)(np.concatenate(s), np.concatenate(u))).ravel()
    return Output(*parts(out, output_sizes(vehicle)))


def close(got: State[np.ndarray], expected: State[np.ndarray]) -> None:
    for name, a, b in zip(State._fields, got, expected, strict=True):
        # Rounding only, relative to the largest entry; accelerations come from forces of 1e6 N that nearly cancel.
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(b).max(initial=0.0)), err_msg=name)


def kinetic_energy(vehicle: Vehicle, s: State[np.ndarray]) -> tuple[float, list[np.ndarray]]:
    """Energy [J], and the velocity of each centre of gravity along W (N, 2) [m/s], by hand."""
    c, si = math.cos(s.psi[0]), math.sin(s.psi[0])
    v = np.array([c * s.v_x[0] - si * s.v_y[0], si * s.v_x[0] + c * s.v_y[0]])
    energy, velocities = 0.0, []
    for unit, psi, r in zip(vehicle.units, s.psi, s.yaw_rate, strict=True):
        left = np.array([-math.sin(psi), math.cos(psi)])
        velocities.append(v + r * unit.cg_x * left)
        energy += 0.5 * unit.mass * float(velocities[-1] @ velocities[-1]) + 0.5 * unit.yaw_inertia * r**2
        v = v + r * unit.rear_hitch[0] * left
    return energy, velocities


@few
@given(seeds)
def test_kinetic_energy_changes_by_the_power_of_tyres_and_gravity(chain: Vehicle, seed: int) -> None:
    """Hitches do no work: dT/dt is the power of the ground's forces and of the weight along the slope."""
    s, u = random_state(chain, seed)
    ds, out = rate(chain, s, u), told(chain, s, u)
    energy, velocities = kinetic_energy(chain, s)
    h = 1e-6  # [s]
    plus, minus = (
        kinetic_energy(chain, State(*(a + sign * h * b for a, b in zip(s, ds, strict=True))))[0] for sign in (1, -1)
    )
    c, si = math.cos(s.psi[0]), math.sin(s.psi[0])
    power = float(out.moment @ s.yaw_rate)
    for i, unit in enumerate(chain.units):
        F = np.array([c * out.force_x[i] - si * out.force_y[i], si * out.force_x[i] + c * out.force_y[i]])
        weight = unit.mass * np.array([u.gravity_x[i], u.gravity_y[i]])
        power += float((F + weight) @ velocities[i])
    # A central difference of some 1e7 J over 2e-6 s keeps about 1e-9 * T / h; powers are of 1e6 W.
    assert (plus - minus) / (2 * h) == pytest.approx(power, rel=1e-6, abs=1e-16 / h * energy * 10 + 10.0)


Named = TypeVar("Named", State[np.ndarray], Input[np.ndarray])


def mirrored(vehicle: Vehicle, named: Named, signs: State[int] | Input[int]) -> Named:
    """Left and right swapped."""
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
    got = rate(chain, mirrored(chain, s, LATERAL), mirrored(chain, u, LATERAL_INPUT))
    close(got, mirrored(chain, rate(chain, s, u), LATERAL))


@few
@given(seeds, st.floats(-3.0, 3.0))
def test_nothing_depends_on_where_north_is(chain: Vehicle, seed: int, turn: float) -> None:
    """The world turned under the vehicle turns its velocity in W and nothing else."""
    s, u = random_state(chain, seed)
    c, si = math.cos(turn), math.sin(turn)
    ds = rate(chain, s, u)
    turned = u._replace(gravity_x=c * u.gravity_x - si * u.gravity_y, gravity_y=si * u.gravity_x + c * u.gravity_y)
    got = rate(chain, s._replace(psi=s.psi + turn, x=s.x + 7.0), turned)
    close(got, ds._replace(x=c * ds.x - si * ds.y, y=si * ds.x + c * ds.y))


def test_no_wheel_exceeds_its_friction(longer_semitrailer: Vehicle) -> None:
    """In any state, of any wheel: horizontal force over friction times load is at most 1; 20 000 random ones."""
    drawn = [random_state(longer_semitrailer, seed) for seed in range(2000)]
    states, inputs = (np.array([np.concatenate(one) for one in of_all]).T for of_all in zip(*drawn, strict=True))
    out = compiled_output(longer_semitrailer).map(len(drawn))(states, inputs)
    told = Output(*parts(np.array(out), output_sizes(longer_semitrailer)))
    assert told.friction_used.shape == (10, 2000)
    assert told.friction_used.max() <= 1.0 + 1e-12
    assert told.load.min() > 0.0


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


@few
@given(seeds)
def test_slip_angles_are_those_of_rigid_body_motion(chain: Vehicle, seed: int) -> None:
    """alpha = atan2(v_y, |v_x|) - delta at every wheel of the last unit, whose velocity is built up by hand."""
    s, u = random_state(chain, seed)
    c, si = math.cos(s.psi[-1]), math.sin(s.psi[-1])
    v = np.array(
        [
            math.cos(s.psi[0]) * s.v_x - math.sin(s.psi[0]) * s.v_y,
            math.sin(s.psi[0]) * s.v_x + math.cos(s.psi[0]) * s.v_y,
        ]
    ).ravel()
    for unit, psi, r in list(zip(chain.units, s.psi, s.yaw_rate, strict=True))[:-1]:
        v = v + r * unit.rear_hitch[0] * np.array([-math.sin(psi), math.cos(psi)])
    own = np.array([c * v[0] + si * v[1], -si * v[0] + c * v[1]])
    last = len(chain.units) - 1
    alphas = told(chain, s, u).slip_angle
    for k, wheel in enumerate(wheels(chain)):
        if wheel.unit == last and wheel.steer is None:
            at = own + s.yaw_rate[-1] * np.array([-wheel.y, wheel.axle.x])
            assert alphas[k] == pytest.approx(math.atan2(at[1], max(abs(at[0]), ROLLING_SPEED_FLOOR)), abs=1e-12)


@pytest.mark.parametrize("speed", [10.0, -10.0])
def test_side_forces_act_behind_the_wheels_by_the_pneumatic_trail(tractor_semitrailer: Vehicle, speed: float) -> None:
    """Behind as the wheel rolls: deflected tyres without slip turn each unit by minus trail times side force more."""
    bare = tuple(
        unit.model_copy(
            update={
                "axles": tuple(
                    axle.model_copy(update={"tyre": axle.tyre.model_copy(update={"pneumatic_trail": 0.0})})
                    for axle in unit.axles
                )
            }
        )
        for unit in tractor_semitrailer.units
    )
    x, u = rolling_straight(tractor_semitrailer, speed)
    s, given_u = (
        State(*parts(x, state_sizes(tractor_semitrailer)))._replace(
            deflection_y=np.full(10, -0.05), brake_windup=np.full(10, math.copysign(1.0, speed))
        ),
        Input(*parts(u, input_sizes(tractor_semitrailer))),
    )
    with_trail = told(tractor_semitrailer, s, given_u)
    without = told(tractor_semitrailer.model_copy(update={"units": bare}), s, given_u)
    for i, unit in enumerate(tractor_semitrailer.units):
        expected = sum(
            # both wheels of an axle carry their nominal load to 1e-3 and pull alike
            -math.copysign(axle.tyre.pneumatic_trail, speed) * with_trail.force_y[i] * load / sum(loads)
            for loads in [static_axle_loads(tractor_semitrailer)[i]]
            for axle, load in zip(unit.axles, loads, strict=True)
        )
        assert with_trail.force_y[i] < -1e3
        assert with_trail.moment[i] - without.moment[i] == pytest.approx(expected, rel=5e-3)


# --- linear theory ---------------------------------------------------------------------------------------------


def rolling_straight(vehicle: Vehicle, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """State and input of the straight combination on dry, level road."""
    s = State(*(np.zeros(n) for n in state_sizes(vehicle)))
    s = s._replace(v_x=np.array([speed]), omega=np.array([speed / w.axle.wheel_radius for w in wheels(vehicle)]))
    u = Input(*(np.zeros(n) for n in input_sizes(vehicle)))
    return np.concatenate(s), np.concatenate(u._replace(friction=np.ones(vehicle.n_wheels)))


def lateral_matrix(vehicle: Vehicle, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """A and b of (v_y, yaw rates, articulations), tyres without relaxation; the input is the tractor's steer angle.

    Spin and tyre deflection follow at once: 0 = J_ff f + J_fs s. All else decouples by symmetry.
    """
    f = compiled_derivative(vehicle)
    x, u = ca.SX.sym("x", f.numel_in(0)), ca.SX.sym("u", f.numel_in(1))
    J = np.array(ca.Function("J", [x, u], [ca.jacobian(f(x, u), x)])(*rolling_straight(vehicle, speed)))
    at = State(*(list(range(*span)) for span in pairwise(accumulate(state_sizes(vehicle), initial=0))))
    slow = [*at.v_y, *at.yaw_rate, *at.psi, at.steer[0]]
    fast = [*at.omega, *at.deflection_x, *at.deflection_y]
    K = J[np.ix_(slow, slow)] - J[np.ix_(slow, fast)] @ np.linalg.solve(J[np.ix_(fast, fast)], J[np.ix_(fast, slow)])
    N = len(vehicle.units)
    keep = 1 + N
    A = np.zeros((2 * N, 2 * N))
    A[:keep, :keep] = K[:keep, :keep]
    A[:keep, keep:] = K[:keep, keep + 1 : keep + N]  # psi_i at psi_1 = 0 is minus the sum of articulations
    A[keep:, 2:keep] = np.eye(N - 1)
    A[keep:, 1] = -1.0
    return A, K[:keep, -1]


def axle_stiffness(unit: Unit, loads: list[float]) -> list[tuple[float, float]]:
    """x [m] and cornering stiffness [N/rad] of each axle at its static load."""
    return [
        (axle.x, float(axle.tyre.stiffness(load / 2).y) * load) for axle, load in zip(unit.axles, loads, strict=True)
    ]


def by_hand(vehicle: Vehicle, V: float) -> np.ndarray:
    """Single-track matrix of a tractor-semitrailer in (v_y of the rear axle, r_1, r_2, psi_2 - psi_1), Newton-Euler.

    Lateral accelerations: tractor CG a_1 = v' + V r_1 + x_1 r_1'; hitch a_h = v' + V r_1 + h r_1'; trailer CG
    a_2 = a_h + x_2 r_2'. Lateral velocity on the trailer at x, across it: v + h r_1 + x r_2 - V (psi_2 - psi_1).
    """
    tractor, trailer = vehicle.units
    h, x_1, x_2 = tractor.rear_hitch[0], tractor.cg_x, trailer.cg_x
    m_1, m_2, I_1, I_2 = tractor.mass, trailer.mass, tractor.yaw_inertia, trailer.yaw_inertia
    loads = static_axle_loads(vehicle)
    front = [(x, -C / V * np.array([1.0, x, 0.0, 0.0])) for x, C in axle_stiffness(tractor, loads[0])]
    rear = [(x, -C / V * np.array([1.0, h, x, -V])) for x, C in axle_stiffness(trailer, loads[1])]
    turning = np.array([0.0, V, 0.0, 0.0])
    a_1, a_2 = np.array([1.0, x_1, 0, 0]), np.array([1.0, h, x_2, 0])
    F_1, F_2 = sum(F for _, F in front), sum(F for _, F in rear)
    M = np.zeros((4, 4))
    K = np.zeros((4, 4))
    M[0], K[0] = m_1 * a_1 + m_2 * a_2, F_1 + F_2 - (m_1 + m_2) * turning
    # Tractor about its CG: the hitch force on it is F_2 - m_2 a_2.
    M[1] = np.array([0, I_1, 0, 0]) + (h - x_1) * m_2 * a_2
    K[1] = sum((x - x_1) * F for x, F in front) + (h - x_1) * (F_2 - m_2 * turning)
    # Trailer about the hitch.
    M[2] = np.array([0, 0, I_2, 0]) + x_2 * m_2 * a_2
    K[2] = sum(x * F for x, F in rear) - x_2 * m_2 * turning
    M[3], K[3] = [0, 0, 0, 1], [0, -1, 1, 0]
    return np.linalg.solve(M, K)


@pytest.mark.parametrize("speed", [5.0, 15.0, 25.0])
def test_small_motions_are_those_of_the_single_track_model(tractor_semitrailer: Vehicle, speed: float) -> None:
    """Eigenvalues against a matrix derived by hand with the same axle stiffness."""
    A, _ = lateral_matrix(tractor_semitrailer, speed)
    got, expected = (np.sort_complex(np.linalg.eigvals(matrix)) for matrix in (A, by_hand(tractor_semitrailer, speed)))
    # Slip is taken over sqrt(V^2 + 0.05^2), a relative (0.05 / V)^2 / 2; the rest is rolling resistance.
    np.testing.assert_allclose(got, expected, rtol=(0.05 / speed) ** 2 + 5e-6)


def with_one_trailer_axle(vehicle: Vehicle) -> Vehicle:
    """The tridem as one axle in its middle, of the same stiffness over load."""
    tractor, trailer = vehicle.units
    middle = trailer.axles[1]
    tyre = middle.tyre.model_copy(update={"nominal_load": 3.0 * middle.tyre.nominal_load})
    axle = middle.model_copy(update={"tyre": tyre})
    return vehicle.model_copy(update={"units": (tractor, trailer.model_copy(update={"axles": (axle,)}))})


def test_eigenvalues_of_the_audited_set_are_the_published_ones(tractor_semitrailer: Vehicle) -> None:
    """rl_path_planning's audit at 24 m/s: -2.46082646 +- 2.01398867j and -0.82568020 +- 2.21590363j 1/s."""
    A, _ = lateral_matrix(with_one_trailer_axle(tractor_semitrailer), 24.0)
    published = [
        -2.46082646 - 2.01398867j,
        -2.46082646 + 2.01398867j,
        -0.82568020 - 2.21590363j,
        -0.82568020 + 2.21590363j,
    ]
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(A)), published, rtol=1e-4
    )  # stiffness is given to three figures


@pytest.mark.parametrize("speed", [5.0, 10.0, 20.0])
def test_understeer_gradient_of_the_tractor_alone(tractor_semitrailer: Vehicle, speed: float) -> None:
    """Steady yaw rate over steer angle: V / (L + K V^2), K from masses and axle stiffness."""
    alone = tractor_semitrailer.model_copy(update={"units": tractor_semitrailer.units[:1]})
    (L, C_f), (_, C_r) = axle_stiffness(alone.units[0], static_axle_loads(alone)[0])
    F_f, F_r = static_axle_loads(alone)[0]
    K = (F_f / C_f - F_r / C_r) / GRAVITY
    A, b = lateral_matrix(alone, speed)
    steady = -np.linalg.solve(A[:2, :2], b)
    assert steady[1] == pytest.approx(speed / (L + K * speed**2), rel=1e-5)  # rolling resistance, friction of 1
