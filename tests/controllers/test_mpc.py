"""Model predictive trailer steering: closed loops with slipping tyres, limits, and its behaviour without estimates."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from controllers.trailer import Combination, Linkage, TrailerGeometry
from controllers.trailer_steering.mpc.law import Mpc, MpcMemory
from estimators.estimates import Health, OffTracking
from scenarios.assembly.adapters import trailer_geometry
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.metrics import peak, rms
from sensors.messages import CombinationSignals
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

VEHICLE = load_vehicle("uk_longer_semitrailer")
COMBINATION = Combination(VEHICLE, 1)
TRAILER = trailer_geometry(VEHICLE, 1)
SPEED = 2.8
PATH = np.column_stack([-np.linspace(0.0, 16.0, 60), np.zeros(60)])


@cache
def off_tracking(law: str, *settings: str) -> FloatArray:
    """True off-tracking [m] in a good quarter of a roundabout with exact estimates and the signals of a data sheet."""
    course = ("course.turn_deg=100", "course.entry=22", "course.exit=5", "off_tracking=truth", "reference_unit=false")
    return run(load_scenario("roundabout", [*course, f"trailer_steering={law}", *settings]), 1).log["off_tracking_true"]


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


def test_a_kerb_on_the_inside_swings_the_rear_out() -> None:
    """Following a circle of 10 m exactly, the middle of 14 m cuts in by 10 - sqrt(10^2 - 7^2) = 2.9 m.

    Held to 2.2 m against a tail swing of 0.4 m, the soft limits meet in between: the follow point goes wide, to the
    right of the path, about 0.7 times the rest of 0.3 m beyond that.
    """
    free, held = off_tracking("mpc"), off_tracking("mpc", "steering.cut_in=2.2", "steering.tail_swing=0.4")
    assert peak(free) < 0.05
    assert float(np.nanmax(held)) > 0.3  # the path lies to its left
    assert peak(held) < 0.8


# The law alone, on given estimates.


def estimate(tick: int, *, offset: float = 0.0, health: Health = Health.OK, v_x: float = SPEED) -> OffTracking:
    """Straight travel with the path ``offset`` to the left of the trailer's axis behind the hitch."""
    return OffTracking(
        tick=tick,
        value=offset,
        std=0.01,
        health=health,
        path=PATH + np.column_stack([np.zeros(60), offset * np.minimum(1.0, -PATH[:, 0] / 10.0)]),
        hitch_direction=0.0,
        hitch_direction_rate=0.0,
        path_tangent=0.0,
        v_x=v_x,
        v_y=0.0,
        yaw_rate=0.0,
    )


def arriving(**about: Any) -> Callable[[int], OffTracking | None]:
    """A new estimate every 0.1 s, 0.1 s old."""
    return lambda tick: estimate(tick // 100 * 100 - 100, **about) if tick >= 100 else None


def steps(
    law: Mpc,
    until: int,
    seen: Callable[[int], OffTracking | None],
    memory: MpcMemory | None = None,
    start: int = 0,
    speed: float = SPEED,
) -> tuple[MpcMemory, FloatArray]:
    """Memory after, and commands (n, axles) of the steps in between, with immediate actuators."""
    memory = law.init() if memory is None else memory
    angles, commands = np.zeros(len(TRAILER.steered_distances)), []
    for tick in range(start, until, 20):
        signals = CombinationSignals(
            tick=tick,
            angles=angles,
            speed=speed,
            steer=0.0,
            articulation=np.zeros(1),
            yaw_rates=np.zeros(2),
            lateral_acceleration=0.0,
        )
        memory, command = law.step(memory, tick, seen(tick), signals)
        angles = command.angles
        commands.append(angles)
    return memory, np.array(commands)


def law(trailer: TrailerGeometry = TRAILER, **parameters: float) -> Mpc:
    return Mpc(trailer, combination=COMBINATION, parameters=Mpc.Parameters(**parameters))


def test_a_path_to_the_left_turns_the_rear_to_the_left() -> None:
    """Both axles push to the left: steered left."""
    _, commands = steps(law(), 300, arriving(offset=0.2))
    assert (commands[-1] > 0.0).all()


def test_hard_limits_hold_on_the_way_to_a_far_path() -> None:
    """2 m aside, the plan runs into rate and angle; what is commanded never does more than the actuators can."""
    weak = replace(TRAILER, max_steer=0.1, max_steer_rate=0.2)
    _, commands = steps(law(weak), 2000, arriving(offset=2.0))
    assert np.abs(commands).max() == pytest.approx(0.1, abs=1e-6)
    assert np.abs(np.diff(commands, axis=0)).max() == pytest.approx(0.2 * 0.02, abs=1e-6)


def test_a_linked_axle_keeps_its_ratio() -> None:
    """Two axles on one actuator, the second at 1.4 of its angle: the limit is on the larger."""
    linked = replace(TRAILER, linkages=(Linkage((0, 1), (1.0, 1.4)),))
    _, commands = steps(law(linked), 600, arriving(offset=0.3))
    np.testing.assert_allclose(commands[:, 1], 1.4 * commands[:, 0], atol=1e-12)
    assert np.abs(commands).max() > 0.01


def test_a_lost_estimate_is_bridged_and_then_the_axles_fade_to_straight() -> None:
    """For 2 s the signals carry the last path on, then the angles go down at 0.05 rad/s and stay at zero."""
    controller = law()
    memory, _ = steps(controller, 600, arriving(offset=0.5))
    lost = estimate(550, health=Health.LOST)
    memory, fading = steps(controller, 14000, lambda tick: lost, memory, 600)
    rates = np.abs(np.diff(fading[105:], axis=0)) / 0.02
    assert rates.max() == pytest.approx(0.05, abs=1e-9)
    assert not fading[-1].any()
    _, again = steps(controller, 14400, arriving(offset=0.5), memory, 14000)
    assert np.abs(again[-1]).min() > 0.01  # and it comes back when there is something to see


def test_the_axles_stay_where_they_are_at_standstill() -> None:
    """Slip is not defined there, and turning the wheels on the spot would only wear them."""
    controller = law()
    memory, moving = steps(controller, 400, arriving(offset=0.2))
    _, standing = steps(controller, 2000, arriving(offset=0.2, v_x=0.0), memory, 400, speed=0.0)
    np.testing.assert_array_equal(standing[0], standing[-1])
    assert standing[-1] == pytest.approx(moving[-1], abs=0.01)


def test_law_and_memory_travel_to_other_processes() -> None:
    """Resumed there, the run goes on bit for bit."""
    controller = law(tolerance=0.02)
    memory, _ = steps(controller, 400, arriving(offset=0.2))
    copy, memory_copy = pickle.loads(pickle.dumps((controller, memory)))
    _, here = steps(controller, 800, arriving(offset=0.2), memory, 400)
    _, there = steps(copy, 800, arriving(offset=0.2), memory_copy, 400)
    np.testing.assert_array_equal(here, there)


def test_a_trailer_without_steered_axles_is_refused() -> None:
    """It could not follow anything."""
    with pytest.raises(ValueError, match="no steered axle"):
        law(replace(TRAILER, steered=(False, False, False)))
