"""One law for all speeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from controllers.trailer import TrailerSteering
from controllers.trailer_steering.lqr import Combined, Lqr
from controllers.trailer_steering.path_preview import PathPreview
from controllers.trailer_steering.signal_laws import CommandSteer, CtAt
from controllers.trailer_steering.virtual_driver import VirtualDriver
from estimators.estimates import Health, OffTracking
from scenarios.assembly.adapters import trailer_geometry
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION
from tests.trailers import signals as readings
from vehicle.clock import TICK
from vehicle.frames import FloatArray

TRAILER = trailer_geometry(COMBINATION.vehicle, 1)
ALONE: dict[str, Callable[[], TrailerSteering[Any]]] = {
    "command_steer": lambda: CommandSteer(TRAILER, combination=COMBINATION),
    "ct_at": lambda: CtAt(TRAILER, combination=COMBINATION),
    "path_preview": lambda: PathPreview(TRAILER),
    "virtual_driver": lambda: VirtualDriver(TRAILER),
}


def signals(tick: int, speed: float) -> CombinationSignals:
    """A swerve."""
    wave = np.sin(0.004 * tick)
    return readings(
        tick, speed=speed, steer=0.02 * wave, articulation=np.array([0.02 * wave]), yaw_rates=np.full(2, 0.05 * wave)
    )


def estimate(tick: int, speed: float) -> OffTracking:
    """The path 0.2 m to the left of the follow point, and inclined."""
    x = -np.linspace(0.0, 16.0, 40)
    return OffTracking(
        tick=tick,
        value=0.2,
        std=0.01,
        health=Health.OK,
        path=np.column_stack([x, -0.2 * x / TRAILER.follow_distance]),
        hitch_direction=0.01,
        hitch_direction_rate=0.0,
        path_tangent=0.01,
        v_x=speed,
        v_y=0.0,
        yaw_rate=0.0,
    )


def commands(law: TrailerSteering[Any], speeds: FloatArray, *, estimates: bool = False) -> FloatArray:
    """Commands (n, n_steered) while the speed runs through ``speeds`` [m/s]; estimates are of 0.1 s ago."""
    memory, angles = law.init(), []
    for k, speed in enumerate(speeds.tolist()):
        tick = 20 * k
        newest = estimate(100 * (tick // 100 - 1), speed) if estimates and tick >= 100 else None
        memory, command = law.step(memory, tick, newest, signals(tick, speed))
        angles.append(command.angles)
    return np.array(angles)


def test_at_speed_it_is_the_lqr() -> None:
    """The low-speed law has no part in it."""
    speeds = np.full(100, 24.0)
    combined = commands(Combined(TRAILER, combination=COMBINATION), speeds, estimates=True)
    assert combined.any()
    expected = commands(Lqr(TRAILER, combination=COMBINATION), speeds, estimates=True)
    np.testing.assert_array_equal(combined, expected)


@pytest.mark.parametrize("low_speed", ALONE)
def test_at_walking_pace_it_is_the_low_speed_law(low_speed: str) -> None:
    """The LQR is silent there; the sum is the low-speed law's command, to the last bit."""
    speeds = np.full(100, 3.0)
    law = Combined(TRAILER, combination=COMBINATION, parameters=Combined.Parameters.of({"low_speed": low_speed}))
    combined = commands(law, speeds, estimates=True)
    assert np.abs(combined).max() > 1e-3  # every law steers here
    np.testing.assert_array_equal(combined, commands(ALONE[low_speed](), speeds, estimates=True))


def test_every_low_speed_law_is_compared() -> None:
    """The choices that the law declares."""
    assert set(Combined.Parameters.option("low_speed").choices) == set(ALONE)


def test_speeding_up_and_slowing_down_is_seamless() -> None:
    """Through the band of speeds where hands change: within the rate limit, no step where the band begins or ends."""
    ramp = np.linspace(3.0, 16.0, 200)
    law = Combined(TRAILER, combination=COMBINATION, parameters=Combined.Parameters(low_speed="command_steer"))
    angles = commands(law, np.concatenate([ramp, ramp[::-1]]))
    steps = np.abs(np.diff(angles, axis=0)).max(axis=1)
    assert steps.max() < 0.9 * TRAILER.max_steer_rate * 20 * TICK  # a step would be caught by the rate limit, at it
