"""A rover on firm ground, compared with closed forms."""

import math
from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import fsolve

from tests.vehicle.rovers import GRAVITY, HOME, STILL, STRAIGHT, driven, slope_towards
from vehicle.combination.layout import parts, slices
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.equations import RoverInput, RoverState, dynamics, input_sizes, state_sizes
from vehicle.rover.plant import RoverPlant
from vehicle.rover.terrain import Terrain


@pytest.fixture(scope="module")
def rover() -> Rover:
    return load_rover("el_dorado_ii")


@pytest.fixture(scope="module")
def skid() -> Rover:
    return load_rover("el_dorado_ii_skid")


def sides(left: float, right: float) -> RoverCommand:
    """Rotation [rad/s] of the left and of the right wheels."""
    return RoverCommand((left, right, left, right), STRAIGHT)


def test_a_straight_line_is_straight_and_as_long_as_the_wheels_roll(rover: Rover) -> None:
    """Rolling wheels need no force on firm level ground: no slip is left after the start."""
    truth = driven(RoverPlant(rover, Terrain(), None), sides(0.8, 0.8), 20.0)
    assert truth.pose[1:] == pytest.approx([0.0, 0.0], abs=1e-12)  # rounding
    assert truth.velocity[0] == pytest.approx(0.8 * rover.radius, rel=1e-9)
    assert truth.slip_ratios == pytest.approx(np.zeros(4), abs=1e-9)
    # Lost distance: the drive's lag of 0.1 s, and some mm of relaxation length.
    assert truth.pose[0] == pytest.approx(0.8 * rover.radius * (20.0 - rover.drive_lag), abs=0.002)


@pytest.mark.parametrize("speed", [0.2, 2.0])
def test_a_spin_has_the_closed_form_rate(skid: Rover, speed: float) -> None:
    """Four equal loads, four equal slips: the moment vanishes at b r omega / (a^2 + b^2) by any law of friction."""
    truth = driven(RoverPlant(skid, Terrain(), None), sides(-speed, speed), 10.0)
    a, b = 0.5 * skid.wheelbase, 0.5 * skid.tread
    assert truth.velocity[2] == pytest.approx(b * skid.radius * speed / (a**2 + b**2), rel=1e-6)
    assert truth.velocity[:2] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_gentle_turn_has_the_effective_track(skid: Rover) -> None:
    """At small slip, wheel speeds 2 % apart turn the rover as a two-wheeled cart of that track."""
    v = 0.8 * skid.radius
    truth = driven(RoverPlant(skid, Terrain(), None), sides(0.99 * 0.8, 1.01 * 0.8), 20.0)
    # At these slips the brush model is 1 % below its initial slope: slope times slip over three times the friction.
    assert 0.02 * v / truth.velocity[2] == pytest.approx(skid.effective_track, rel=0.02)


@pytest.mark.parametrize(("left", "right"), [(0.6, 1.0), (0.2, 1.4), (-0.3, 1.2)])
def test_a_skid_turn_agrees_with_an_independent_balance(skid: Rover, left: float, right: float) -> None:
    """Yaw rate and effective track of the balance of forces of four brushes, solved without any of the plant's code.

    Equal loads there: the plant's own load transfer at these speeds, v r h / t over g, moves 0.1 % of them.
    """
    truth = driven(RoverPlant(skid, Terrain(), None), sides(left, right), 20.0)
    mu, places = Terrain().friction, skid.wheel_places

    def unbalanced(motion: FloatArray, /) -> list[float]:
        v_x, v_y, yaw_rate = motion
        X = Y = M = 0.0
        for (x, y), omega in zip(places, (left, right, left, right), strict=True):
            rim = omega * skid.radius
            along, across = rim - (v_x - yaw_rate * y), -(v_y + yaw_rate * x)
            slip = math.hypot(along, across) / abs(rim)
            used = min(skid.slip_stiffness * slip / (3.0 * mu), 1.0)
            F = mu * (3.0 * used - 3.0 * used**2 + used**3) / math.hypot(along, across)
            X, Y, M = X + F * along, Y + F * across, M + F * (x * across - y * along)
        return [X, Y - v_x * yaw_rate * 4.0 / GRAVITY, M]

    rate = (right - left) * skid.radius / skid.effective_track
    v_x, v_y, yaw_rate = fsolve(unbalanced, [0.5 * (left + right) * skid.radius, -0.01 * rate, rate])
    assert truth.velocity[2] == pytest.approx(yaw_rate, rel=2e-3)
    assert truth.velocity[0] == pytest.approx(v_x, rel=2e-3)
    assert truth.velocity[1] == pytest.approx(v_y, abs=2e-3 * abs(v_x))


