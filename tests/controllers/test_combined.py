"""One law for all speeds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from controllers.trailer import Combination
from controllers.trailer_steering.combined import Combined
from controllers.trailer_steering.lqr import Lqr
from controllers.trailer_steering.path_preview import PathPreview
from scenarios.assembly.adapters import trailer_geometry
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

VEHICLE = load_vehicle("uk_longer_semitrailer")
COMBINATION, TRAILER = Combination(VEHICLE, 1), trailer_geometry(VEHICLE, 1)


def signals(tick: int, speed: float) -> CombinationSignals:
    """A swerve that grows with time."""
    wave = np.sin(0.004 * tick)
    return CombinationSignals(
        tick=tick,
        angles=np.zeros(2),
        speed=speed,
        steer=0.02 * wave,
        articulation=np.array([0.02 * wave]),
        yaw_rates=np.full(2, 0.05 * wave),
        lateral_acceleration=0.0,
    )


def commands(law: Any, speeds: FloatArray, seen: Any) -> FloatArray:
    """Commands (n, n_steered) while the speed runs through ``speeds`` [m/s]."""
    memory, angles = law.init(), []
    for k, speed in enumerate(speeds.tolist()):
        tick = 20 * k
        memory, command = law.step(memory, tick, seen(tick), signals(tick, speed))
        angles.append(command.angles)
    return np.array(angles)


def nothing(tick: int) -> None:
    """No estimate."""
    return


def test_at_speed_it_is_the_lqr() -> None:
    """The low-speed law has no part in it."""
    speeds = np.full(100, 24.0)
    combined = commands(Combined(TRAILER, combination=COMBINATION), speeds, nothing)
    np.testing.assert_array_equal(combined, commands(Lqr(TRAILER, combination=COMBINATION), speeds, nothing))


@pytest.mark.parametrize("low_speed", ["path_preview", "ct_at", "command_steer", "virtual_driver"])
def test_at_walking_pace_it_is_the_low_speed_law(low_speed: str) -> None:
    """The LQR is silent there; what the parts ask for, the whole does."""
    law = Combined(TRAILER, combination=COMBINATION, low_speed=low_speed)
    alone = {"path_preview": PathPreview(TRAILER)}.get(low_speed)
    combined = commands(law, np.full(100, 3.0), nothing)
    if alone is not None:
        np.testing.assert_array_equal(combined, commands(alone, np.full(100, 3.0), nothing))
    assert combined.any() == (low_speed in ("ct_at", "command_steer"))  # the others wait for an estimate


def test_speeding_up_and_slowing_down_is_seamless() -> None:
    """Through the band of speeds where hands change: within the rate limit, no step where the band begins or ends."""
    ramp = np.linspace(3.0, 16.0, 200)
    law = Combined(TRAILER, combination=COMBINATION, low_speed="command_steer")
    angles = commands(law, np.concatenate([ramp, ramp[::-1]]), nothing)
    steps = np.abs(np.diff(angles, axis=0)).max(axis=1)
    assert steps.max() < 0.9 * TRAILER.max_steer_rate * 20 * TICK  # a step would be caught by the rate limit, at it


def test_an_unknown_low_speed_law_is_refused() -> None:
    """With the nearest name."""
    with pytest.raises(ValueError, match=r"path_preveiw.*path_preview"):
        Combined(TRAILER, combination=COMBINATION, low_speed="path_preveiw")
