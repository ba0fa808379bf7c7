"""Steered trailer axles backwards: straight, at the actuators' pace, and the law starts anew afterwards."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.trailer import SteerCommand
from controllers.trailer_steering.actuators import ReverseLock, ReverseLockMemory
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from tests.trailers import TWO_OF_THREE as TRAILER
from tests.trailers import signals
from vehicle.frames import FloatArray

RATE = TRAILER.max_steer_rate
HELD = math.radians(10.0)


class Counting:
    """Steers by a fixed angle, and counts its steps."""

    def init(self) -> int:
        return 0

    def step(
        self, memory: int, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[int, SteerCommand]:
        return memory + 1, SteerCommand(angles=np.full(2, HELD))


def stepped(speeds: list[float]) -> tuple[ReverseLockMemory, FloatArray]:
    """Last memory, and the angles at every step of 20 ms, (n, 2)."""
    law, angles = ReverseLock(Counting(), TRAILER), []
    memory = law.init()
    for k, speed in enumerate(speeds):
        memory, command = law.step(memory, 20 * k, None, signals(20 * k, speed=speed))
        angles.append(command.angles)
    return memory, np.array(angles)


def test_forwards_and_standing_the_law_is_heard() -> None:
    """Noise of wheel speeds at a standstill, and a stopped combination that rocks, are no way back."""
    memory, angles = stepped([2.0] * 5 + [0.0, 0.02, -0.02, -0.1] * 5)
    assert memory.law == 25
    np.testing.assert_array_equal(angles, HELD)


def test_backwards_the_wheels_straighten_at_the_actuators_rate() -> None:
    _, angles = stepped([1.0] * 3 + [-1.0] * 40)
    steps = -np.diff(angles[:, 0])
    assert steps.max() == pytest.approx(0.02 * RATE)
    np.testing.assert_allclose(angles[-1], 0.0, atol=1e-12)
    assert (np.diff(angles[2:, 0]) <= 0.0).all()


def test_forward_again_the_law_starts_anew() -> None:
    memory, angles = stepped([1.0] * 10 + [-1.0] * 50 + [0.0] * 10 + [1.0] * 4)
    assert memory.law == 4
    np.testing.assert_allclose(angles[-5], 0.0, atol=1e-12)  # while it stands: locked still
    np.testing.assert_array_equal(angles[-1], HELD)
