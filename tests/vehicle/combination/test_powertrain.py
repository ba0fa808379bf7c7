"""Driveline and steering actuators: limits of force, power, rim speed, angle and rate; endurance brake and drag."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vehicle.chains import named
from vehicle.combination.actuators import demand_rate, retarder_capacity, steer_rate
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

FULL = 4.0  # demand of full throttle [m/s2]
ROLLING = 0.006  # resistance over load [-]


class Run(NamedTuple):
    """A drive straight on, a row every 10 ms."""

    speed: FloatArray  # (n,) [m/s]
    rims: FloatArray  # (n,) of the fastest driven wheel [m/s]
    pressure: FloatArray  # (n, n_channels) [-]


def driven(vehicle: Vehicle, surface: Surface, speed: float, demand: float, seconds: float, gear: float = 1.0) -> Run:
    plant, layout = Plant(vehicle, surface), wheels(vehicle)
    radii = np.array([wheel.axle.wheel_radius for wheel in layout if wheel.axle.driven])
    turning = [k for k, wheel in enumerate(layout) if wheel.axle.driven]
    state, rows = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), []
    for _ in range(round(100 * seconds)):
        s = named(vehicle, state)
        rows.append((s.v_x[0], np.abs(s.omega[turning] * radii).max(), s.brake_pressure))
        state = plant.step(state, VehicleCommand(0.0, demand, (), gear), 10)
    return Run(*(np.array(column) for column in zip(*rows, strict=True)))


def changed(vehicle: Vehicle, **numbers: object) -> Vehicle:
    assert vehicle.powertrain is not None
    return vehicle.model_copy(update={"powertrain": vehicle.powertrain.model_copy(update=numbers)})


@pytest.mark.parametrize("friction", [0.1, 0.3])
@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_traction_control_keeps_the_rims_at_its_slip(
    tractor_semitrailer: Vehicle, friction: float, gear: float
) -> None:
    """The torque ends at 1.15 times the road speed and 0.5 m/s; the tyres' lag lets the rims go little beyond."""
    run = driven(tractor_semitrailer, Surface(friction=friction), 0.0, FULL, 6.0, gear)
    assert np.max(run.rims - 1.15 * np.abs(run.speed)) < 0.6


@pytest.mark.slow
def test_the_governor_alone_keeps_the_rims_in_gear(tractor_semitrailer: Vehicle) -> None:
    """On an icy hill at full throttle they spun up to 113 km/h; in the lowest gear they have 2.6 m/s."""
    run = driven(
        changed(tractor_semitrailer, traction_control=False), Surface(friction=0.05, grade=0.03), 0.0, FULL, 5.0
    )
    assert 2.0 < run.rims.max() < 2.8


def test_the_top_speed_is_governed(tractor_semitrailer: Vehicle) -> None:
    """At governed engine speed, or by a limiter, the force falls to that of the drags within 0.4 m/s."""
    run = driven(changed(tractor_semitrailer, top_speed=20.0), Surface(friction=0.8), 18.0, FULL, 30.0)
    assert 19.5 < run.speed[-1] < 20.0
    assert run.rims.max() < 20.0


def test_force_in_the_lowest_gear_is_limited(tractor_semitrailer: Vehicle) -> None:
    """40 kN move 40 t and its wheels by 1 m/s2 less rolling resistance."""
    run = driven(changed(tractor_semitrailer, launch_force=40e3), Surface(friction=0.8), 0.0, FULL, 3.0)
    gained = (run.speed[250] - run.speed[150]) / 1.0
    # Driven wheels turn with the engine's force, so all 1.3 % of turning masses count.
    assert gained == pytest.approx((1.0 - ROLLING * GRAVITY) / 1.013, rel=0.01)


def test_it_climbs_what_friction_allows(tractor_semitrailer: Vehicle) -> None:
    """The drive axle carries 11.4 of 40 t, and a little more uphill: friction 0.3 is worth 8 %, not 9.5 %."""
    assert driven(tractor_semitrailer, Surface(friction=0.3, grade=0.075), 1.0, FULL, 8.0).speed[-1] > 1.0
    assert driven(tractor_semitrailer, Surface(friction=0.3, grade=0.095), 1.0, FULL, 8.0).speed[-1] < 1.0


