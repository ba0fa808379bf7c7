"""Random vehicles, ground and commands: the state is sane, or the plant reports that it diverged."""

from functools import cache
from typing import Any

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.plant import DivergedError, Plant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.surface import Roughness, RoughProfile, SplitFriction, Surface

NUMBERS = (
    *("mass", "yaw_inertia", "cg_height", "hitch_roll_share", "roll_gradient", "pitch_gradient", "suspension_damping"),
    *("heave_frequency", "pitch_frequency", "roll_frequency", "roll_axis_height", "lag", "rate_limit_deg", "limit_deg"),
    *("max_acceleration", "max_power", "max_deceleration", "track", "wheel_radius", "wheel_inertia", "damping"),
    *("cornering_stiffness", "longitudinal_stiffness", "nominal_load", "load_sensitivity", "relaxation_length"),
    *("rolling_resistance", "pneumatic_trail", "shape", "curvature"),
)
"""Numbers of a file that may take any value within their limits, independent of the others."""


def varied(thing: Any, factors: dict[str, float]) -> Any:
    """Tables and lists with every number of these names multiplied."""
    if isinstance(thing, dict):
        return {
            name: value * factors.get(name, 1.0) if isinstance(value, float) else varied(value, factors)
            for name, value in thing.items()
        }
    return [varied(part, factors) for part in thing] if isinstance(thing, list | tuple) else thing


@st.composite
def vehicles(draw: st.DrawFn) -> Vehicle:
    """Library vehicles of one and two units, with up to three kinds of their numbers much smaller or larger."""
    name = draw(st.sampled_from(["rigid_truck", "eu_tractor_semitrailer", "uk_longer_semitrailer"]))
    factors = draw(st.dictionaries(st.sampled_from(NUMBERS), st.floats(0.1, 10.0), max_size=3))
    try:
        return Vehicle.model_validate(varied(load_vehicle(name).model_dump(), factors))
    except ValidationError:
        assume(False)
        raise


@cache
def rough() -> Roughness:
    return Roughness(profile=RoughProfile(np.random.default_rng(1), "F"))


@st.composite
def surfaces(draw: st.DrawFn) -> Surface:
    """Ice and glue, planes and cones, smooth and rough."""
    mu = st.floats(0.05, 1.5)
    split = SplitFriction(left=draw(mu), right=draw(mu), line=np.array([[0.0, 0.0], [1.0, 0.3]]))
    return Surface(
        friction=draw(st.one_of(mu, st.just(split))),
        cross_fall=draw(st.floats(-0.2, 0.2)),
        grade=draw(st.floats(-0.2, 0.2)),
        centre=draw(st.sampled_from([None, (0.0, 10.0)])),
        roughness=draw(st.sampled_from([None, rough()])),
    )


anything = st.one_of(st.floats(-1.0, 1.0), st.floats(-1e6, 1e6))
calls = st.lists(st.tuples(anything, anything, anything, st.integers(1, 150)), min_size=1, max_size=5)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(vehicles(), surfaces(), st.floats(-20.0, 40.0), st.floats(-10.0, 10.0), calls)
def test_a_state_is_sane_or_reported_as_diverged(
    vehicle: Vehicle, surface: Surface, speed: float, psi: float, commands: list[tuple[float, float, float, int]]
) -> None:
    """Forces are bounded by friction times load, so speed gains no more than mu g t; loads stay upright."""
    plant = Plant(vehicle, surface)
    n_trailer = vehicle.n_by_law
    state, tick = plant.initial_state(Pose2(1.0, 2.0, psi), speed), 0
    try:
        for steer, acceleration, trailer_steer, ticks in commands:
            state = plant.step(state, VehicleCommand(steer, acceleration, (trailer_steer,) * n_trailer), ticks)
            tick += ticks
    except DivergedError:
        return
    now = plant.observe(state, tick)
    assert np.isfinite(state).all()
    # Friction and slope give 1.7 g at most, a wheel may bear its load many times for a moment on rough ground.
    assert np.linalg.norm(now.velocities[0, :2]) < abs(speed) + 5.0 + 10.0 * GRAVITY * tick * TICK
    assert (now.wheel_loads >= 0.0).all()
    assert (now.friction_used <= 1.0 + 1e-9).all()  # a rounding above the circle
    assert (np.abs(now.load_transfer) <= 1.0).all()
