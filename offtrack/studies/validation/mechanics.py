"""Checks of the model's mechanics: conservation laws, independent derivations, and the friction circle.

The first uses Lagrange's equations, derived by hand from the kinetic energy; the second the equations of Newton and
Euler for each body, with the hitch forces as unknowns. Both use axes of W and numpy, and share only the data with the
model: masses, inertias and positions.

With e_a the direction of unit a and n_a square to it, a centre of gravity lies at r_i = p + sum_a c_ia e_a, where c_ia
is the distance between the hitches of each unit ahead, and the position of the centre of gravity in its own unit.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from offtrack.studies.validation.check import Check, CheckSection
from offtrack.studies.validation.simple_drives import runge_kutta
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.functions import compiled_output
from vehicle.combination.layout import Input, Output, State, input_sizes, output_sizes, parts, state_sizes
from vehicle.combination.multibody import Speeds, Vector, speed_rates
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray

_FREE, _FREE_STEP = 20.0, 1e-3  # duration of the free motion, and step of the classical Runge-Kutta method [s]
_DESCENT, _DESCENT_STEP = 10.0, 2e-3  # the same of the descent; the method's error is of the order of rounding
_SLOPE: Final = np.array([0.5, -0.3])  # gravity along the ground [m/s2]
_MECHANICS: Final = "follows from the mechanics; tolerance: rounding over the steps"


def conservation(vehicle: Vehicle) -> tuple[Check, ...]:
    """Changes of energy and momenta of a chain that tumbles freely without external forces."""
    n = len(vehicle.units)
    model = _without_tyres(vehicle, _FREE, _FREE_STEP)
    start = np.concatenate([[3.0, -2.0], np.linspace(0.0, 1.0, n), [8.0, 1.5], np.linspace(0.8, -1.1, n)])
    end = np.array(model.step(start, np.zeros(2))).ravel()
    before, after = ([np.array(part).ravel() for part in model.invariants(y)] for y in (start, end))
    bounds = (("energy", 1e-12), ("momentum", 1e-11), ("angular momentum", 3e-10))
    return tuple(
        Check(
            f"{n} units, {_FREE:g} s without forces: relative change of {name}",
            float(np.linalg.norm(b - a) / np.linalg.norm(a)),
            tolerance=bound,
            source=_MECHANICS,
        )
        for (name, bound), a, b in zip(bounds, before, after, strict=True)
    )


def gravity_work(vehicle: Vehicle) -> Check:
    """Energy gained on a uniform slope, compared with the work of gravity on each centre of gravity."""
    model = _without_tyres(vehicle, _DESCENT, _DESCENT_STEP)
    start = np.array([0.0, 0.0, 0.0, 0.5, 5.0, 0.0, 0.4, -0.3])  # of two units
    end = np.array(model.step(start, _SLOPE)).ravel()
    gained = float(model.invariants(end)[0] - model.invariants(start)[0])
    displacements = np.array(model.centres(end)) - np.array(model.centres(start))
    work = float(np.array([unit.mass for unit in vehicle.units]) @ (displacements @ _SLOPE))
    return Check(
        name=f"2 units, {_DESCENT:g} s down a slope: energy gained minus work of gravity, relative",
        value=abs(gained / work - 1.0),
        tolerance=1e-14,  # a random walk of rounding over 5000 steps
        source=_MECHANICS,
    )


class _FreeChain(NamedTuple):
    """A chain without tyres, as functions of its origin's position, its headings, and their rates, along W."""

    step: Any  # (q, q', gravity) -> (q, q') after many steps
    invariants: Any  # (q, q') -> energy [J], momentum (2,) [N s], angular momentum about W's origin [N m s]
    centres: Any  # q -> (N, 2) of the centres of gravity [m]


def _without_tyres(vehicle: Vehicle, duration: float, step: float) -> _FreeChain:
    n = 2 + len(vehicle.units)
    q, rate, gravity = ca.SX.sym("q", n), ca.SX.sym("rate", n), ca.SX.sym("gravity", 2)
    y = ca.vertcat(q, rate)
    f = ca.Function("f", [y, gravity], [ca.vertcat(rate, _accelerations(vehicle, q, rate, gravity))])
    one = ca.Function("one", [y, gravity], [runge_kutta(lambda _, y: f(y, gravity), 0.0, y, step)])
    centres = _centres(vehicle, q)
    velocities = [ca.jtimes(centre, q, rate) for centre in centres]
    bodies = list(zip(vehicle.units, centres, velocities, ca.vertsplit(rate[2:]), strict=True))
    energy = sum(0.5 * (b.mass * ca.dot(v, v) + b.yaw_inertia * r**2) for b, _, v, r in bodies)
    momentum = sum(b.mass * v for b, _, v, _ in bodies)
    spin = sum(b.mass * (p[0] * v[1] - p[1] * v[0]) + b.yaw_inertia * r for b, p, v, r in bodies)
    return _FreeChain(
        step=one.fold(round(duration / step)),
        invariants=ca.Function("invariants", [y], [energy, momentum, spin]),
        centres=ca.Function("centres", [y], [ca.horzcat(*centres).T]),
    )


