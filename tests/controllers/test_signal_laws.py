"""Command steer and CT-AT, laws on the combination's own signals, and claims that hold for several laws."""

import inspect
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import Combination, Linkage, TrailerGeometry
from controllers.trailer_steering.kinematics import hitch_motion
from controllers.trailer_steering.signal_laws import CommandSteer, CtAt, Learnt, ReckonedDriver
from scenarios.catalogue import TRAILER_STEERING, resolve
from scenarios.courses import roundabout, straight
from sensors.messages import CombinationSignals
from tests.trailers import ALL_STEERED, COMBINATION, TWO_OF_THREE, estimate, signals
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

HITCH_X = COMBINATION.vehicle.units[0].rear_hitch[0]


def turning(radius: float, articulation: float, speed: float = 3.0, tick: int = 0) -> CombinationSignals:
    """Steady turn of the tractor's rear axle on a radius [m]."""
    return signals(
        tick,
        angles=np.zeros(3),
        speed=speed,
        steer=math.atan(3.8 / radius),
        articulation=np.array([articulation]),
        yaw_rates=np.full(2, speed / radius),
    )


def settled(law: CommandSteer, read: CombinationSignals) -> Any:
    memory, command = law.init(), None
    for tick in range(0, 4000, 20):
        memory, command = law.step(memory, tick, None, replace(read, tick=tick))
    assert command is not None
    return command.angles


def circling(radius: float) -> CombinationSignals:
    """The trailer of half the follow distance, rigid, behind the tractor on this radius of the rear axle [m]."""
    hitch_radius = math.hypot(radius, HITCH_X)
    articulation = math.copysign(math.asin(7.0 / hitch_radius), radius) - math.atan(HITCH_X / radius)
    return turning(radius, articulation)


@pytest.mark.parametrize("radius", [12.0, 30.0, -20.0])
def test_half_the_follow_distance_is_the_exact_angle_of_steady_path_following(radius: float) -> None:
    """tan delta(x) = -(x - Lf/2)/sqrt(R^2 - Lf^2/4), R of the hitch: then the off-tracking is zero; closed form."""
    angles = settled(CommandSteer(ALL_STEERED, combination=COMBINATION), circling(radius))
    hitch_radius = math.hypot(radius, HITCH_X)
    distances = np.array(ALL_STEERED.axle_distances)
    exact = -math.copysign(1.0, radius) * np.arctan((distances - 7.0) / math.sqrt(hitch_radius**2 - 49.0))
    np.testing.assert_allclose(angles, exact, atol=1e-9)  # rounding of tangents


def test_a_rigid_axle_where_the_axle_is_needs_no_steer() -> None:
    """L' at the single axle: it stays straight at any articulation."""
    single = replace(ALL_STEERED, axle_distances=(9.31,), steered=(True,))
    law = CommandSteer(single, combination=COMBINATION, parameters=CommandSteer.Parameters(rigid_length=9.31))
    memory, command = law.step(law.init(), 0, None, turning(12.0, 0.5))
    memory, command = law.step(memory, 1000, None, replace(turning(12.0, 0.5), tick=1000))
    assert np.abs(command.angles).max() < 1e-12


@pytest.mark.slow
def test_no_steady_off_tracking_but_tail_swing(drive: Any) -> None:
    """In the 12.5 m roundabout the error of the entry dies out; in and out of the turn the rear runs a metre wide."""
    course = roundabout(front_x=5.2, width=2.55, turn=1.25 * math.tau)
    near = COMBINATION.vehicle.units[0].model_copy(update={"hitch_x": 0.6})  # the tractor of `drive`
    vehicle = COMBINATION.vehicle.model_copy(update={"units": (near, *COMBINATION.vehicle.units[1:])})
    run = drive(course, ALL_STEERED, CommandSteer(ALL_STEERED, combination=Combination(vehicle, 1)))
    at_end = run.off_tracking[(run.station > 122.0) & (run.station < 127.0)]
    assert np.nanmax(np.abs(at_end)) < 0.02  # after a turn and a quarter: 5 m e^(-92 m/12 m), and falling
    assert run.worst > 1.0


