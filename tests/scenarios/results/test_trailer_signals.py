"""Signals of a trailer run, in a steady circle of closed form."""

import numpy as np
import pytest

import offtrack
from vehicle.combination.description import load_vehicle


@pytest.mark.slow
def test_signals_of_a_steady_circle_have_their_closed_forms() -> None:
    """Acceleration v r, its moment over weight times half the track within the roll, and friction v^2 / (R mu g)."""
    settings = {"speed_kmh": 25.0, "course.radius": 40.0, "course.turn_deg": 200.0, "trailer_steering": "none"}
    settings |= {"vehicle": "eu_tractor_semitrailer", "off_tracking": "truth"}
    circle, vehicle = offtrack.run("roundabout", settings=settings), load_vehicle("eu_tractor_semitrailer")
    np.testing.assert_allclose(circle["articulation_1"], circle["psi_tractor"] - circle["psi_semitrailer"], atol=1e-12)
    now = {name: circle[name][int(0.7 * len(circle.log))] for name in circle.log.names}
    assert "steer_tractor" in circle.log
    for unit in vehicle.units:
        expected = now[f"v_x_{unit.name}"] * now[f"yaw_rate_{unit.name}"]
        assert now[f"lateral_acceleration_{unit.name}"] == pytest.approx(expected, abs=0.02)
    assert now["lateral_acceleration_tractor"] == pytest.approx((25 / 3.6) ** 2 / 38.0, rel=0.05)
    moment = sum(u.mass * u.cg_height * now[f"lateral_acceleration_{u.name}"] for u in vehicle.units)
    track = np.mean([axle.track for unit in vehicle.units for axle in unit.axles])
    measured = np.mean([now[f"load_transfer_{unit.name}"] for unit in vehicle.units])  # a left turn loads the right
    assert measured == pytest.approx(moment / (0.5 * track * vehicle.mass * 9.81), rel=0.25)
    of_axles = [value for name, value in now.items() if name.startswith("friction_used_") and name[-1].isdigit()]
    assert len(of_axles) == 5
    assert max(of_axles) <= now["friction_used_max"]
    needed = now["lateral_acceleration_tractor"] / (0.8 * 9.81)
    assert now["friction_used_tractor_1"] == pytest.approx(needed, rel=0.35)