@pytest.mark.parametrize("psi", [0.0, 0.5 * math.pi, 0.7])
def test_it_stands_on_a_slope_below_the_angle_of_friction(rover: Rover, psi: float) -> None:
    """Half a degree below, at any heading: it comes to rest and does not creep."""
    slope_x, slope_y = slope_towards(0.0, math.atan(0.6) - math.radians(0.5))
    plant = RoverPlant(rover, Terrain(slope_x=slope_x, slope_y=slope_y, friction=0.6), None)
    state = plant.step(plant.initial_state(Pose2(0.0, 0.0, psi)), STILL, 20_000)
    later = plant.step(state, STILL, 60_000)
    assert later[:3] == pytest.approx(state[:3], abs=1e-6)  # displacement until friction is in balance


@pytest.mark.parametrize("psi", [0.0, 0.5 * math.pi, 0.7])
def test_it_slides_down_a_slope_above_the_angle_of_friction(rover: Rover, psi: float) -> None:
    """Half a degree above, it accelerates by g (sin - mu cos), for any distribution of loads."""
    steepness = math.atan(0.6) + math.radians(0.5)
    slope_x, slope_y = slope_towards(0.0, steepness)
    plant = RoverPlant(rover, Terrain(slope_x=slope_x, slope_y=slope_y, friction=0.6), None)
    state = plant.step(plant.initial_state(Pose2(0.0, 0.0, psi)), STILL, 2000)
    later = plant.step(state, STILL, 2000)
    gained = math.hypot(*later[3:5]) - math.hypot(*state[3:5])
    assert gained / 2.0 == pytest.approx(GRAVITY * (math.sin(steepness) - 0.6 * math.cos(steepness)), rel=1e-3)


def test_a_drive_follows_its_demand_with_its_lag(rover: Rover) -> None:
    """With enough torque the speed is 1 - exp(-t / lag) of the demand; the midpoint rule errs by 1e-3 at 5 ms."""
    plant = RoverPlant(rover, Terrain(), None)
    state = plant.step(plant.initial_state(HOME), sides(0.5, 0.5), 150)
    reached = plant.observe(state, 150).wheel_speeds / 0.5
    assert reached == pytest.approx(np.full(4, 1.0 - math.exp(-0.15 / rover.drive_lag)), abs=1e-3)


def test_a_weak_drive_climbs_as_fast_as_its_torque_allows(rover: Rover) -> None:
    """The speed is on the line from stall torque to no-load speed, at the torque against slope and drag.

    Rear wheels carry more and pull more. The line is straight, so the means over all wheels lie on it as well.
    """
    weak = rover.model_copy(update={"stall_torque": 1.0})
    steepness = math.radians(5.0)
    plant = RoverPlant(weak, Terrain(slope_x=math.tan(steepness)), None)
    truth = driven(plant, sides(3.9, 3.9), 20.0)
    weight = weak.mass * GRAVITY
    pull = weight * math.sin(steepness) / 4.0
    needed = weak.radius * (pull + weak.rolling_resistance * float(np.mean(truth.loads)))
    expected = weak.no_load_speed * (1.0 - needed / weak.stall_torque)
    assert float(np.mean(truth.wheel_speeds)) == pytest.approx(expected, rel=1e-4)


def test_a_drive_without_the_torque_is_driven_backward(rover: Rover) -> None:
    """20 degrees need 2.4 N m of each drive: with a stall torque of 1 N m the rover rolls down against its demand."""
    weak = rover.model_copy(update={"stall_torque": 1.0})
    truth = driven(RoverPlant(weak, Terrain(slope_x=math.tan(math.radians(20.0))), None), sides(0.5, 0.5), 3.0)
    assert np.all(truth.wheel_speeds < 0.0)
    assert truth.pose[0] < 0.0


def test_four_steered_wheels_crab(rover: Rover) -> None:
    """All wheels 20 degrees to the left: the rover goes there and does not turn."""
    angle = math.radians(20.0)
    truth = driven(RoverPlant(rover, Terrain(), None), RoverCommand((0.8,) * 4, (angle,) * 4), 20.0)
    assert truth.slip_angle == pytest.approx(angle, abs=1e-9)
    assert truth.pose[2] == pytest.approx(0.0, abs=1e-9)
    assert truth.slip_angles == pytest.approx(np.zeros(4), abs=1e-9)


def test_steering_stops_at_its_limit(rover: Rover) -> None:
    truth = driven(RoverPlant(rover, Terrain(), None), RoverCommand(STRAIGHT, (2.0, -2.0, 2.0, -2.0)), 5.0)
    limit = rover.steer_limit
    assert truth.steer == pytest.approx([limit, -limit, limit, -limit], rel=1e-6)


