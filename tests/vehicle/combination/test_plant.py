"""The plant: what a heavy vehicle does on a road, and what it refuses."""

import math
import pickle
from collections.abc import Callable

import numpy as np
import pytest

from tests.vehicle.chains import grouped, named
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.plant import ConstantSlipPlant, DivergedError, Plant, VehicleCommand
from vehicle.combination.roll import roll_gradients
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2, rotation_zyx, transform
from vehicle.surface import SplitFriction, Surface

ORIGIN = Pose2(0.0, 0.0, 0.0)
DRY = Surface(friction=0.8)
CONE = Surface(friction=0.6, cross_fall=0.03, centre=(5.0, 9.0))
SPLIT = Surface(friction=SplitFriction(left=0.1, right=0.8, line=np.array([[0.0, 0.0], [1.0, 0.0]])))
CONTROL = 20  # [ticks]


def drive(
    plant: Plant, state: FloatArray, seconds: float, command: VehicleCommand | Callable[[Truth], VehicleCommand]
) -> tuple[FloatArray, list[Truth]]:
    """Final state and what was seen every 20 ms, the first before the first step."""
    seen = []
    for tick in range(0, round(seconds * 1000), CONTROL):
        seen.append(plant.observe(state, tick))
        state = plant.step(state, command(seen[-1]) if callable(command) else command, CONTROL)
    return state, seen


def keeping(speed: float, steer: float, n_trailer: int) -> Callable[[Truth], VehicleCommand]:
    """A driver with a fixed steering wheel and a proportional foot."""
    return lambda now: VehicleCommand(steer, 1.0 * (speed - now.velocities[0, 0]), (0.0,) * n_trailer)


# --- straight ahead ---


@pytest.mark.parametrize("name", ["tractor_semitrailer", "longer_semitrailer"])
def test_a_free_rolling_combination_coasts_down_by_rolling_resistance(
    name: str, request: pytest.FixtureRequest
) -> None:
    """Deceleration 0.006 g of the mass with its turning wheels, and not the slightest yaw."""
    vehicle: Vehicle = request.getfixturevalue(name)
    plant = Plant(vehicle, DRY)
    coasting = VehicleCommand(0.0, 0.0, (0.0,) * vehicle.n_by_law)
    _, seen = drive(plant, plant.initial_state(Pose2(3.0, -2.0, 0.7), 10.0), 4.0, coasting)
    spin = sum(2 * axle.wheel_inertia / axle.wheel_radius**2 for unit in vehicle.units for axle in unit.axles)
    slowing = (seen[50].velocities[0, 0] - seen[-1].velocities[0, 0]) / (0.02 * (len(seen) - 1 - 50))
    assert slowing == pytest.approx(
        0.006 * GRAVITY * vehicle.mass / (vehicle.mass + spin), rel=2e-3
    )  # 1e-3 is the 1 ms step's
    np.testing.assert_allclose(seen[-1].poses[:, 2], 0.7, atol=1e-9)
    way = math.hypot(seen[-1].poses[0, 0] - 3.0, seen[-1].poses[0, 1] + 2.0)
    assert way == pytest.approx(10.0 * 3.98 - 0.5 * slowing * 3.98**2, abs=0.02)  # tyres wind up in the first 0.3 s


# --- brakes, drive and friction ---


def test_rolling_drag_holds_too_where_the_slope_is_less(tractor_semitrailer: Vehicle) -> None:
    """0.3 % against 0.6 % of rolling resistance, nobody on the brake: when it has rocked out it stands still."""
    plant = Plant(tractor_semitrailer, Surface(friction=0.8, grade=0.003))
    rest = plant.step(plant.initial_state(ORIGIN, 0.0), VehicleCommand(0.0, 0.0, ()), 20_000)
    later = plant.step(rest, VehicleCommand(0.0, 0.0, ()), 4_000)
    assert abs(later[0] - rest[0]) / 4.0 < 1e-3


