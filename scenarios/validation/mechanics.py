"""Checks of the model's mechanics: conservation laws, independent derivations, and the friction circle."""

from __future__ import annotations

from typing import Final

import numpy as np

from scenarios.validation.check import Check, Section
from scenarios.validation.conservation import conservation, gravity_work
from scenarios.validation.derivations import Motion, lagrange, modelled, newton_euler
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.functions import compiled_output
from vehicle.combination.layout import Input, Output, State, input_sizes, output_sizes, parts, state_sizes
from vehicle.frames import FloatArray

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


def mechanics(quick: bool) -> Section:
    """Checks of energy, momenta, work of gravity, two independent derivations, and the friction circle."""
    chains = [_chain(n) for n in (1, 2, 3)]
    return Section(
        title="Mechanics",
        text="Chains of rigid units tumble freely for 20 s and slide down a slope. In random states their "
        "accelerations are compared with two independent derivations, and their tyre forces with the friction limit.",
        checks=(
            *(check for chain in chains[1:] for check in conservation(chain)),
            gravity_work(chains[1]),
            *(check for chain in chains for check in _derivations(chain)),
            _friction_circle(chains[2], 2_000 if quick else 20_000),
        ),
    )


def _chain(n: int) -> Vehicle:
    """First n units of a B-double: tractor, semi-trailer with a hitch above its axles, semi-trailer."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    tractor, trailer = vehicle.units
    lead = trailer.model_copy(update={"hitch_x": -7.4, "hitch_height": 1.15})
    return vehicle.model_copy(update={"units": (tractor, lead, trailer)[:n] if n > 2 else (tractor, trailer)[:n]})


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
            f"N = {n}, {_STATES} random states: accelerations against {name}, relative",
            difference,
            "",
            target=0.0,
            tolerance=1e-9,
            source=source,
        )
        for name, difference, source in rows
    )


def _differences(vehicle: Vehicle, rng: np.random.Generator) -> tuple[float, float]:
    n = len(vehicle.units)
    now = Motion(rng.uniform(-np.pi, np.pi, n), rng.uniform(-10.0, 10.0, 2), rng.uniform(-1.0, 1.0, n))
    forces, moments = rng.uniform(-1e5, 1e5, (n, 2)), rng.uniform(-1e5, 1e5, n)
    model = np.concatenate(modelled(vehicle, now, forces, moments))
    first, second = (
        float(np.abs(model - np.concatenate(other)).max() / np.abs(model).max())
        for other in (lagrange(vehicle, now, forces, moments), newton_euler(vehicle, now, forces, moments)[0])
    )
    return first, second


def _friction_circle(vehicle: Vehicle, count: int) -> Check:
    """Largest excess of a wheel's horizontal force over friction times load, in random states."""
    rng = np.random.default_rng(1)
    outputs = np.array(compiled_output(vehicle).map(count)(_states(vehicle, rng, count), _inputs(vehicle, rng, count)))
    used = Output(*parts(outputs, output_sizes(vehicle))).friction_used
    return Check(
        f"{vehicle.n_wheels} wheels in {count} random states: horizontal force beyond friction times load",
        max(0.0, float(used.max()) - 1.0),
        "",
        target=0.0,
        tolerance=1e-12,
        source="Coulomb's law; tolerance: rounding",
    )


def _states(vehicle: Vehicle, rng: np.random.Generator, count: int) -> FloatArray:
    sizes = state_sizes(vehicle)
    return np.concatenate([a * rng.uniform(-1.0, 1.0, (n, count)) for a, n in zip(_RANGES, sizes, strict=True)])


def _inputs(vehicle: Vehicle, rng: np.random.Generator, count: int) -> FloatArray:
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
        drive_torque=np.zeros((sizes.drive_torque, count)),
        brake_torque=np.zeros((sizes.brake_torque, count)),
        brake_share=np.ones((sizes.brake_share, count)),
    )
    return np.concatenate(drawn)
