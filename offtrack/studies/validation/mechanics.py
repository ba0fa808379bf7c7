"""Checks of the model's mechanics: equations of motion against those of free bodies, and the friction circle.

The equations of Newton and Euler hold for each body, with the hitch forces as unknowns. They use axes of W and numpy,
and share only the data with the model: masses, inertias and positions. Whatever has the same accelerations in all
states and under all forces has the same energy and momenta.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from offtrack.studies.validation.check import Check, CheckSection
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.functions import compiled_output
from vehicle.combination.layout import Input, Output, State, input_sizes, output_sizes, parts, state_sizes
from vehicle.combination.multibody import Speeds, Vector, speed_rates
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray


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
    """Accelerations as from ``newton_euler``, by the model, with vectors rotated between W and the tractor's axes."""
    c, s = math.cos(now.psi[0]), math.sin(now.psi[0])
    R_WT = np.array([[c, -s], [s, c]])
    v_x, v_y = (R_WT.T @ now.velocity).tolist()
    on_units = [Vector(*(R_WT.T @ force).tolist()) for force in forces]
    speeds = Speeds(v_x, v_y, now.yaw_rate.tolist())
    rates = speed_rates(vehicle, now.psi.tolist(), speeds, on_units, moments.tolist())
    turning = now.yaw_rate[0] * np.array([-v_y, v_x])  # due to the rotation of the tractor's axes
    return ChainAccelerations(R_WT @ (np.array([rates.v_x, rates.v_y]) + turning), np.array(rates.yaw_rate))


def newton_euler(
    vehicle: Vehicle, now: ChainMotion, forces: FloatArray, moments: FloatArray
) -> tuple[ChainAccelerations, FloatArray]:
    """Accelerations, and the force (N - 1, 2) at each hitch on the unit behind it [N, along W].

    Forces (N, 2) act at, and moments (N,) about, the centres of gravity [N, N m, along W]. Unknowns are the
    acceleration of every centre of gravity, every yaw acceleration, and the hitch forces H: m a = F + H ahead - H
    behind, I psi'' = M + moments of both, and at each hitch both units accelerate alike.
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
    """Accelerations against those of free bodies, and tyre forces against the friction circle."""
    chains = [_chain(n) for n in (1, 2, 3, 4)]
    return CheckSection(
        title="Mechanics",
        text="Accelerations of chains of random data in random states are compared with the equations of Newton and "
        "Euler for each body, and tyre forces with the friction limit.",
        checks=(*map(_derivation, chains), _friction_circle(chains[-1], 2_000 if quick else 20_000)),
    )


def _chain(n: int) -> Vehicle:
    """Tractor and n - 1 semi-trailers, all but the last with a hitch above its axles, as in a B-double."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    tractor, trailer = vehicle.units
    lead = trailer.model_copy(update={"hitch_x": -7.4, "hitch_height": 1.15})
    return vehicle.model_copy(update={"units": (tractor, *[lead] * (n - 2), trailer)[:n]})


def _derivation(vehicle: Vehicle) -> Check:
    """Largest difference from the accelerations of Newton and Euler, over the largest acceleration."""
    rng = np.random.default_rng(1)
    return Check(
        f"N = {len(vehicle.units)}, {_STATES} random chains and states: accelerations, relative",
        max(_difference(vehicle, rng) for _ in range(_STATES)),
        tolerance=1e-9,
        source="equations of Newton and Euler for each body, with the hitch forces as unknowns",
    )


def _difference(vehicle: Vehicle, rng: np.random.Generator) -> float:
    """Relative difference of a chain of random masses, inertias and places, from a cart to a laden road train."""
    n = len(vehicle.units)
    vehicle = vehicle.model_copy(update={"units": tuple(_random_unit(unit, rng) for unit in vehicle.units)})
    now = ChainMotion(rng.uniform(-np.pi, np.pi, n), rng.uniform(-10.0, 10.0, 2), rng.uniform(-1.0, 1.0, n))
    forces, moments = rng.uniform(-1e5, 1e5, (n, 2)), rng.uniform(-1e5, 1e5, n)
    model = np.concatenate(modelled(vehicle, now, forces, moments))
    others = np.concatenate(newton_euler(vehicle, now, forces, moments)[0])
    return float(np.abs(model - others).max() / np.abs(model).max())


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
