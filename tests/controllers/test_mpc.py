"""Model predictive steering: closed loops, the law alone, its parts and its model."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from controllers.trailer import Combination, TrailerGeometry
from controllers.trailer_steering.mpc.law import Mpc
from controllers.trailer_steering.mpc.observer import (
    FrictionMemory,
    Observer,
    ObserverMemory,
    Reckoned,
    reckoned,
    updated,
)
from controllers.trailer_steering.mpc.planning import denser, hitch_course, path_now, reference, with_estimate
from controllers.trailer_steering.mpc.trailer_model import (
    STEP,
    TYRE_STEP,
    Inputs,
    State,
    Stepper,
    TrailerModel,
    rate,
    rolled_on,
    state_sizes,
)
from estimators.estimates import Health, OffTracking
from scenarios.assembly.adapters import trailer_geometry
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.metrics import peak, rms
from sensors.messages import CombinationSignals
from tests.trailers import estimate, signals, steps
from vehicle.clock import TICK
from vehicle.combination.description import load_vehicle
from vehicle.combination.layout import parts
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

VEHICLE = load_vehicle("uk_longer_semitrailer")
COMBINATION = Combination(VEHICLE, 1)
TRAILER = trailer_geometry(VEHICLE, 1)
SPEED = 2.8


@cache
def off_tracking(law: str, *settings: str) -> FloatArray:
    """True off-tracking [m] in a good quarter of a roundabout with exact estimates and the signals of a data sheet."""
    course = ("course.turn_deg=100", "course.entry=22", "course.exit=5", "off_tracking=truth", "reference_unit=false")
    return run(load_scenario("roundabout", [*course, f"trailer_steering={law}", *settings]), 1).log["off_tracking_true"]


@pytest.mark.slow
@pytest.mark.parametrize("cross_fall", [0.0, 0.05])
def test_on_ice_the_follow_point_keeps_no_farther_from_the_path_than_by_kinematics(cross_fall: float) -> None:
    """Friction 0.2: the fixed axle slides, in the cross-fall the tractor too. A tenth more is the bar, as is 0.12 m.

    The model knows what a sliding axle does, and the signals tell what it meets before any estimate.
    """
    ice = ("surface.friction=0.2", f"surface.cross_fall={cross_fall}")
    predictive, kinematic = off_tracking("mpc", *ice), off_tracking("path_preview", *ice)
    assert rms(predictive) < 1.1 * rms(kinematic)
    assert peak(predictive) < 1.1 * peak(kinematic)
    assert peak(predictive) < 0.12


@pytest.mark.slow
def test_a_kerb_on_the_inside_swings_the_rear_out() -> None:
    """Following a circle of 10 m exactly, the middle of 14 m cuts in by 10 - sqrt(10^2 - 7^2) = 2.9 m.

    Held to 2.2 m against a tail swing of 0.4 m, the soft limits meet in between: the follow point goes wide, to the
    right of the path, about 0.7 times the rest of 0.3 m beyond that.
    """
    free, held = off_tracking("mpc"), off_tracking("mpc", "steering.cut_in=2.2", "steering.tail_swing=0.4")
    assert peak(free) < 0.05
    assert float(np.nanmax(held)) > 0.3  # the path lies to its left
    assert peak(held) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "stiffness", "lag"), [(1.2, 0.8, 1.2), (0.8, 1.2, 0.8)], ids=["heavy", "light"])
@pytest.mark.parametrize(("law", "bar"), [("path_preview", 0.018), ("mpc", 0.012)])
def test_the_follow_point_keeps_to_the_path_in_spite_of_a_model_error(
    law: str, bar: float, mass: float, stiffness: float, lag: float
) -> None:
    """Both estimate the slip of the axles and a disturbance, so that no offset remains.

    The bar for the roundabout is 0.06 m RMS. Without any error of the model they keep within 0.009 m and 0.006 m; twice
    that is what a fifth may cost. Axles that scrub lean on their suspensions, which shifts load between their wheels
    and takes side force of the tyres; path_preview does not know of it. Unsteered it would be metres.
    """
    scales = {"mass": mass, "cornering_stiffness": stiffness, "steer_lag": lag}
    wrong = off_tracking(law, *(f"plant.{name}_scale={scale}" for name, scale in scales.items()))
    assert rms(wrong) < bar
    assert peak(wrong) < 4.2 * bar  # at the exit


# The law alone, on given estimates.


def slanted(tick: int, *, offset: float = 0.0, **changes: Any) -> OffTracking:
    """Straight travel with the path ``offset`` to the left of the trailer's axis from 10 m behind the hitch on."""
    x = -np.linspace(0.0, 16.0, 60)
    path = np.column_stack([x, offset * np.minimum(1.0, -x / 10.0)])
    return estimate(tick, value=offset, path=path, **changes)


