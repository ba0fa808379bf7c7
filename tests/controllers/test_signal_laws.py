"""Command steer and CT-AT, laws on the combination's own signals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import Combination
from controllers.trailer_steering.kinematics import hitch_motion
from controllers.trailer_steering.signal_laws import CommandSteer, CtAt
from scenarios.courses import roundabout, straight
from sensors.messages import CombinationSignals
from tests.trailers import ALL_STEERED, COMBINATION, signals
from vehicle.combination.description import load_vehicle

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
