"""Slip angles from a laser tracker and the compass, as the field tests of Reina et al. (2008) had their truth."""

import math

import numpy as np
import pytest

from estimators.slip.rover_odometry import LaserSlip
from sensors.messages import LaserFix


def test_direction_of_travel_less_heading_is_the_slip() -> None:
    """Eqs (5) and (6) on a straight way at 12 degrees with a heading of 4: exact, since the way is straight."""
    source = LaserSlip()
    memory, found = source.init(), None
    for k in range(30):
        way = 0.016 * k
        at = np.array([way * math.cos(0.2094395), way * math.sin(0.2094395), 0.0])
        memory, found = source.step(memory, LaserFix(tick=200 * k, p_WR=at), math.radians(4.0))
    assert found == pytest.approx(math.radians(8.0), abs=1e-6)


def test_a_way_too_short_has_no_direction() -> None:
    """Two fixes 16 mm apart at 3 mm of noise say nothing; neither does standing still."""
    source = LaserSlip()
    memory = source.init()
    for k in range(30):
        memory, found = source.step(memory, LaserFix(tick=200 * k, p_WR=np.array([0.0, 0.0, 0.0])), 0.0)
        assert found is None


def test_its_slip_is_that_of_half_its_span_ago() -> None:
    """A heading that turns steadily with the way on a circle: body slip zero throughout, whatever the delay.

    The chord's direction is the tangent's at its middle, and the mean heading that of the middle: 1e-3 rad of the
    fit's curvature remain.
    """
    source, rate, speed = LaserSlip(), 0.05, 0.08
    memory, found = source.init(), None
    for k in range(40):
        psi = rate * 0.2 * k
        at = speed / rate * np.array([math.sin(psi), 1.0 - math.cos(psi), 0.0])
        memory, found = source.step(memory, LaserFix(tick=200 * k, p_WR=at), psi)
    assert found == pytest.approx(0.0, abs=1e-3)