def arriving(**about: Any) -> Callable[[int], OffTracking | None]:
    """A new estimate every 0.1 s, 0.1 s old."""
    return lambda tick: slanted(tick // 100 * 100 - 100, **about) if tick >= 100 else None


def law(trailer: TrailerGeometry = TRAILER, **parameters: float) -> Mpc:
    return Mpc(trailer, combination=COMBINATION, parameters=Mpc.Parameters(**parameters))


def test_a_lost_estimate_is_bridged_and_then_the_axles_fade_to_straight() -> None:
    """For 2 s the signals carry the last path on, then the angles go down at 0.05 rad/s and stay at zero."""
    controller = law()
    memory, _ = steps(controller, 600, arriving(offset=0.5), speed=SPEED)
    lost = slanted(550, health=Health.LOST)
    memory, fading = steps(controller, 14000, lambda tick: lost, memory, 600, speed=SPEED)
    rates = np.abs(np.diff(fading[105:], axis=0)) / 0.02
    assert rates.max() == pytest.approx(0.05, abs=1e-9)
    assert not fading[-1].any()
    _, again = steps(controller, 14400, arriving(offset=0.5), memory, 14000, speed=SPEED)
    assert np.abs(again[-1]).min() > 0.01  # and it comes back when there is something to see


# Reference, observer, friction


FOLLOW, RADIUS = 14.0, 12.0
LEVER = 0.7744762  # of the kingpin, before the drive axle [m]


def circle(angles: FloatArray) -> FloatArray:
    """Points (n, 2) of a left-hand circle that leaves the origin along x."""
    return RADIUS * np.column_stack([np.sin(angles), 1.0 - np.cos(angles)])


def test_on_a_circle_the_wanted_headings_are_chords() -> None:
    """The chord of the follow distance lags the hitch's direction by asin(L / 2R); its middle is R - R cos inside."""
    ahead = hitch_course(0.0, SPEED / RADIUS, SPEED, 0.05, 24)
    behind = denser(circle(-np.arange(0.0, 16.0, 0.28) / RADIUS))
    wanted = reference(ahead.points, behind, FOLLOW)
    assert wanted is not None
    lag = math.asin(0.5 * FOLLOW / RADIUS)
    np.testing.assert_allclose(wanted.headings, ahead.directions - lag, atol=1e-4)  # 1 mm at the follow point
    # the path lies to the right of the chord in a left turn
    np.testing.assert_allclose(wanted.offsets, -(RADIUS - RADIUS * math.cos(lag)), atol=0.02)  # nearest point: 0.1 m


def test_a_path_with_two_seconds_missing_stays_on_its_circle() -> None:
    """Points 0.28 m apart but for a hole of 5.8 m: a cubic for even spacing would fold the path by 0.35 m there."""
    angles = np.arange(0.0, 16.0, 0.28)
    path = denser(circle(-angles[(angles < 3.0) | (angles > 8.8)] / RADIUS))
    assert np.hypot(path[:, 0], path[:, 1] - RADIUS) == pytest.approx(RADIUS, abs=0.02)  # sagitta of its chord: 0.35 m
    steps = np.hypot(*np.diff(path, axis=0).T)
    assert steps.min() > 0.1
    assert steps.max() < 0.21  # no piece is longer than 0.2 m of the path's chords


def test_a_path_with_repeated_points_is_made_denser() -> None:
    """A trailer at standstill leaves the same point twice; on a straight the points between are on it."""
    x = np.array([0.0, 0.0, -0.5, -1.0, -1.0, -1.5])
    path = denser(np.column_stack([x, 0.0 * x]))
    np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-12)
    assert np.diff(path[:, 0]).max() < 0.0


def test_a_path_too_short_for_the_follow_point_asks_for_nothing() -> None:
    """13 m of path for a trailer of 14 m."""
    ahead = hitch_course(0.0, 0.0, SPEED, 0.05, 24)
    behind = np.column_stack([-np.arange(0.0, 11.0, 0.25), np.zeros(44)])
    assert reference(ahead.points[:4], behind, FOLLOW) is None


