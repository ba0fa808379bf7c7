"""Service brakes, driveline and steering actuators: lags, limits of force, power, angle and rate, and ABS."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offtrack.studies.validation.stopping_checks import braked, without_abs
from tests.vehicle.chains import named
from vehicle.combination.actuators import demand_rate, retarder_capacity, steer_rate
from vehicle.combination.data_sheet import data_sheet
from vehicle.combination.description import GRAVITY, Vehicle, brake_channels, load_vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.unit import Distribution
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import SplitFriction, Surface

DRY = Surface(friction=0.8)
FULL = 9.0  # demand of a full brake application [m/s2]


def changed(vehicle: Vehicle, **numbers: object) -> Vehicle:
    assert vehicle.brakes is not None
    return vehicle.model_copy(update={"brakes": vehicle.brakes.model_copy(update=numbers)})


def test_wheels_share_modulators_as_the_file_says(tractor_semitrailer: Vehicle) -> None:
    """Steer axle select-low, drive axle by wheel, the tridem by side; without ABS a channel per group of axles."""
    channels = brake_channels(tractor_semitrailer)
    found = [(c.unit, c.axles, c.side, c.valve, c.mirrored) for c in channels]
    assert found == [
        (0, (0,), 0, 0, 0),
        (0, (1,), +1, 1, 2),
        (0, (1,), -1, 2, 1),
        (1, (0, 1, 2), +1, 3, 4),
        (1, (0, 1, 2), -1, 4, 3),
    ]
    plain = brake_channels(without_abs(tractor_semitrailer))
    assert [(c.unit, c.axles, c.side, c.valve) for c in plain] == [
        (0, (0,), 0, None),
        (0, (1,), 0, None),
        (1, (0, 1, 2), 0, None),
    ]


def test_pressure_rises_behind_two_lags(tractor_semitrailer: Vehicle) -> None:
    """Two lags a and b in series: 1 - (a exp(-t/a) - b exp(-t/b)) / (a - b)."""
    demand = 1.0
    stop = braked(tractor_semitrailer, DRY, 20.0, demand, seconds=1.0)
    a, b, t = 0.08, 0.10, 0.01 * np.arange(len(stop.speed))
    steer = static_axle_loads(tractor_semitrailer)[0][0] / GRAVITY * demand * 0.5 / 40e3
    expected = steer * (1.0 - (a * np.exp(-t / a) - b * np.exp(-t / b)) / (a - b))
    # The pressure is stepped by Euler's rule at 1 ms, 1 % of its lag.
    np.testing.assert_allclose(stop.pressure[:, 0], expected, atol=0.01 * steer)


def test_a_full_application_fills_the_chambers_at_their_rate(tractor_semitrailer: Vehicle) -> None:
    """4 /s at most, so three quarters of the pressure take at least 0.19 s; the delays of both lags come on top."""
    stop = braked(tractor_semitrailer, DRY, 20.0, FULL, seconds=1.0)
    assert np.max(np.diff(stop.pressure[:, 1])) == pytest.approx(0.04, rel=1e-6)
    delay = 0.01 * float(np.argmax(stop.pressure[:, 1] > 0.75))
    assert 0.2 < delay < 0.5


@pytest.mark.parametrize("distribution", ["load", "pressure"])
def test_the_demanded_deceleration_is_reached(tractor_semitrailer: Vehicle, distribution: Distribution) -> None:
    """Brake forces sum up to mass times demand; rolling resistance helps by 0.006 g, turning wheels slow by 1.3 %."""
    stop = braked(changed(tractor_semitrailer, distribution=distribution), DRY, 20.0, 2.0, seconds=3.0)
    slowing = (stop.speed[150] - stop.speed[290]) / 1.4
    assert slowing == pytest.approx((2.0 + 0.006 * GRAVITY) / 1.013, rel=0.005)
    assert bool(np.ptp(stop.pressure[-1]) < 1e-3) == (distribution == "pressure")


def test_torque_ends_at_full_pressure(tractor_semitrailer: Vehicle) -> None:
    """On ground that holds everything 340 kN stop 40 t: 8.5 m/s2 and rolling resistance, whatever the demand."""
    eager = tractor_semitrailer.model_copy(
        update={"drive": tractor_semitrailer.drive.model_copy(update={"max_deceleration": 20.0})}
    )
    stop = braked(without_abs(eager), Surface(friction=1.5), 25.0, 20.0, seconds=2.0)
    slowing = (stop.speed[100] - stop.speed[150]) / 0.5
    assert stop.pressure[-1] == pytest.approx(1.0, abs=1e-5)
    assert slowing == pytest.approx((340e3 / 40e3 + 0.006 * GRAVITY) / 1.013, rel=0.01)


def test_select_low_keeps_both_sides_at_the_pressure_of_the_slippery_one(tractor_semitrailer: Vehicle) -> None:
    """0.8 left, 0.2 right: the steer axle brakes by the right wheel, the others each by its own."""
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    split = Surface(friction=SplitFriction(left=0.8, right=0.2, line=line))
    stop = braked(tractor_semitrailer, split, 20.0, FULL, seconds=0.8)  # before it has turned off the line
    steer, left, right = stop.pressure[50:, :3].mean(axis=0)
    assert steer < 0.35
    assert left > 2.0 * right
    assert stop.slips(above=5.0, after=0.5).max() < 0.2


def test_brake_data_without_a_table_of_the_system_are_named(tractor_semitrailer: Vehicle) -> None:
    sheet = data_sheet(tractor_semitrailer.model_copy(update={"brakes": None}))
    assert any("without a table [brakes]" in warning for warning in sheet.warnings)


def test_axles_that_share_modulators_have_the_same_lag(tractor_semitrailer: Vehicle) -> None:
    trailer = tractor_semitrailer.units[1]
    first = trailer.axles[0].brake
    assert first is not None
    slower = trailer.axles[0].model_copy(update={"brake": first.model_copy(update={"lag": 0.3})})
    units = (tractor_semitrailer.units[0], trailer.model_copy(update={"axles": (slower, *trailer.axles[1:])}))
    with pytest.raises(ValueError, match=r"units\.1\.axles\.1: brakes of abs_group 'axles' must have the same lag"):
        Vehicle(name="x", drive=tractor_semitrailer.drive, brakes=tractor_semitrailer.brakes, units=units)


# Driveline and steering actuators: limits of force, power, rim speed, angle and rate


THROTTLE = 4.0  # demand of full throttle [m/s2]
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


def powered(vehicle: Vehicle, **numbers: object) -> Vehicle:
    assert vehicle.powertrain is not None
    return vehicle.model_copy(update={"powertrain": vehicle.powertrain.model_copy(update=numbers)})


@pytest.mark.parametrize("friction", [0.1, 0.3])
@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_traction_control_keeps_the_rims_at_its_slip(
    tractor_semitrailer: Vehicle, friction: float, gear: float
) -> None:
    """The torque ends at 1.15 times the road speed and 0.5 m/s; the tyres' lag lets the rims go little beyond."""
    run = driven(tractor_semitrailer, Surface(friction=friction), 0.0, THROTTLE, 6.0, gear)
    assert np.max(run.rims - 1.15 * np.abs(run.speed)) < 0.6


