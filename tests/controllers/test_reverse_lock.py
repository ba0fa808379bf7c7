"""Steered trailer axles backwards: straight, at the actuators' pace, and the law starts anew afterwards."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.trailer import SteerCommand, TrailerGeometry
from controllers.trailer_steering.reverse_lock import ReverseLock, ReverseLockMemory
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.frames import FloatArray

RATE = math.radians(20.0)
TRAILER = TrailerGeometry(
    follow_distance=14.0,
    axle_distances=(8.0, 9.31, 10.62),
    steered=(False, True, True),
    max_steer=math.radians(30.0),
    max_steer_rate=RATE,
    actuator_lag=0.15,
)
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
        signals = CombinationSignals(
            tick=20 * k, angles=np.zeros(2), speed=speed, steer=0.0, articulation=np.zeros(1), yaw_rates=np.zeros(2),
            lateral_acceleration=0.0,
        )  # fmt: skip
        memory, command = law.step(memory, 20 * k, None, signals)
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