def turning(tick: int, *, lead: float, own: float, articulation: float = 0.0) -> CombinationSignals:
    return signals(tick, speed=SPEED, articulation=np.array([articulation]), yaw_rates=np.array([lead, own]))


def travelling(tick: int, direction: float = 0.0, **changes: Any) -> OffTracking:
    """An estimate with the hitch's travel in this direction [rad]."""
    v_x, v_y = SPEED * math.cos(direction), SPEED * math.sin(direction)
    return estimate(tick, hitch_direction=direction, v_x=v_x, v_y=v_y, **changes)


def test_the_hitch_is_reckoned_along_its_circle() -> None:
    """Trailer and tractor turning alike, 1 s: the hitch is where the circle has it, the trailer has turned as much."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    rate = SPEED / RADIUS
    lag = math.atan(LEVER * rate / SPEED)
    for tick in range(0, 1001, 20):
        memory = observer.with_signals(memory, turning(tick, lead=rate, own=rate, articulation=-lag))
    moved = reckoned(memory.records, 0)
    assert memory.now.hitch_direction == pytest.approx(0.0, abs=0.002)  # the mean lever of the fixed axles
    assert moved.frame.psi == pytest.approx(rate, abs=1e-9)
    way = memory.now.speed
    assert (moved.frame.x, moved.frame.y) == pytest.approx(tuple(circle(np.array([rate]))[0] * way / SPEED), abs=0.01)
    assert len(moved.hitch_path) == 50


def test_a_slide_of_the_unit_ahead_shows_in_the_estimates_alone() -> None:
    """Gyros still, the hitch's direction grows by 0.2 rad/s: followed within the 0.2 s of one estimate and its age."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    for tick in range(0, 2001, 20):
        memory = observer.with_signals(memory, turning(tick, lead=0.0, own=0.0))
        if tick % 100 == 0 and tick > 0:
            seen_tick = tick - 100
            memory = observer.corrected(memory, travelling(seen_tick, direction=2e-4 * (seen_tick - 50)), 0.1)
    assert memory.now.hitch_direction == pytest.approx(0.4, abs=0.04)
    assert memory.uncertainty > 0.0


def test_the_gyros_bias_is_learnt_from_the_estimates() -> None:
    """0.2 deg/s for 20 s, four times the time of its low-pass: 2 % of it are left."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    bias = math.radians(0.2)
    for tick in range(0, 20001, 20):
        memory = observer.with_signals(memory, turning(tick, lead=0.0, own=bias))
        if tick % 100 == 0 and tick > 0:
            memory = observer.corrected(memory, travelling(tick - 100), 0.1)
    assert memory.bias == pytest.approx(bias, rel=0.05)


def test_the_first_estimate_after_a_gap_teaches_nothing_but_the_path() -> None:
    """Its yaw rate is of its last frame, not of the 3 s without any; what the axles ahead did meanwhile is in doubt."""
    observer, memory = Observer(Combination(VEHICLE, 1)), ObserverMemory()
    for tick in range(0, 4001, 20):
        memory = observer.with_signals(memory, turning(tick, lead=0.0, own=1e-4 * tick))
        if tick % 100 == 0 and 0 < tick <= 1000:
            memory = observer.corrected(memory, travelling(tick - 100), 0.1)
    assert memory.uncertainty > 0.04  # 0.02 rad/s for 2.5 s
    after = observer.corrected(memory, travelling(3900), 3.0)
    assert (after.bias, after.slide, after.speed_scale) == (memory.bias, memory.slide, memory.speed_scale)
    np.testing.assert_array_equal(after.records, memory.records)


def driven(
    memory: FrictionMemory,
    true_moment: float,
    model_moment: float,
    by_friction: float,
    distance: float,
    uncertainty: float = 0.0,
) -> FrictionMemory:
    """The estimate after a distance; the model's tyres have a moment, plus the effect of its friction."""
    for _ in range(round(distance / 0.05)):
        moment = model_moment + by_friction * (memory.log_friction - FrictionMemory().log_friction)
        memory = updated(memory, moment - memory.disturbance - true_moment, by_friction, 0.05, uncertainty)
    return memory