@pytest.fixture(scope="module")
def retarded(tractor_semitrailer: Vehicle) -> Vehicle:
    assert tractor_semitrailer.powertrain is not None
    assert tractor_semitrailer.powertrain.retarder is not None
    first = tractor_semitrailer.powertrain.retarder.model_copy(update={"acts_first": True})
    return changed(tractor_semitrailer, retarder=first)


@pytest.mark.slow
def test_a_light_demand_downhill_leaves_the_service_brakes_alone(retarded: Vehicle) -> None:
    """0.6 m/s2 of 40 t are 24 kN, which the endurance brake has up to 250 kW / 24 kN = 10.4 m/s."""
    run = driven(retarded, Surface(friction=0.8, grade=-0.05), 8.0, -0.6, 4.0)
    assert run.pressure.max() < 1e-3
    slowing = (run.speed[200] - run.speed[390]) / 1.9
    grade = GRAVITY * math.sin(math.atan(0.05))
    assert slowing == pytest.approx((0.6 + ROLLING * GRAVITY - grade) / 1.013, abs=0.01)


def test_service_brakes_do_what_the_endurance_brake_leaves(tractor_semitrailer: Vehicle, retarded: Vehicle) -> None:
    """The sum is the demand, whether the endurance brake acts first or not."""
    for vehicle in (tractor_semitrailer, retarded):
        run = driven(vehicle, Surface(friction=0.8), 15.0, -2.0, 3.0)
        slowing = (run.speed[150] - run.speed[290]) / 1.4
        assert slowing == pytest.approx((2.0 + ROLLING * GRAVITY) / 1.013, rel=0.01)


@pytest.mark.parametrize(("speed", "force"), [(1.0, 15e3), (5.0, 30e3), (-20.0, 12.5e3)])
def test_the_endurance_brake_has_a_largest_force_and_power(
    tractor_semitrailer: Vehicle, speed: float, force: float
) -> None:
    assert float(retarder_capacity(tractor_semitrailer, speed)) == pytest.approx(force)


def test_air_slows_a_fast_vehicle(tractor_semitrailer: Vehicle) -> None:
    """Half density times drag area times speed squared, at 25 m/s 2.25 kN."""
    shipped = load_vehicle("eu_tractor_semitrailer")
    run = driven(shipped, Surface(friction=0.8), 25.0, 0.0, 1.2)
    still = driven(tractor_semitrailer, Surface(friction=0.8), 25.0, 0.0, 1.2)
    difference = (still.speed[110] - run.speed[110]) - (still.speed[10] - run.speed[10])
    assert difference == pytest.approx(2250.0 / 40e3 / 1.013, rel=0.02)


angles = st.floats(-3.0, 3.0)
LIMITS = {"lag": 0.15, "limit": 0.5, "rate_limit": 0.35}


@given(angles, angles)
def test_steering_keeps_to_its_limits(angle: float, demand: float) -> None:
    """Of rate, and at the stop it turns inwards or not at all; below, a small error decays with the lag."""
    assert abs(float(steer_rate(angle, demand, **LIMITS))) <= LIMITS["rate_limit"]
    assert steer_rate(0.5, demand, **LIMITS) <= 0.0 <= steer_rate(-0.5, demand, **LIMITS)
    assert steer_rate(0.1, 0.115, **LIMITS) == pytest.approx(0.1)


@given(st.floats(-20.0, 20.0))
def test_demands_beyond_drive_and_brakes_are_cut(demand: float) -> None:
    """No engine pulls 40 t at 5 m/s2."""
    rate = demand_rate(0.0, demand, lag=0.25, braking=6.0, driving=1.5)
    assert rate * 0.25 == pytest.approx(min(max(demand, -6.0), 1.5))