def _accelerations(vehicle: Vehicle, q: ca.SX, rate: ca.SX, gravity: ca.SX) -> ca.SX:
    """Accelerations of the model, rotated from the tractor's axes to W."""
    psi = ca.vertsplit(q[2:])
    c, s = ca.cos(psi[0]), ca.sin(psi[0])
    v_x, v_y = c * rate[0] + s * rate[1], c * rate[1] - s * rate[0]
    pull = Vector(c * gravity[0] + s * gravity[1], c * gravity[1] - s * gravity[0])
    forces = [Vector(unit.mass * pull.x, unit.mass * pull.y) for unit in vehicle.units]
    rates = speed_rates(vehicle, psi, Speeds(v_x, v_y, ca.vertsplit(rate[2:])), forces, [0.0] * len(forces))
    a_x, a_y = rates.v_x - rate[2] * v_y, rates.v_y + rate[2] * v_x
    return ca.vertcat(c * a_x - s * a_y, s * a_x + c * a_y, *rates.yaw_rate)


def _centres(vehicle: Vehicle, q: ca.SX) -> list[ca.SX]:
    """Positions of the centres of gravity, along W."""
    centres, hitch = [], q[:2]
    for i, unit in enumerate(vehicle.units):
        axis = ca.vertcat(ca.cos(q[2 + i]), ca.sin(q[2 + i]))
        centres.append(hitch + unit.cg_x * axis)
        hitch = hitch + (unit.hitch_x or 0.0) * axis
    return centres


class ChainMotion(NamedTuple):
    """State of motion of a chain, along W."""

    psi: FloatArray  # (N,) yaw of each unit [rad]
    velocity: FloatArray  # (2,) of the first unit's origin [m/s]
    yaw_rate: FloatArray  # (N,) [rad/s]


class ChainAccelerations(NamedTuple):
    """Accelerations of a chain, along W."""

    origin: FloatArray  # (2,) of the first unit's origin [m/s2]
    yaw: FloatArray  # (N,) [rad/s2]


def modelled(vehicle: Vehicle, now: ChainMotion, forces: FloatArray, moments: FloatArray) -> ChainAccelerations:
    """Accelerations as from ``lagrange``, by the model, with vectors rotated between W and the tractor's axes."""
    c, s = math.cos(now.psi[0]), math.sin(now.psi[0])
    R_WT = np.array([[c, -s], [s, c]])
    v_x, v_y = (R_WT.T @ now.velocity).tolist()
    on_units = [Vector(*(R_WT.T @ force).tolist()) for force in forces]
    speeds = Speeds(v_x, v_y, now.yaw_rate.tolist())
    rates = speed_rates(vehicle, now.psi.tolist(), speeds, on_units, moments.tolist())
    turning = now.yaw_rate[0] * np.array([-v_y, v_x])  # due to the rotation of the tractor's axes
    return ChainAccelerations(R_WT @ (np.array([rates.v_x, rates.v_y]) + turning), np.array(rates.yaw_rate))


def lagrange(vehicle: Vehicle, now: ChainMotion, forces: FloatArray, moments: FloatArray) -> ChainAccelerations:
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
    return ChainAccelerations(solution[:2], solution[2:])


def newton_euler(
    vehicle: Vehicle, now: ChainMotion, forces: FloatArray, moments: FloatArray
) -> tuple[ChainAccelerations, FloatArray]:
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
    return ChainAccelerations(origin, solution[yaw:hitch]), solution[hitch:].reshape(N - 1, 2)


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


_STATES: Final = 200  # random states per chain
_RANGES: Final = State(  # half ranges of random states, wider than in any drive
    x=50.0,
    y=50.0,
    psi=3.0,
    v_x=25.0,
    v_y=5.0,
    yaw_rate=1.0,
    heave=0.1,
    pitch=0.1,
    roll=0.2,
    heave_spring=0.5,
    pitch_spring=0.5,
    roll_spring=0.5,
    load_shift=1e4,
    side_force=5e4,
    hitch_x=5e4,
    hitch_y=5e4,
    omega=60.0,
    deflection_x=0.3,
    deflection_y=0.3,
    brake_windup=1.0,
    twin_x=0.3,
    twin_y=0.3,
    steer=0.6,
    acceleration=5.0,
    brake_pressure=1.0,
    brake_valve=1.0,
)


def mechanics(quick: bool) -> CheckSection:
    """Checks of energy, momenta, work of gravity, two independent derivations, and the friction circle."""
    chains = [_chain(n) for n in (1, 2, 3, 4)]
    return CheckSection(
        title="Mechanics",
        text="Chains of rigid units tumble freely for 20 s and slide down a slope. Accelerations of chains of random "
        "data in random states are compared with two independent derivations, and tyre forces with the friction limit.",
        checks=(
            *(check for chain in chains[1:] for check in conservation(chain)),
            gravity_work(chains[1]),
            *(check for chain in chains for check in _derivations(chain)),
            _friction_circle(chains[-1], 2_000 if quick else 20_000),
        ),
    )