def test_sliding_tyres_tell_the_friction_within_a_few_metres() -> None:
    """All tyres slide: they should do 0.45 of their load and do 0.2. Most of it is friction's, not a disturbance."""
    memory = driven(FrictionMemory(), 0.2, 0.45, 0.45, 10.0)
    assert memory.friction < 0.3
    assert abs(memory.disturbance) < 0.05


def test_tyres_that_grip_tell_nothing_of_friction() -> None:
    """The rest of the accelerometer's reading is a disturbance, and most of it is kept.

    The stationary Kalman filter of a disturbance of 0.03 that is forgotten over L = 20 m, with noise r = 0.04^2 m, has
    the gain k = sqrt(1/L^2 + 2 0.03^2 / (L r)) - 1/L = 0.192 per metre and thus keeps k / (k + 1/L) = 0.794 of it.
    """
    memory = driven(FrictionMemory(), 0.05, 0.0, 0.0, 30.0)
    assert memory.friction == pytest.approx(FrictionMemory().friction)
    assert memory.disturbance == pytest.approx(-0.05 * 0.794, abs=0.001)  # steps of 0.05 m for a continuous filter


def test_friction_stays_while_the_motion_of_the_tyres_is_uncertain() -> None:
    """The same slide where the hitch's direction may be wrong by 5 deg: a third of it at most is believed."""
    sure = driven(FrictionMemory(), 0.2, 0.45, 0.45, 1.0)
    doubtful = driven(FrictionMemory(), 0.2, 0.45, 0.45, 1.0, uncertainty=0.4)
    first = FrictionMemory().log_friction
    assert first - doubtful.log_friction < 0.34 * (first - sure.log_friction)


SHORT = np.array([[0.0, 0.0], [-0.28, 0.0], [-0.56, 0.0]])


def test_a_straight_trailer_is_assumed_to_start_on_its_path() -> None:
    """While the path is shorter than the trailer, the axis at its beginning continues it to the rear."""
    lost = travelling(200, path=SHORT, health=Health.LOST)
    begun = with_estimate(None, lost, FOLLOW)
    assert begun is not None
    assert not begun.complete
    so_far = path_now(begun, Reckoned(Pose2(0.28, 0.0, 0.0), np.array([[0.28, 0.0]])), FOLLOW)
    assert so_far is not None
    assert so_far[:, 0].min() < -FOLLOW
    assert not so_far[:, 1].any()
    turned = with_estimate(None, travelling(200, path=SHORT, health=Health.LOST, direction=0.3), FOLLOW)
    assert turned is not None
    assert path_now(turned, Reckoned(Pose2(0.0, 0.0, 0.0), np.empty((0, 2))), FOLLOW) is None


def test_a_whole_path_without_health_is_not_used() -> None:
    """There the odometry failed, and its path is a guess."""
    first = with_estimate(None, travelling(100), FOLLOW)
    assert with_estimate(first, travelling(200, health=Health.LOST), FOLLOW) is first
    assert with_estimate(None, travelling(200, health=Health.LOST), FOLLOW) is None


# Model against the plant, closed forms and differences


MODEL = TrailerModel.of(trailer_geometry(VEHICLE, 1), Combination(VEHICLE, 1))
TEN_KMH = 10.0 / 3.6


def given(**known: float) -> FloatArray:
    """Inputs of a prediction: zero but for those given, at 10 km/h on a dry road."""
    told = {"rate": 0.0, "speed": TEN_KMH, "course_rate": 0.0, "pull": 0.0, "disturbance": 0.0, "friction": 0.8} | known
    rates = [told.pop("rate")] * MODEL.n_actuators
    return np.array([*rates, *told.values()])


