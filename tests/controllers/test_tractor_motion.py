"""Motion of a tractor's rear axle from wheel speed, steer angle and yaw rate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from controllers.trailer import Combination
from controllers.trailer_steering.kinematics import TractorMotion
from tests.trailers import COMBINATION, signals
from vehicle.combination.description import load_vehicle

TRACTOR = COMBINATION.vehicle.units[0]


@pytest.mark.parametrize("steer", [0.0, 0.35, -0.6])
@pytest.mark.parametrize("slip", [0.0, -0.02])
@pytest.mark.parametrize("speed", [2.8, -1.0])
def test_the_speed_does_not_depend_on_how_the_front_wheels_slip(steer: float, slip: float, speed: float) -> None:
    """A wheel that is steered by more than the direction of its travel rolls slower: the yaw rate shows by how much."""
    for front_slip in (0.0, 0.05):
        travel = steer - math.copysign(front_slip, steer)
        yaw_rate = speed * (math.tan(travel) - slip) / TRACTOR.steered_axles[0].x
        rolling = speed * math.cos(steer) + speed * math.tan(travel) * math.sin(steer)
        read = signals(0, speed=rolling * math.cos(steer), steer=steer, yaw_rates=np.array([yaw_rate, 0.0]))
        assert TractorMotion(COMBINATION).speed(read, slip) == pytest.approx(speed, abs=1e-12)


def test_a_steered_trailer_ahead_rolls_instead_of_scrubbing() -> None:
    """Seen from the second trailer the first one's angles are unknown: straight ones would push the tractor by 13 mrad.

    From the first trailer, whose angles are read, the slip is within 2 mrad of that.
    """
    vehicle = load_vehicle("b_double_steered")
    lead, second = vehicle.units[1:3]
    gammas, rates, speed = np.array([0.36, 0.05]), np.array([0.22, 0.22, 0.2]), 2.8
    v_y = rates[0] * vehicle.units[0].rear_hitch[0]
    c, s = math.cos(gammas[0]), math.sin(gammas[0])
    v_x, v_y = c * speed - s * v_y, s * speed + c * v_y
    rolling = np.array([math.atan((v_y + axle.x * rates[1]) / v_x) for axle in lead.axles if axle.steered])
    read = replace(signals(0), speed=speed, articulation=gammas, yaw_rates=rates)
    known = TractorMotion(Combination(vehicle, 1)).slip(replace(read, angles=rolling))
    straight = TractorMotion(Combination(vehicle, 1)).slip(replace(read, angles=np.zeros(len(rolling))))
    assumed = TractorMotion(Combination(vehicle, 2)).slip(
        replace(read, angles=np.zeros(sum(axle.steered for axle in second.axles)))
    )
    assert abs(straight - known) > 0.005
    assert assumed == pytest.approx(known, abs=0.002)
