"""Supervision: a law's demands reach actuators that stand beside them, or do not answer."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from controllers.equations import settle
from controllers.trailer import Actuation, SteerCommand
from controllers.trailer_steering.actuators import Supervised, actuator_findings
from controllers.trailer_steering.kinematics import AxleGroup
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION, signals
from tests.trailers import TWO_OF_THREE as TRAILER
from vehicle.frames import FloatArray

PERIOD = 20  # [ticks]
SLOPE = math.radians(3.0)  # rate of the law's angles [rad/s]
OFFSET = math.radians(8.0)


class Ramp:
    """A law that turns both axles left, slowly, up to 9 deg, and keeps what it is told of them."""

    def init(self) -> Actuation | None:
        return None

    def actuated(self, memory: Actuation | None, actuation: Actuation) -> Actuation:
        return actuation

    def step(
        self, memory: Actuation | None, tick: int, off_tracking: OffTracking | None, read: CombinationSignals
    ) -> tuple[Actuation | None, SteerCommand]:
        return memory, SteerCommand(angles=np.full(2, wanted(tick)))


def wanted(tick: int) -> float:
    return SLOPE * min(tick * 1e-3, 3.0)


def driven(
    until: int, faulty: Callable[[int, FloatArray, FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray, Actuation]:
    """Angles and demands (n, 2) [rad] of all steps, and what the law was told last."""
    law, angles, course, demands = Supervised(Ramp(), TRAILER, COMBINATION), np.zeros(2), [], []
    memory = law.init()
    for tick in range(0, until, PERIOD):
        memory, command = law.step(memory, tick, None, signals(tick, angles=angles))
        course.append(angles)
        demands.append(command.angles)
        goal = faulty(tick, command.angles, angles)
        angles = settle(angles, goal, PERIOD * 1e-3, lag=TRAILER.actuator_lag, max_rate=TRAILER.max_steer_rate)
    assert memory.law is not None
    return np.array(course), np.array(demands), memory.law


def test_sound_actuators_get_the_laws_demands_to_the_bit() -> None:
    _, demands, told = driven(4000, lambda tick, demand, angles: demand)
    assert demands.tolist() == [[wanted(tick)] * 2 for tick in range(0, 4000, PERIOD)]
    assert told.able.all()
    assert told.goal.tolist() == demands[-2].tolist()


def test_an_offset_is_taken_off_the_demand() -> None:
    """Axles that stand 8 deg beside their demand come back to the angle that the law wants, within 0.1 deg."""
    angles, demands, told = driven(6000, lambda tick, demand, angles: demand + OFFSET * (tick >= 1000))
    assert angles[-1] == pytest.approx([wanted(6000)] * 2, abs=math.radians(0.1))
    assert demands[-1] == pytest.approx([wanted(6000) - OFFSET] * 2, abs=math.radians(0.1))
    assert told.goal == pytest.approx([wanted(6000)] * 2, abs=math.radians(0.1))


def test_an_offset_that_ends_leaves_the_laws_demands() -> None:
    angles, demands, _ = driven(6000, lambda tick, demand, angles: demand + OFFSET * (1000 <= tick < 4000))
    assert angles[-1] == pytest.approx([wanted(6000)] * 2, abs=math.radians(0.1))
    assert demands[-1].tolist() == [wanted(6000)] * 2


def test_the_other_axle_takes_over_a_part_of_what_a_stuck_one_lacks() -> None:
    """It steers further than the law wants, and never so far that the steer moment is more than the law's."""
    angles, demands, told = driven(4000, lambda tick, demand, angles: np.array([0.0, demand[1]]))
    axles, law = AxleGroup.of(TRAILER), np.full(2, wanted(4000))
    assert demands[-1, 1] > wanted(4000) + math.radians(1.0)
    assert axles.steer_moment(angles[-1]) < axles.steer_moment(law)
    assert told.able.tolist() == [False, True]
    assert told.goal[0] == angles[-1, 0]


def test_an_axle_that_answers_again_is_steered_at_once() -> None:
    """While it is stuck it gets the demand of the other one, at which it is soon seen to be sound."""
    angles, demands, told = driven(6000, lambda tick, demand, angles: np.where([tick < 4500, False], angles, demand))
    assert told.able.all()
    assert angles[-1] == pytest.approx([wanted(6000)] * 2, abs=math.radians(0.1))
    assert np.abs(np.diff(demands, axis=0)).max() <= TRAILER.max_steer_rate * PERIOD * 1e-3 + 1e-12


def test_a_law_without_any_axle_that_answers_keeps_its_demands() -> None:
    """Nothing can be taken over; what the law wants is sent, so that the axles go on when they answer."""
    _, demands, told = driven(4000, lambda tick, demand, angles: np.zeros(2))
    assert demands[-1].tolist() == [wanted(4000)] * 2
    assert not told.able.any()


def test_memories_of_other_laws_have_no_findings() -> None:
    assert actuator_findings(None) == ()