def test_it_stops_holds_and_starts_again_on_an_icy_cambered_slope(longer_semitrailer: Vehicle) -> None:
    """Friction 0.1, 3 % to the side, 0.5 % up: braking gently it stops and stands; then 0.2 m/s2 take it on, straight.

    The side slope asks for 0.3 of the friction; two driven wheels of ten can pull with 0.1 * 0.29 of the weight.
    """
    plant = Plant(longer_semitrailer, Surface(friction=0.1, grade=0.005, cross_fall=0.03))
    braking, driving = (VehicleCommand(0.0, demand, (0.0, 0.0)) for demand in (-0.4, 0.2))
    ends = [plant.step(plant.initial_state(ORIGIN, 3.0), braking, 12_000)]
    for command, ticks in ((braking, 4_000), (driving, 6_000)):
        ends.append(plant.step(ends[-1], command, ticks))
    rest, held, off = (named(longer_semitrailer, end) for end in ends)
    assert max(abs(held.x[0] - rest.x[0]), abs(held.y[0] - rest.y[0])) / 4.0 < 1e-3  # [m/s] of creep
    assert np.abs(held.omega).max() < 0.02
    assert off.v_x[0] > 0.3
    assert abs(off.psi - held.psi).max() < 0.05  # [rad]: nothing steers against the drift of 0.3 / (5 / 0.1) rad
    assert abs(off.y[0] - held.y[0]) < 0.15 * (off.x[0] - held.x[0])


@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_drive_wheels_spin_on_ice_and_stay_bounded(tractor_semitrailer: Vehicle, gear: float) -> None:
    """At friction 0.1 two of ten wheels push with less than 0.1 of their load; spin ends at the engine's power."""
    plant = Plant(tractor_semitrailer.model_copy(update={"powertrain": None}), Surface(friction=0.1))  # no governor
    state, seen = drive(plant, plant.initial_state(ORIGIN, 0.0), 4.0, VehicleCommand(0.0, 1.5, (), gear))
    traction = 0.1 * seen[-1].wheel_loads[2:4].sum()
    bound = traction / tractor_semitrailer.mass * 4.0
    assert 0.5 * bound < gear * seen[-1].velocities[0, 0] < bound
    assert max(now.friction_used.max() for now in seen) <= 1.0 + 1e-12
    assert seen[-1].friction_used[2] == pytest.approx(math.sin(0.5 * math.pi * 1.26), abs=0.01)
    omega = named(tractor_semitrailer, state).omega[2:4]
    resisting = (0.92 + 0.06) * 0.5 * traction * 0.5  # one wheel of 0.5 m: sliding, and 0.006 of rolling [N m]
    # Once torque is no longer the limit, half of 350 kW works on each wheel.
    np.testing.assert_allclose(gear * omega, 0.5 * 350e3 / resisting, rtol=0.02)


# --- bends ---


def test_bodies_roll_outwards_and_dive_under_braking(tractor_semitrailer: Vehicle) -> None:
    """Left turn: left side up, by gradient times acceleration, about the roll axis. Braking: nose down."""
    plant = Plant(tractor_semitrailer, DRY)
    _, seen = drive(plant, plant.initial_state(ORIGIN, 8.0), 12.0, keeping(8.0, 0.06, 0))
    trailer, now = tractor_semitrailer.units[1], seen[-1]
    v_x, _, r = now.velocities[1]
    a_y = r * v_x  # of the centre of gravity too, in a steady turn
    X_WB, psi = now.bodies[1], now.poses[1, 2]
    roll = math.atan2(X_WB[2, 1], X_WB[2, 2])
    gradient = roll_gradients(tractor_semitrailer)[1]
    assert roll == pytest.approx(gradient * a_y, rel=0.05)  # gamma is small, and so is the way still to go
    axis = X_WB @ np.array([0.0, 0.0, trailer.roll_axis_height, 1.0])
    # what is left of acceleration pitches it by some 1e-5 rad about a centre of gravity 5 m away
    np.testing.assert_allclose(axis[:3], [*now.poses[1, :2], trailer.roll_axis_height], atol=2e-4)
    assert math.atan2(X_WB[1, 0], X_WB[0, 0]) == pytest.approx(psi, abs=1e-3)

    _, braking = drive(plant, plant.initial_state(ORIGIN, 8.0), 2.0, VehicleCommand(0.0, -3.0, ()))
    ahead, behind = (-math.asin(body[2, 0]) for body in braking[-1].bodies)
    tractor = tractor_semitrailer.units[0]
    assert ahead == pytest.approx(tractor.pitch_gradient * 3.0, rel=0.05)
    risen = (tractor.cg_x - tractor.rear_hitch[0]) * ahead  # the hitch lies behind what the tractor pitches about
    assert behind == pytest.approx(trailer.pitch_gradient * 3.0 - risen / 7.70, rel=0.05)


def test_velocities_are_the_rates_of_poses(longer_semitrailer: Vehicle) -> None:
    plant = Plant(longer_semitrailer, DRY)
    state, _ = drive(plant, plant.initial_state(ORIGIN, 6.0), 3.0, VehicleCommand(0.15, 0.0, (0.05, 0.1)))
    seen = []
    for tick in range(3):
        seen.append(plant.observe(state, tick))
        state = plant.step(state, VehicleCommand(0.15, 0.0, (0.05, 0.1)), 1)
    rates = (seen[2].poses - seen[0].poses) / 2e-3
    for i, psi in enumerate(seen[1].poses[:, 2]):
        own = Pose2(0.0, 0.0, -psi).apply(rates[i : i + 1, :2])[0]
        np.testing.assert_allclose([*own, rates[i, 2]], seen[1].velocities[i], atol=1e-5)  # jerk / 6 * (1 ms)^2