@pytest.mark.parametrize(
    ("name", "speeds", "steer", "complaint"),
    [
        ("el_dorado_ii_skid", STRAIGHT, (0.1, 0.0, 0.0, 0.0), "el_dorado_ii_skid steers no wheel"),
        ("el_dorado_ii", (math.nan, 0.0, 0.0, 0.0), STRAIGHT, "4 finite wheel speeds"),
        *(
            ("six_wheel_rover", (0.1,) * n, (0.0,) * m, "must have 6 finite wheel speeds")
            for n, m in ((4, 6), (6, 4), (8, 4))
        ),
    ],
)
def test_a_command_that_does_not_fit_is_refused(
    name: str, speeds: tuple[float, ...], steer: tuple[float, ...], complaint: str
) -> None:
    plant = RoverPlant(load_rover(name), Terrain(), None, "interpreted")
    with pytest.raises(ValueError, match=complaint):
        plant.step(plant.initial_state(HOME), RoverCommand(speeds, steer), 10)


def on_leaning_ground(rover: Rover, motion: Sequence[float]) -> FloatArray:
    """Accelerations (3,) for v_x, v_y, yaw rate on ice that slopes to opposite sides in front and behind."""
    in_x, in_u = state_sizes(4), input_sizes(4)
    x, given = ca.SX.sym("x", sum(in_x)), ca.SX.sym("u", sum(in_u))
    s, demands = RoverState(*parts(x, in_x)), RoverInput(*parts(given, in_u))
    rate = dynamics(rover, rover.footprint, None, s, demands).rate
    state, u = np.zeros(sum(in_x)), np.zeros(sum(in_u))
    at = RoverInput(*slices(in_u))
    state[3:6] = motion
    u[at.slope_y], u[at.friction] = [0.1, 0.1, -0.1, -0.1], 1e-12
    accelerations = ca.Function("motion", [x, given], [ca.vertcat(rate.v_x, rate.v_y, rate.yaw_rate)])
    return np.array(accelerations(state, u)).ravel()


def test_opposite_slopes_under_front_and_rear_turn_the_rover(rover: Rover) -> None:
    """Front wheels on ground that rises to the left by 0.1, rear wheels to the right: the mean plane is level.

    Each wheel carries a quarter of the weight and is pushed downhill by 0.1 of it, half a wheelbase from R's origin:
    m g 0.1 a in all.
    """
    yaw = -rover.mass * GRAVITY * 0.1 * 0.5 * rover.wheelbase / rover.yaw_inertia
    assert on_leaning_ground(rover, (0.0, 0.0, 0.0)) == pytest.approx([0.0, 0.0, yaw], abs=1e-9)


def test_a_mass_centre_ahead_follows_newton_and_euler(rover: Rover) -> None:
    """0.1 m ahead it adds m g 2 c / L to the load of the front wheels, which 0.1 of that pushes downhill.

    In the turning frame of R the mass centre's acceleration is (v_x' - r v_y - r^2 c, v_y' + r v_x + r' c).
    """
    c, (v_x, v_y, r) = 0.1, (0.2, -0.1, 0.5)
    nose_heavy = rover.model_copy(update={"cg_x": c})
    got = on_leaning_ground(nose_heavy, (v_x, v_y, r))
    weight = rover.mass * GRAVITY
    Y = -0.1 * weight * 2.0 * c / rover.wheelbase
    yaw = (-0.1 * weight * 0.5 * rover.wheelbase - c * Y) / rover.yaw_inertia
    assert got == pytest.approx([r * v_y + r**2 * c, Y / rover.mass - r * v_x - yaw * c, yaw], abs=1e-9)


def test_wheel_velocities_are_rates_of_wheel_positions(rover: Rover) -> None:
    """On a slope, in a turn: velocities are the rates of the positions, in the frames of the wheels."""
    terrain = Terrain(slope_x=0.1, slope_y=-0.05)
    plant = RoverPlant(rover, terrain, None)
    command = RoverCommand((0.8, 0.9, 0.8, 0.9), (0.2, 0.2, -0.2, -0.2))
    state = plant.step(plant.initial_state(Pose2(0.0, 0.0, 0.4)), command, 5000)
    truth, later = plant.observe(state, 0), plant.observe(plant.step(state, command, 2), 2)
    moved: FloatArray = (later.wheel_positions - truth.wheel_positions) / 2e-3
    assert np.linalg.norm(truth.wheel_velocities, axis=1) == pytest.approx(np.linalg.norm(moved, axis=1), rel=1e-3)
    x, y, z = truth.wheel_positions.T
    assert z == pytest.approx(terrain.height(x, y), abs=1e-12)
    turned = (later.X_WB[:3, 0] - truth.X_WB[:3, 0]) @ truth.X_WB[:3, 1] / 2e-3
    assert turned == pytest.approx(truth.velocity[2], rel=1e-3)  # of the body about its own upright axis
    normal = truth.X_WB[:3, 2]
    assert normal == pytest.approx(np.array([-0.1, 0.05, 1.0]) / math.sqrt(1.0125), abs=1e-6)
    assert truth.X_WB[:3, :3] @ truth.X_WB[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
