"""The ground along a road: planes and cones as closed forms, and the gradient as the height's difference quotient."""

from __future__ import annotations

import numpy as np
import pytest

from vehicle.surface import RoadRelief, Surface

S = np.arange(0.0, 100.0, 0.25)


def test_a_straight_road_with_grade_and_bank_is_a_plane() -> None:
    line = np.stack([S, 0.0 * S], axis=1)
    relief = RoadRelief(line, 0.05 * S, np.full(len(S), -0.03), reach=12.0)
    x, y = np.array([20.1, 50.0, 70.3]), np.array([3.0, -4.0, 11.0])
    assert relief.height(x, y) == pytest.approx(0.05 * x - 0.03 * y, abs=1e-9)
    assert relief.gradient(x, y) == pytest.approx(np.tile([0.05, -0.03], (3, 1)), abs=1e-9)


def test_a_banked_circle_is_a_cone() -> None:
    """A bend of 30 m to the left that rises to its inside by 4 %: the ground falls outwards from the centre."""
    radius, angles = 30.0, np.arange(0.0, 5.0, 0.005)
    line = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    relief = RoadRelief(line, np.zeros(len(line)), np.full(len(line), 0.04), reach=15.0)
    cone = Surface(friction=0.8, cross_fall=0.04, centre=(0.0, 0.0))
    x, y = np.array([24.0, -20.0, -3.0]), np.array([5.0, 27.0, 29.123])
    assert relief.height(x, y) == pytest.approx(0.04 * (radius - np.hypot(x, y)), abs=1e-4)  # points 15 cm apart
    assert relief.gradient(x, y) == pytest.approx(cone.gradient(x, y), abs=4e-4)  # the cone's tip is rounded


def test_the_gradient_is_the_difference_quotient_of_the_height() -> None:
    """A winding, rolling road whose bank changes."""
    line = np.stack([S, 5.0 * np.sin(S / 15.0)], axis=1)
    relief = RoadRelief(line, 0.5 * np.sin(S / 12.0), 0.05 * np.cos(S / 20.0), reach=12.0)
    surface = Surface(friction=0.8, relief=relief, cross_fall=0.01, grade=0.02)
    x, y = np.random.default_rng(1).uniform([[5.0], [-4.0]], [[90.0], [4.0]], (2, 40))
    step = 1e-3
    along = (surface.height(x + step, y) - surface.height(x - step, y)) / (2.0 * step)
    across = (surface.height(x, y + step) - surface.height(x, y - step)) / (2.0 * step)
    assert surface.gradient(x, y) == pytest.approx(np.stack([along, across], axis=1), abs=2e-3)  # curvature per point
    assert not surface.is_plane


def test_a_road_steeper_than_a_surface_may_be_is_refused() -> None:
    line = np.stack([S, 0.0 * S], axis=1)
    with pytest.raises(ValueError, match=r"slope = 0\.300 at .* must be within 0\.2"):
        RoadRelief(line, 0.3 * S, 0.0 * S, reach=10.0)