def test_the_hitch_moves_as_a_lever_on_the_tractor() -> None:
    """A rear axle going straight ahead and a hitch 0.77 m in front of it: v_y = r x, turned by the articulation."""
    motion = hitch_motion(COMBINATION, turning(10.0, 0.3, speed=2.0))
    assert math.hypot(motion.v_x, motion.v_y) == pytest.approx(math.hypot(2.0, 0.2 * HITCH_X))
    assert motion.direction == pytest.approx(0.3 + math.atan(0.2 * HITCH_X / 2.0))
    backwards = hitch_motion(COMBINATION, replace(turning(10.0, 0.3), speed=-3.0, yaw_rates=np.full(2, -0.3)))
    assert backwards.direction == pytest.approx(0.3 + math.atan(0.1 * HITCH_X))  # the same line, backwards
    alone = hitch_motion(Combination(COMBINATION.vehicle, 0), replace(turning(10.0, 0.3), yaw_rates=np.zeros(2)))
    assert alone.direction == pytest.approx(math.atan(3.8 / 10.0))  # led by the foremost axle, where it is steered to


@pytest.mark.parametrize("length", [0.5, 40.0])
def test_a_length_no_axle_could_emulate_is_refused(length: float) -> None:
    with pytest.raises(ValueError, match=rf"rigid_length = {length} m must be between 1.4 and 28 m"):
        CommandSteer(ALL_STEERED, combination=COMBINATION, parameters=CommandSteer.Parameters(rigid_length=length))


# CT-AT


LOADED = load_vehicle("uk_longer_semitrailer")
TRACTOR = LOADED.units[0].model_copy(update={"hitch_x": 0.6})  # that of `drive`
OF_DRIVE = Combination(LOADED.model_copy(update={"units": (TRACTOR, *LOADED.units[1:])}), 1)
ROUNDABOUT = roundabout(front_x=5.2, width=2.55)


@pytest.mark.slow
def test_without_slip_the_follow_point_keeps_to_the_path(drive: Any) -> None:
    """Unsteered, it would be 5 m off. 0.1 m is what path-following control aims at (de Saxe 2018, 2)."""
    run = drive(ROUNDABOUT, ALL_STEERED, CtAt(ALL_STEERED, combination=OF_DRIVE))
    assert run.rms < 0.06
    assert run.worst < 0.10


@pytest.mark.slow
def test_slip_leaves_a_steady_error_that_the_heading_can_not_show(drive: Any) -> None:
    """Straight on a cross-fall, axles slipping by s turn the rear by s L_f/x_c beside what was asked for.

    A heading error e/L_f times the gain K balances it: e = -s L_f (L_f/x_c)/K, with x_c = sum(x^2)/sum(x).
    """
    slip, gain = -math.radians(1.0), 1.5
    run = drive(
        straight(front_x=5.2, length=160.0),
        ALL_STEERED,
        CtAt(ALL_STEERED, combination=OF_DRIVE, parameters=CtAt.Parameters(heading_gain=gain)),
        slip=lambda lateral_acceleration: slip,
    )
    assert abs(run.off_tracking[-1]) > 0.1  # the known weakness of the scheme
    distances = np.array(ALL_STEERED.axle_distances)
    x_c = float(distances @ distances) / float(distances.sum())
    assert run.off_tracking[-1] == pytest.approx(-slip * 14.0 * (14.0 / x_c) / gain, rel=0.01)  # tangents for angles


@pytest.mark.slow
def test_the_reference_trailer_brings_the_rear_back_after_saturation(drive: Any) -> None:
    """Axles that get no farther than 12 deg lose the path in the circle; heading alone would not find it again."""
    short = replace(ALL_STEERED, max_steer=math.radians(12.0))
    course = roundabout(front_x=5.2, width=2.55, turn=0.25 * math.tau, exit=75.0)
    with_reference = drive(course, short, CtAt(short, combination=OF_DRIVE))
    without = drive(course, short, CtAt(short, combination=OF_DRIVE, parameters=CtAt.Parameters(heading_gain=0.0)))
    assert with_reference.worst > 0.3  # it was saturated
    assert abs(with_reference.off_tracking[-1]) < 0.05
    assert abs(without.off_tracking[-1]) > 0.3


# Dead reckoning