def test_a_body_is_carried_by_the_ground_and_moved_by_its_springs(longer_semitrailer: Vehicle) -> None:
    """On a cone, in a bend, braking: pose on the smooth ground, then heave, pitch and roll about the roll axis."""
    cone = Surface(friction=0.8, cross_fall=0.03, grade=0.02, centre=(4.0, 15.0))
    plant = Plant(longer_semitrailer, cone)
    state, _ = drive(plant, plant.initial_state(ORIGIN, 8.0), 2.0, VehicleCommand(0.2, -1.0, (0.1, -0.1)))
    now, s = plant.observe(state, 2000), named(longer_semitrailer, state)
    assert np.abs(s.roll).min() > 0.002
    for i, unit in enumerate(longer_semitrailer.units):
        x, y, psi = now.poses[i].tolist()
        R = rotation_zyx(0.0, s.pitch[i], s.roll[i])
        pivot = np.array([unit.cg_x, 0.0, unit.roll_axis_height])
        on_springs = transform(R, pivot + np.array([0.0, 0.0, s.heave[i]]) - R @ pivot)
        expected = cone.pose_on(x, y, psi, longer_semitrailer.supports(i)) @ on_springs
        np.testing.assert_allclose(now.bodies[i], expected, atol=1e-12)  # the same to rounding, on some 10 m


# --- as a part of the program ---


@pytest.mark.parametrize("speed", [-3.0, 0.0, 5.0])
def test_it_starts_rolling_with_its_brakes_against_the_motion(longer_semitrailer: Vehicle, speed: float) -> None:
    """Wheels at the speed of the ground, and what a brake holds against: the way it rolls, or nothing at rest."""
    state = Plant(longer_semitrailer, DRY).initial_state(Pose2(1.0, 2.0, 0.5), speed)
    s = named(longer_semitrailer, state)
    np.testing.assert_allclose(s.omega, speed / longer_semitrailer.units[0].axles[0].wheel_radius)  # all have the same
    np.testing.assert_array_equal(s.brake_windup, math.copysign(1.0, speed) if speed else 0.0)


def test_axles_of_a_group_turn_by_what_they_ask_on_average(longer_semitrailer: Vehicle) -> None:
    """One actuator for two axles, the second turned by half: it takes the mean of what each asks of it."""
    plant = Plant(grouped(longer_semitrailer), DRY)
    state = plant.step(plant.initial_state(ORIGIN, 2.0), VehicleCommand(0.1, 0.0, (0.06, 0.05)), 3000)
    actuator = 0.5 * (0.06 / 1.0 + 0.05 / 0.5)
    steer = plant.observe(state, 3000).steer  # after 3 s: ten times the actuators' lag and more
    np.testing.assert_allclose(steer, [0.1, actuator, 0.5 * actuator], atol=1e-6)


def test_changing_ground_is_looked_up_on_the_way(tractor_semitrailer: Vehicle) -> None:
    """At 11 to 12 m/s every 8 ticks: 80 ticks at once are ten times 8, to the bit, and not what is seen at first."""
    cone = Surface(friction=0.6, cross_fall=0.1, centre=(3.0, 8.0))
    plant = Plant(tractor_semitrailer, cone)
    command = VehicleCommand(0.1, -3.0, ())
    start = at_once = plant.initial_state(ORIGIN, 12.0)
    by_looks = start
    for _ in range(10):
        by_looks = plant.step(by_looks, command, 8)
    at_once = plant.step(start, command, 80)
    np.testing.assert_array_equal(at_once, by_looks)
    coarse = start
    for ticks in (3, 77):
        coarse = plant.step(coarse, command, ticks)
    assert not np.array_equal(coarse, at_once)


def test_a_step_leaves_its_argument_and_a_pickled_plant_goes_on_alike(longer_semitrailer: Vehicle) -> None:
    plant = Plant(longer_semitrailer, Surface(friction=0.5, cross_fall=0.02, centre=(10.0, 12.0)))
    command = VehicleCommand(0.2, 0.5, (0.1, -0.1))
    start = plant.initial_state(ORIGIN, 5.0)
    kept = start.copy()
    end = plant.step(start, command, 50)
    np.testing.assert_array_equal(start, kept)
    again = pickle.loads(pickle.dumps(plant))
    np.testing.assert_array_equal(again.step(start, command, 50), end)


