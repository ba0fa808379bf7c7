"""Command steer: the trailer of a rigid axle somewhere else, in steady turns and on the way into them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import Combination
from controllers.trailer_steering.kinematics import hitch_motion
from controllers.trailer_steering.path_preview import PathPreview
from controllers.trailer_steering.signal_laws import CommandSteer
from scenarios.courses import roundabout
from sensors.messages import CombinationSignals
from tests.trailers import ALL_STEERED as TRAILER
from tests.trailers import COMBINATION

HITCH_X = COMBINATION.vehicle.units[0].rear_hitch[0]


def turning(radius: float, articulation: float, speed: float = 3.0, tick: int = 0) -> CombinationSignals:
    """Steady turn of the tractor's rear axle on a radius [m]."""
    return CombinationSignals(
        tick=tick,
        angles=np.zeros(3),
        speed=speed,
        steer=math.atan(3.8 / radius),
        articulation=np.array([articulation]),
        yaw_rates=np.full(2, speed / radius),
        lateral_acceleration=0.0,
    )


def settled(law: CommandSteer, signals: CombinationSignals) -> Any:
    """The command once the rate limit no longer counts."""
    memory, command = law.init(), None
    for tick in range(0, 4000, 20):
        memory, command = law.step(memory, tick, None, replace(signals, tick=tick))
    assert command is not None
    return command.angles


def circling(radius: float) -> CombinationSignals:
    """The trailer of half the follow distance, rigid, behind the tractor on this radius of the rear axle [m]."""
    hitch_radius = math.hypot(radius, HITCH_X)
    articulation = math.asin(7.0 / hitch_radius) - math.atan(HITCH_X / radius)
    return turning(radius, articulation)


@pytest.mark.parametrize("radius", [12.0, 30.0, -20.0])
def test_half_the_follow_distance_is_the_exact_angle_of_steady_path_following(radius: float) -> None:
    """tan delta(x) = -(x - Lf/2)/sqrt(R^2 - Lf^2/4), R of the hitch: then the off-tracking is zero; closed form."""
    angles = settled(CommandSteer(TRAILER, combination=COMBINATION), replace_sign(circling(abs(radius)), radius))
    hitch_radius = math.hypot(radius, HITCH_X)
    distances = np.array(TRAILER.axle_distances)
    exact = -math.copysign(1.0, radius) * np.arctan((distances - 7.0) / math.sqrt(hitch_radius**2 - 49.0))
    np.testing.assert_allclose(angles, exact, atol=1e-9)  # rounding of tangents


def replace_sign(signals: CombinationSignals, radius: float) -> CombinationSignals:
    """The same turn, to the right if the radius is negative."""
    side = math.copysign(1.0, radius)
    return replace(
        signals,
        steer=side * signals.steer,
        articulation=side * signals.articulation,
        yaw_rates=side * signals.yaw_rates,
    )


def test_a_rigid_axle_where_the_axle_is_needs_no_steer() -> None:
    """L' at the single axle: it stays straight at any articulation."""
    single = replace(TRAILER, axle_distances=(9.31,), steered=(True,))
    law = CommandSteer(single, combination=COMBINATION, parameters=CommandSteer.Parameters(rigid_length=9.31))
    memory, command = law.step(law.init(), 0, None, turning(12.0, 0.5))
    memory, command = law.step(memory, 1000, None, replace(turning(12.0, 0.5), tick=1000))
    assert np.abs(command.angles).max() < 1e-12


def test_no_steady_off_tracking_but_tail_swing(drive: Any) -> None:
    """In the 12.5 m roundabout the error of the entry dies out; in and out of the turn the rear runs a metre wide.

    Path following keeps within 0.05 m throughout: that is what it is compared with.
    """
    course = roundabout(front_x=5.2, width=2.55, turn=1.25 * math.tau)
    near = COMBINATION.vehicle.units[0].model_copy(update={"hitch_x": 0.6})  # the tractor of `drive`
    vehicle = COMBINATION.vehicle.model_copy(update={"units": (near, *COMBINATION.vehicle.units[1:])})
    run = drive(course, TRAILER, CommandSteer(TRAILER, combination=Combination(vehicle, 1)))
    at_end = run.off_tracking[(run.station > 122.0) & (run.station < 127.0)]
    assert np.nanmax(np.abs(at_end)) < 0.02  # after a turn and a quarter: 5 m e^(-92 m/12 m), and falling
    assert run.worst > 1.0
    assert drive(course, TRAILER, PathPreview(TRAILER), until=20.0).worst < 0.05


def test_the_hitch_moves_as_a_lever_on_the_tractor() -> None:
    """A rear axle going straight ahead and a hitch 0.77 m in front of it: v_y = r x, turned by the articulation."""
    motion = hitch_motion(COMBINATION, turning(10.0, 0.3, speed=2.0))
    assert math.hypot(motion.v_x, motion.v_y) == pytest.approx(math.hypot(2.0, 0.2 * HITCH_X))
    assert motion.direction == pytest.approx(0.3 + math.atan(0.2 * HITCH_X / 2.0))
    backwards = hitch_motion(COMBINATION, replace(turning(10.0, 0.3), speed=-3.0, yaw_rates=np.full(2, -0.3)))
    assert backwards.direction == pytest.approx(0.3 + math.atan(0.1 * HITCH_X))  # the same line, backwards


@pytest.mark.parametrize("length", [0.5, 40.0])
def test_a_length_no_axle_could_emulate_is_refused(length: float) -> None:
    """By name, value, limits and unit."""
    with pytest.raises(ValueError, match=rf"rigid_length = {length} m must be between 1.4 and 28 m"):
        CommandSteer(TRAILER, combination=COMBINATION, parameters=CommandSteer.Parameters(rigid_length=length))