@pytest.mark.parametrize("friction", [0.8, 0.2])
@pytest.mark.parametrize(("speed", "angle"), [(TEN_KMH, 0.15), (20.0, 0.03)])
def test_the_prediction_turns_as_the_plant_does(speed: float, angle: float, friction: float) -> None:
    """Steered trailer axles on a straight road for 1.2 s, told how the plant's hitch travels: yaw within a tenth.

    Left out are roll, load transfer and the tractor, which takes some of the moment at speed.
    """
    plant = Plant(VEHICLE, Surface(friction=friction))
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed)
    command = VehicleCommand(0.0, 0.0, (angle, angle))
    predicted = np.zeros(sum(state_sizes(MODEL)))
    predicted[-2:] = angle
    step, ticks = Stepper(MODEL), round(STEP / TICK)
    course = 0.0
    for k in range(24):
        truth = plant.observe(state, k)
        state = plant.step(state, command, ticks)
        after = plant.observe(state, k)
        before, course = course, after.poses[1, 2] + math.atan2(after.velocities[1, 1], after.velocities[1, 0])
        hitch_speed = math.hypot(*truth.velocities[1, :2])
        predicted = step(
            predicted, given(speed=hitch_speed, course_rate=(course - before) / STEP, friction=friction)
        ).state
    turned, yaw_rate = after.poses[1, 2], after.velocities[1, 2]
    assert abs(turned) > 0.01
    assert course - predicted[0] == pytest.approx(turned, rel=0.1)
    assert predicted[1] == pytest.approx(yaw_rate, abs=0.1 * abs(turned) / STEP / 24 + 0.1 * abs(yaw_rate))


def test_in_a_steady_circle_the_axles_that_point_right_roll_without_slip() -> None:
    """No slip, no side force, no pull: an equilibrium where the follow point runs on the hitch's circle.

    Small angles of slip are left, for the fixed axle scrubs: so all three are taken as steered by the closed form.
    """
    radius, follow = 12.0, 14.0
    lead = math.asin(0.5 * follow / radius)
    yaw_rate = TEN_KMH / radius
    angles = [
        math.atan2(TEN_KMH * math.sin(lead) - axle.x * yaw_rate, TEN_KMH * math.cos(lead)) for axle in MODEL.axles
    ]
    every = TrailerModel(
        axles=tuple(type(axle)(axle.x, axle.load, axle.tyre, k, 1.0) for k, axle in enumerate(MODEL.axles)),
        mass_moment=0.0,  # and no inertia in the hitch's turn
        inertia=MODEL.inertia,
        n_actuators=3,
        actuator_lag=0.15,
    )
    x = ca.SX(np.array([lead, yaw_rate, 0.0, 0.0, 0.0, *angles, *angles]))
    u = ca.SX(np.array([0.0, 0.0, 0.0, TEN_KMH, yaw_rate, 0.0, 0.0, 0.8]))
    rates = rate(every, State(*parts(x, state_sizes(every))), Inputs(u[:3], *ca.vertsplit(u[3:])))
    assert np.abs(np.array(ca.DM(ca.vertcat(*rates)))).max() < 1e-5  # of a push that is never quite zero


def test_derivatives_are_those_of_differences() -> None:
    """Gauss-Newton rests on them; central differences of 1e-6 are right to 1e-6 of these sizes."""
    rng = np.random.default_rng(1)
    n = sum(state_sizes(MODEL))
    state, told = rng.normal(scale=0.05, size=n), given(course_rate=0.2, pull=0.3, friction=0.3, rate=0.1)
    step = Stepper(MODEL)
    at = step(state, told)
    for k in range(n):
        ahead, back = (step(state + side * 1e-6 * np.eye(n)[k], told) for side in (1.0, -1.0))
        np.testing.assert_allclose(at.by_state[:, k], (ahead.state - back.state) / 2e-6, atol=1e-5)
        np.testing.assert_allclose(at.slip_by_state[:, k], (ahead.slip - back.slip) / 2e-6, atol=1e-5)
    ahead, back = (step(state, told + side * 1e-6 * np.eye(len(told))[0]) for side in (1.0, -1.0))
    np.testing.assert_allclose(at.by_rate[:, 0], (ahead.state - back.state) / 2e-6, atol=1e-5)


def test_small_slip_makes_its_stiffness_of_force_and_large_slip_friction() -> None:
    """All axles at one slip: the moment over the load moment is the force over the load."""
    steer = np.zeros(2)
    for slip, friction, force in ((0.001, 0.8, 0.001 * MODEL.stiffness), (0.25, 0.2, 0.2)):
        deflection = np.zeros(3)
        for _ in range(100):  # 2 s, 11 relaxation lengths
            tyres = rolled_on(
                MODEL, deflection, steer, hitch_direction=slip, yaw_rate=0.0, speed=TEN_KMH, friction=friction
            )
            deflection = tyres.deflection
        assert -tyres.moment == pytest.approx(force, rel=0.05)  # pneumatic trail, and the curve past its peak
    assert -tyres.by_friction == pytest.approx(0.2, rel=0.1)  # sliding tyres go with the friction
    assert TYRE_STEP * 100 > 1.0