def _chain(n: int) -> Vehicle:
    """Tractor and n - 1 semi-trailers, all but the last with a hitch above its axles, as in a B-double."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    tractor, trailer = vehicle.units
    lead = trailer.model_copy(update={"hitch_x": -7.4, "hitch_height": 1.15})
    return vehicle.model_copy(update={"units": (tractor, *[lead] * (n - 2), trailer)[:n]})


def _derivations(vehicle: Vehicle) -> tuple[Check, ...]:
    """Largest difference from the accelerations of each derivation, over the largest acceleration."""
    n, rng = len(vehicle.units), np.random.default_rng(1)
    of_lagrange, of_newton = np.array([_differences(vehicle, rng) for _ in range(_STATES)]).max(axis=0).tolist()
    rows = (
        ("Lagrange", of_lagrange, "Lagrange's equations, derived by hand"),
        ("Newton and Euler", of_newton, "equations of each body, with the hitch forces as unknowns"),
    )
    return tuple(
        Check(
            f"N = {n}, {_STATES} random chains and states: accelerations against {name}, relative",
            difference,
            tolerance=1e-9,
            source=source,
        )
        for name, difference, source in rows
    )


def _differences(vehicle: Vehicle, rng: np.random.Generator) -> tuple[float, float]:
    """Differences of a chain of random masses, inertias and places, from a cart to a laden road train."""
    n = len(vehicle.units)
    vehicle = vehicle.model_copy(update={"units": tuple(_random_unit(unit, rng) for unit in vehicle.units)})
    now = ChainMotion(rng.uniform(-np.pi, np.pi, n), rng.uniform(-10.0, 10.0, 2), rng.uniform(-1.0, 1.0, n))
    forces, moments = rng.uniform(-1e5, 1e5, (n, 2)), rng.uniform(-1e5, 1e5, n)
    model = np.concatenate(modelled(vehicle, now, forces, moments))
    first, second = (
        float(np.abs(model - np.concatenate(other)).max() / np.abs(model).max())
        for other in (lagrange(vehicle, now, forces, moments), newton_euler(vehicle, now, forces, moments)[0])
    )
    return first, second


def _random_unit(unit: Unit, rng: np.random.Generator) -> Unit:
    ranges = {"mass": (500.0, 4e4), "yaw_inertia": (500.0, 5e5), "cg_x": (-8.0, 3.0), "hitch_x": (-12.0, 2.0)}
    return unit.model_copy(update={name: rng.uniform(*limits) for name, limits in ranges.items()})


def _friction_circle(vehicle: Vehicle, count: int) -> Check:
    """Largest excess of a wheel's horizontal force over friction times load, in random states."""
    rng = np.random.default_rng(1)
    outputs = np.array(
        compiled_output(vehicle).map(count)(random_states(vehicle, rng, count), random_inputs(vehicle, rng, count))
    )
    used = Output(*parts(outputs, output_sizes(vehicle))).friction_used
    return Check(
        f"{vehicle.n_wheels} wheels in {count} random states: horizontal force beyond friction times load",
        max(0.0, float(used.max()) - 1.0),
        tolerance=1e-12,
        source="Coulomb's law; tolerance: rounding",
    )


def random_states(vehicle: Vehicle, rng: np.random.Generator, count: int) -> FloatArray:
    """State vectors in columns, (n_state, count), wilder than in any drive."""
    sizes = state_sizes(vehicle)
    return np.concatenate([a * rng.uniform(-1.0, 1.0, (n, count)) for a, n in zip(_RANGES, sizes, strict=True)])


def random_inputs(vehicle: Vehicle, rng: np.random.Generator, count: int) -> FloatArray:
    """Inputs of the chain in columns, (n_input, count)."""
    sizes = input_sizes(vehicle)
    drawn = Input(
        steer=rng.uniform(-0.6, 0.6, (sizes.steer, count)),
        acceleration=rng.uniform(-6.0, 2.0, (1, count)),
        gear=np.where(np.arange(count) % 2, -1.0, 1.0)[None, :],
        friction=rng.uniform(0.05, 1.2, (sizes.friction, count)),
        gravity_x=rng.uniform(-1.0, 1.0, (sizes.gravity_x, count)),
        gravity_y=rng.uniform(-1.0, 1.0, (sizes.gravity_y, count)),
        road=rng.uniform(-0.05, 0.05, (sizes.road, count)),
        wind=rng.uniform(-20.0, 20.0, (sizes.wind, count)),
        drive_torque=rng.uniform(-5e3, 5e3, (sizes.drive_torque, count)),
        brake_torque=rng.uniform(0.0, 1e4, (sizes.brake_torque, count)),
        brake_share=rng.uniform(0.0, 1.0, (sizes.brake_share, count)),
    )
    return np.concatenate(drawn)
