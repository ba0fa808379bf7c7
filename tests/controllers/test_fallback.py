"""Steering without an estimate: by dead reckoning, by command steer where the sensors contradict each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.trailer_steering.fallback import Fallback
from controllers.trailer_steering.signal_laws import CommandSteer
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION, signals
from tests.trailers import TWO_OF_THREE as TRAILER
from vehicle.clock import TICK
from vehicle.frames import FloatArray

STUCK_AT = 4000  # [ticks]


def turning(tick: int, articulation: float | None = None) -> CombinationSignals:
    """A turn that begins after 2 s and grows smoothly; the articulation changes by the difference of the yaw rates."""
    since = max(0.0, tick * TICK - 2.0)
    gamma = 0.15 * (1.0 - math.cos(0.6 * since)) if articulation is None else articulation
    rates = [0.15 * 0.6 * math.sin(0.6 * since), 0.0]
    return signals(tick, speed=2.8, articulation=np.array([gamma]), yaw_rates=np.array(rates))


def steered(stuck: bool) -> tuple[FloatArray, FloatArray]:
    """Angles of dead reckoning and of command steer at the end of 7 s, the last five of them in the turn."""
    fallback, alone = (
        Fallback(TRAILER, combination=COMBINATION, name=name) for name in ("dead_reckoning", "command_steer")
    )
    memory, last = fallback.init(), np.zeros(2)
    for tick in range(0, 7000, 20):
        read = turning(tick, 0.1 if stuck and tick >= STUCK_AT else None)
        memory = fallback.observed(memory, tick, None, read)
        memory, last = fallback.steered(memory, tick, read, last)
    return last, alone.steered(alone.init(), 7000, read, last)[1]


@pytest.mark.parametrize("stuck", [False, True])
def test_sensors_that_contradict_each_other_leave_command_steer(stuck: bool) -> None:
    """An articulation that stays while two gyros differ by 3 deg/s: the path can not be reckoned, but steered by it."""
    reckoned, command_steer = steered(stuck)
    assert (np.abs(reckoned - command_steer).max() < 1e-6) == stuck


def test_command_steer_is_the_law_of_that_name() -> None:
    """At manoeuvring speed, and without its limit of rate, which the guard has."""
    fallback = Fallback(TRAILER, combination=COMBINATION, name="command_steer")
    law, read = CommandSteer(TRAILER, combination=COMBINATION), signals(0, speed=2.8, articulation=np.array([0.2]))
    memory = law.init()
    for tick in range(0, 3000, 20):
        memory, command = law.step(memory, tick, None, read)
    _, angles = fallback.steered(fallback.init(), 0, read, np.zeros(2))
    np.testing.assert_allclose(angles, command.angles, atol=1e-12)
