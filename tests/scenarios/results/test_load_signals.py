"""Signals of lateral acceleration, load transfer, articulation and friction, in a steady circle of closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

import offtrack
from vehicle.combination.description import load_vehicle


@pytest.fixture(scope="module")
def circle() -> offtrack.Run:
    settings = {
        "vehicle": "eu_tractor_semitrailer",
        "speed_kmh": 25.0,
        "trailer_steering": "none",
        "off_tracking": "truth",
        "course.radius": 40.0,
        "course.turn_deg": 200.0,
    }
    return offtrack.run("roundabout", settings=settings)


@pytest.mark.slow
def test_acceleration_of_a_steady_circle_is_that_of_the_centre_of_gravity(circle: offtrack.Run) -> None:
    """v^2 / R of the point, along the unit's own y axis."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    row = int(0.7 * len(circle.log))
    for unit in vehicle.units:
        yaw_rate = circle[f"yaw_rate_{unit.name}"][row]
        expected = circle[f"v_x_{unit.name}"][row] * yaw_rate
        assert circle[f"lateral_acceleration_{unit.name}"][row] == pytest.approx(expected, abs=0.02)
    assert circle["lateral_acceleration_tractor"][row] == pytest.approx((25 / 3.6) ** 2 / 38.0, rel=0.05)


def test_load_transfer_balances_the_moment_of_the_whole_combination(circle: offtrack.Run) -> None:
    """Sum of lateral force times height, over weight times half the track: within the roll of the bodies."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    row = int(0.7 * len(circle.log))
    moment = sum(u.mass * u.cg_height * circle[f"lateral_acceleration_{u.name}"][row] for u in vehicle.units)
    track = np.mean([axle.track for unit in vehicle.units for axle in unit.axles])
    expected = moment / (0.5 * track * vehicle.mass * 9.81)
    measured = np.mean([circle[f"load_transfer_{unit.name}"][row] for unit in vehicle.units])
    assert measured == pytest.approx(expected, rel=0.25)
    assert measured > 0.0  # a left turn loads the right side


def test_articulation_is_the_difference_of_yaws(circle: offtrack.Run) -> None:
    np.testing.assert_allclose(circle["articulation_1"], circle["psi_tractor"] - circle["psi_semitrailer"], atol=1e-12)


def test_friction_of_an_axle_lies_between_those_of_its_wheels(circle: offtrack.Run) -> None:
    """At v^2 / R = 1.27 m/s2 on friction 0.8 the steer axle needs about 1.27 / (0.8 g)."""
    row = int(0.7 * len(circle.log))
    names = [name for name in circle.log.names if name.startswith("friction_used_") and name[-1].isdigit()]
    assert len(names) == 5
    assert max(circle[name][row] for name in names) <= circle["friction_used_max"][row]
    needed = circle["lateral_acceleration_tractor"][row] / (0.8 * 9.81)
    assert circle["friction_used_tractor_1"][row] == pytest.approx(needed, rel=0.35)
    assert math.isfinite(circle["friction_used_tractor_2"][row])
