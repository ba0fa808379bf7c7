"""Metrics of the standard manoeuvres on logs whose answers are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offtrack.studies.standards.proving_ground import amplification, damping, lateral_acceleration, overshoot
from scenarios.results.log import Log, Signal
from vehicle.frames import FloatArray

TIME: FloatArray = np.arange(0.0, 12.0, 0.02)


def circling(speed: float, yaw_rate: float, slide: float) -> Log:
    """The log of a unit in a steady turn whose frame's origin slides sideways at ``slide`` [m/s]."""
    constants = {"v_x_unit": speed, "v_y_unit": slide, "yaw_rate_unit": yaw_rate}
    signals = tuple(Signal(name, "-", name) for name in ("time", *constants))
    return Log(signals, np.column_stack([TIME, *(np.full(len(TIME), value) for value in constants.values())]))


def test_a_steady_turn_has_the_acceleration_of_its_circle() -> None:
    """Whatever slides steadily: speed times yaw rate, at every place along the unit."""
    log = circling(10.0, 0.2, -0.3)
    for x in (-5.0, 0.0, 3.0):
        np.testing.assert_allclose(lateral_acceleration(log, "unit", x), 2.0, rtol=1e-12)


def test_a_yawing_unit_accelerates_its_ends_sideways() -> None:
    """a_y = x d(r)/dt + v r with r = sin t: 20 ms differences of a sine are off by (0.02)^2 / 6, a 15 000th."""
    log = circling(0.0, 0.0, 0.0)
    rows = log.rows.copy()
    rows[:, 3] = np.sin(TIME)
    yawing = Log(log.signals, rows)
    inner = slice(1, -1)  # one-sided differences at both ends
    np.testing.assert_allclose(lateral_acceleration(yawing, "unit", 3.0)[inner], 3.0 * np.cos(TIME)[inner], atol=3e-4)


@pytest.mark.parametrize("ratio", [0.05, 0.15, 0.35, 0.6])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_damping_of_a_decaying_oscillation_is_its_ratio(ratio: float, phase: float) -> None:
    """exp(-D w t) cos(w sqrt(1 - D^2) t): 20 ms samples cut a peak at 4 rad/s by 0.1 % at most, the ratio by less."""
    w = 4.0
    values = np.exp(-ratio * w * TIME) * np.cos(w * math.sqrt(1.0 - ratio**2) * TIME + phase)
    assert damping(values) == pytest.approx(ratio, abs=2e-3)


def test_what_does_not_swing_is_critically_damped() -> None:
    """A decay without a change of sign has no extremes to compare; nor has one whose swing is below a thousandth."""
    assert damping(np.exp(-TIME)) == 1.0
    assert damping(np.exp(-TIME) + 1e-5 * np.exp(-TIME) * np.cos(4.0 * TIME) - 1e-5) == 1.0


def test_damping_of_a_growing_oscillation_is_negative() -> None:
    """An unstable combination must not look damped."""
    assert damping(np.exp(0.2 * TIME) * np.sin(2.0 * TIME)) < 0.0


def test_amplification_compares_the_largest_magnitudes() -> None:
    """Each in its own time, of either sign."""
    assert amplification(np.array([0.0, 1.0, -3.0]), np.array([2.0, -1.0, 0.0])) == pytest.approx(1.5)


def test_overshoot_is_what_the_last_axle_needs_beyond_the_first_ones_path() -> None:
    """Cutting in does not count, a bulge to the outside does; both paths are compared at the same place."""
    x = np.arange(0.0, 50.0, 0.5)
    ahead = np.column_stack([x, np.where(x > 20.0, 1.5, 0.0)])
    bulge = np.where((x > 30.0) & (x < 35.0), 0.3, 0.0)
    behind = np.column_stack([x + 0.25, ahead[:, 1] + bulge - np.where(x < 10.0, 1.0, 0.0)])
    assert overshoot(behind, ahead) == pytest.approx(0.3)
    assert overshoot(ahead, ahead) == 0.0