@pytest.mark.parametrize("heading", [0.0, 0.5 * math.pi, -2.0])
def test_friction_acts_where_the_wheels_are(tractor_semitrailer: Vehicle, heading: float) -> None:
    """Ice under the left wheels, asphalt under the right: a braking combination turns right, wherever it heads."""
    line = np.array([[0.0, 0.0], [math.cos(heading), math.sin(heading)]])
    plant = Plant(tractor_semitrailer, Surface(friction=SplitFriction(left=0.1, right=0.8, line=line)))
    _, seen = drive(plant, plant.initial_state(Pose2(0.0, 0.0, heading), 10.0), 1.0, VehicleCommand(0.0, -4.0, ()))
    assert seen[-1].velocities[0, 2] < -0.01
    used = seen[20].friction_used  # after 0.4 s
    assert (used[0::2] > 0.9).all()
    assert (used[1::2] < 0.9).all()


@pytest.mark.parametrize("part", ["x", "v_x", "omega", "steer", "brake_windup"])
@pytest.mark.parametrize("broken", [math.nan, math.inf, -1e200])
@pytest.mark.parametrize("surface", [DRY, CONE, SPLIT], ids=["plane", "cone", "split"])
def test_broken_physics_is_reported_with_state_and_input(
    tractor_semitrailer: Vehicle, surface: Surface, broken: float, part: str
) -> None:
    plant = Plant(tractor_semitrailer, surface)
    state = plant.initial_state(ORIGIN, 5.0)
    getattr(named(tractor_semitrailer, state), part)[0] = broken
    with pytest.raises(DivergedError) as caught:
        plant.step(state, VehicleCommand(0.0, 0.0, ()), 1)
    assert caught.value.state is state
    assert np.isfinite(caught.value.input).all()


def test_commands_that_do_not_fit_are_refused(longer_semitrailer: Vehicle) -> None:
    plant = Plant(longer_semitrailer, DRY)
    state = plant.initial_state(ORIGIN, 5.0)
    with pytest.raises(ValueError, match="trailer_steer has 3 angles, uk_longer_semitrailer steers 2"):
        plant.step(state, VehicleCommand(0.0, 0.0, (0.0, 0.0, 0.0)), 1)
    with pytest.raises(ValueError, match="ticks = 0"):
        plant.step(state, VehicleCommand(0.0, 0.0, (0.0, 0.0)), 0)
    with pytest.raises(ValueError, match=r"steer=nan.*finite"):
        plant.step(state, VehicleCommand(math.nan, 0.0, (0.0, 0.0)), 1)


# Prescribed motion at a slip angle; its off-tracking is that of a run, see the tests of the loop


ROAD = Surface(friction=0.8)
IDLE = VehicleCommand(0.3, 1.0, (0.1, 0.1))


def test_velocity_is_at_the_slip_angle_and_matches_the_poses(longer_semitrailer: Vehicle) -> None:
    """beta = atan2(v_y, v_x) of the trailer; poses advance with it in a straight line."""
    plant = ConstantSlipPlant(longer_semitrailer, ROAD, unit=1, slip_angle=0.2, speed=5.0)
    state = plant.initial_state(Pose2(1.0, 2.0, 0.5), 5.0)
    now, then = plant.observe(state, 0), plant.observe(plant.step(state, IDLE, 100), 100)
    assert math.atan2(now.velocities[1, 1], now.velocities[1, 0]) == pytest.approx(0.2)
    np.testing.assert_allclose(
        then.poses - now.poses, [[0.5 * math.cos(0.5), 0.5 * math.sin(0.5), 0.0]] * 2, atol=1e-12
    )
    assert then.poses[1, 2] == pytest.approx(0.5 - 0.2)
    np.testing.assert_allclose(then.bodies[1][:2, 3], then.poses[1, :2])


@pytest.mark.parametrize("unit", [0, 2])
def test_only_towed_units_are_dragged(longer_semitrailer: Vehicle, unit: int) -> None:
    with pytest.raises(ValueError, match="unit = "):
        ConstantSlipPlant(longer_semitrailer, ROAD, unit=unit, slip_angle=0.2, speed=5.0)


def test_another_speed_than_the_constant_one_is_refused(longer_semitrailer: Vehicle) -> None:
    plant = ConstantSlipPlant(longer_semitrailer, ROAD, unit=1, slip_angle=0.2, speed=5.0)
    with pytest.raises(ValueError, match=r"speed = 4\.0 m/s"):
        plant.initial_state(Pose2(0.0, 0.0, 0.0), 4.0)