@pytest.mark.slow
def test_the_governor_alone_keeps_the_rims_in_gear(tractor_semitrailer: Vehicle) -> None:
    """On an icy hill at full throttle they spun up to 113 km/h; in the lowest gear they have 2.6 m/s."""
    run = driven(
        powered(tractor_semitrailer, traction_control=False), Surface(friction=0.05, grade=0.03), 0.0, THROTTLE, 5.0
    )
    assert 2.0 < run.rims.max() < 2.8


def test_the_top_speed_is_governed(tractor_semitrailer: Vehicle) -> None:
    """At governed engine speed, or by a limiter, the force falls to that of the drags within 0.4 m/s."""
    run = driven(powered(tractor_semitrailer, top_speed=20.0), Surface(friction=0.8), 18.0, THROTTLE, 30.0)
    assert 19.5 < run.speed[-1] < 20.0
    assert run.rims.max() < 20.0


def test_force_in_the_lowest_gear_is_limited(tractor_semitrailer: Vehicle) -> None:
    """40 kN move 40 t and its wheels by 1 m/s2 less rolling resistance."""
    run = driven(powered(tractor_semitrailer, launch_force=40e3), Surface(friction=0.8), 0.0, THROTTLE, 3.0)
    gained = (run.speed[250] - run.speed[150]) / 1.0
    # Driven wheels turn with the engine's force, so all 1.3 % of turning masses count.
    assert gained == pytest.approx((1.0 - ROLLING * GRAVITY) / 1.013, rel=0.01)


def test_it_climbs_what_friction_allows(tractor_semitrailer: Vehicle) -> None:
    """The drive axle carries 11.4 of 40 t, and a little more uphill: friction 0.3 is worth 8 %, not 9.5 %."""
    assert driven(tractor_semitrailer, Surface(friction=0.3, grade=0.075), 1.0, THROTTLE, 8.0).speed[-1] > 1.0
    assert driven(tractor_semitrailer, Surface(friction=0.3, grade=0.095), 1.0, THROTTLE, 8.0).speed[-1] < 1.0


@pytest.fixture(scope="module")
def retarded(tractor_semitrailer: Vehicle) -> Vehicle:
    assert tractor_semitrailer.powertrain is not None
    assert tractor_semitrailer.powertrain.retarder is not None
    first = tractor_semitrailer.powertrain.retarder.model_copy(update={"acts_first": True})
    return powered(tractor_semitrailer, retarder=first)


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
