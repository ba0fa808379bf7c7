"""Slow ramps up to rolling over: what counts as a fall, and how a combination swings before."""

from __future__ import annotations

import numpy as np
import pytest

from offtrack.studies.standards.static_rollover import TiltTable, falls
from vehicle.combination.description import load_vehicle
from vehicle.combination.layout import State, slices, state_sizes
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import Pose2

SECONDS = np.arange(17.0)  # of a hold


@pytest.mark.parametrize("phase", [0.0, 1.5, 3.0, 4.5, 6.0])
def test_a_swing_that_decays_stands_whatever_its_phase(phase: float) -> None:
    """On few axles a combination swings once in ten seconds, weakly damped; at the end it may lean over ever faster."""
    leans = 0.07 + 0.01 * np.exp(-0.03 * SECONDS) * np.sin(2.0 * np.pi * SECONDS / 10.0 + phase)
    assert not falls(leans)


def test_a_lean_that_creeps_to_its_place_stands() -> None:
    """It passes every earlier peak, but ever slower."""
    assert not falls(0.07 - 0.01 * np.exp(-SECONDS / 8.0))


def test_a_slow_fall_is_one() -> None:
    """Out of an unstable equilibrium: 0.02 rad in the hold, far below what lies on its side."""
    assert falls(0.07 + 1e-3 * np.exp(SECONDS / 5.0))


def test_a_swing_on_lifted_axles_decays() -> None:
    """The trailer's axles have lifted and the tractor alone resists: what is left of the dampers takes energy out.

    A damper that pushed while its axle is off the ground kept a swing of 0.5 deg going for good.
    """
    vehicle = load_vehicle("us_5_axle")
    below, beyond = (Plant(vehicle, TiltTable(friction=1.5, cross_fall=slope)) for slope in (0.39, 0.41))
    idle, roll = VehicleCommand(0.0, 0.0, ()), State(*slices(state_sizes(vehicle))).roll
    state = below.step(below.initial_state(Pose2(0.0, 0.0, 0.0), 0.0), idle, 10_000)  # the first wheel lifts at 0.399
    trailer: list[float] = []
    for _ in range(120):
        state = beyond.step(state, idle, 500)
        trailer.append(float(state[roll][1]))
    first, last = (np.ptp(trailer[k : k + 40]) for k in (0, 80))  # 20 s: two swings
    assert abs(trailer[-1]) > np.radians(3.4)  # beyond the angle at which the first wheel lifts
    assert last < 0.5 * first