def learnt(until: int, speed: float, period: int = 100, bias: float = 0.0, v_y: float = 0.0) -> Learnt:
    """What dead reckoning holds of its signals, which say ``speed`` and ``bias`` more than the true yaw rate.

    In truth it is 2.8 m/s and 0.02 rad/s.
    """
    driver = ReckonedDriver(TWO_OF_THREE, COMBINATION)
    memory = driver.init()
    for tick in range(0, until + 1, 20):
        seen = estimate(tick // period * period, v_y=v_y, yaw_rate=0.02)  # the newest one, again and again
        memory = driver.reckoned(memory, tick, seen, signals(tick, speed=speed, yaw_rates=np.array([0.0, 0.02 + bias])))
    return memory.learnt


def test_dead_reckoning_learns_the_errors_of_its_signals_from_estimates() -> None:
    """Wheels that say too little and a gyro's bias, within 5 s; not from estimates 0.6 s apart, nor at a creep."""
    for seconds in (1.1, 15.0):
        found, share = learnt(round(1000 * seconds), 2.66, bias=0.01), 1.0 - math.exp(-seconds / 5.0)
        assert found.scale - 1.0 == pytest.approx(share * (2.8 / 2.66 - 1.0), rel=0.02)
        assert found.yaw_rate == pytest.approx(share * 0.01, rel=0.02)
    assert learnt(6000, 2.66, period=600, bias=0.01) == learnt(6000, 0.4, bias=0.01) == Learnt()


def test_dead_reckoning_tells_the_slip_of_a_bend_from_that_which_stays() -> None:
    """Of 0.05 rad it believes what 2 m of way prove, and a fiftieth a metre for good; never more than 0.1 rad."""
    way, slip = 0.1 * 2.8, math.atan(0.05)
    quick, steady = 1.0 - math.exp(-way / 2.0), 1.0 - math.exp(-way / 50.0)
    found = learnt(100, 2.8, v_y=0.05 * 2.8)
    believed = quick * (slip + 0.5 * 0.1 * 0.02)  # the trailer has turned meanwhile, by a half of it on average
    assert (found.slip, found.offset) == pytest.approx(((1.0 - steady) * believed, steady * believed), rel=2e-3)
    later, sideways = (learnt(30_000, 2.8, v_y=v_y) for v_y in (0.05 * 2.8, -2.8))
    assert later.slip + later.offset == pytest.approx(slip, rel=0.05)
    assert later.offset > later.slip
    assert (sideways.slip, sideways.offset) == pytest.approx((-0.1, -0.1), abs=0.01)


# Claims that hold for several laws, without their safeguards


X = -np.linspace(0.0, 16.0, 60)
by_estimates = pytest.mark.parametrize("name", ["path_preview", "virtual_driver", "mpc"])


def constructed(name: str, trailer: TrailerGeometry) -> Any:
    part = resolve("trailer_steering", name, TRAILER_STEERING)
    keywords = {"combination": COMBINATION} if "combination" in inspect.signature(part).parameters else {}
    return part(trailer, **keywords)


def commands(
    name: str, trailer: TrailerGeometry, offset: float, *, stands_from: int = 99999, then: float = 0.0
) -> FloatArray:
    """Angles (n, axles) [rad] of 1.2 s, with the path ``offset`` to the left of the follow point, 0.1 s old."""
    law, path = constructed(name, trailer), np.column_stack([X, -offset * X / 14.0])
    memory, angles, found, newest = law.init(), np.zeros(sum(trailer.steered)), [], None
    for tick in range(0, 1200, 20):
        speed = 2.8 if tick < stands_from else then
        if tick % 100 == 0 and tick:
            newest = estimate(tick - 100, value=offset, path=path, v_x=speed)
        memory, command = law.step(memory, tick, newest, signals(tick, angles=angles, speed=speed))
        angles = command.angles
        found.append(angles)
    return np.array(found)


@by_estimates
def test_a_path_to_the_left_turns_the_rear_to_the_left(name: str) -> None:
    """All axles push to the left: steered left, for those of a common centre the farther back the more."""
    angles = commands(name, ALL_STEERED if name == "path_preview" else TWO_OF_THREE, 0.2)[20]
    assert (angles > 0.0).all()
    if name in ("path_preview", "virtual_driver"):
        assert (np.diff(angles) > 0.0).all()


@by_estimates
def test_linked_axles_keep_their_ratio_within_the_actuators_limits(name: str) -> None:
    """Two axles on one actuator, the second at 1.4 of its angle: rate and angle are the actuator's."""
    linked = replace(TWO_OF_THREE, linkages=(Linkage((0, 1), (1.0, 1.4)),))
    angles = commands(name, linked, 0.5)
    np.testing.assert_allclose(angles[:, 1], 1.4 * angles[:, 0], atol=1e-12)
    assert np.abs(angles).max() > 0.01
    assert np.abs(np.diff(angles[:, 0])).max() <= linked.max_steer_rate * 0.02 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("name", "speed"),
    [("path_preview", 0.1), ("path_preview", 0.0), ("path_preview", -2.0), ("virtual_driver", 0.0), ("mpc", 0.0)],
)
def test_the_axles_stay_where_they_are_when_the_trailer_does_not_roll_forwards(name: str, speed: float) -> None:
    """Turning the wheels on the spot would only wear them; one step may pass before the standstill is known."""
    angles = commands(name, TWO_OF_THREE, 0.2, stands_from=600, then=speed)
    np.testing.assert_array_equal(angles[-1], angles[40])
    assert angles[-1] == pytest.approx(angles[30], abs=0.05)
