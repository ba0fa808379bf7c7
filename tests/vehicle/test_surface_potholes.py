"""Potholes: on the road, as many as asked for, and no deeper to a wheel than it fits in."""

from __future__ import annotations

import numpy as np
import pytest

from vehicle.surface import Potholes, Roughness, Surface, scattered_potholes

LINE = np.linspace([0.0, 7.0], [180.0, 247.0], 601)  # a straight road of 300 m, rising to the left at 4 in 3


def one(diameter: float, depth: float) -> Surface:
    """A smooth road with one pothole in the origin."""
    at = np.zeros(1)
    return Surface(
        friction=0.8, roughness=Roughness(potholes=Potholes(at, at, np.array([diameter]), np.array([depth])))
    )


def test_a_wheel_drops_to_the_bottom_of_a_wide_hole_and_not_at_all_beside_it() -> None:
    """A bell over the hole's width: its depth in the middle, 9/16 of it half way, nothing from the edge on."""
    surface = one(0.8, 0.06)
    assert surface.roughness_at([0.0, 0.2, 0.4, 0.0, 3.0], [0.0, 0.0, 0.0, -0.4, 1.0]) == pytest.approx(
        [-0.06, -0.06 * 9.0 / 16.0, 0.0, 0.0, 0.0]
    )


def test_a_wheel_spans_a_narrow_hole() -> None:
    """Over 0.4 m a wheel of 0.5 m radius sinks in by its own sagitta, d^2/8R = 40 mm, however deep the hole is."""
    assert one(0.4, 0.09).roughness_at(0.0, 0.0) == pytest.approx(-0.04)
    assert one(0.4, 0.03).roughness_at(0.0, 0.0) == pytest.approx(-0.03)


def test_scattered_potholes_lie_on_the_road_at_the_density_asked_for() -> None:
    """12 on 100 m of a road of 9 m width, wholly within its edges; the seed decides which."""
    holes = scattered_potholes(np.random.default_rng(1), LINE, 4.5, 12.0)
    assert len(holes) == 36
    along = 0.6 * holes.x + 0.8 * (holes.y - 7.0)
    across = 0.6 * (holes.y - 7.0) - 0.8 * holes.x
    assert np.all(np.abs(across) + 0.5 * holes.diameter <= 4.5 + 1e-9)  # rounding
    assert along.min() > 0.0
    assert along.max() < 300.0
    in_tracks = np.abs(np.abs(across) - 1.0) < 0.5
    assert 0.25 < in_tracks.mean() < 0.9  # half of them are meant to be, and some more happen to be
    again = scattered_potholes(np.random.default_rng(1), LINE, 4.5, 12.0)
    np.testing.assert_array_equal(holes.x, again.x)
    assert len(scattered_potholes(np.random.default_rng(1), LINE, 4.5, 0.0)) == 0


def test_potholes_answer_for_any_shape() -> None:
    """Shapes broadcast as they do for the rest of the surface."""
    surface = one(0.8, 0.06)
    depth = surface.roughness_at(np.zeros((3, 1)), np.array([0.0, 0.2]))
    assert depth.shape == (3, 2)
    assert surface.roughness_at(0.0, 0.0).shape == ()


@pytest.mark.parametrize(
    ("change", "named"), [({"diameter": 0.0}, "diameter = 0.0 m"), ({"depth": -0.1}, "depth = -0.1 m")]
)
def test_holes_without_a_size_are_refused(change: dict[str, float], named: str) -> None:
    """One line with name and value."""
    size = {"diameter": 0.5, "depth": 0.05} | change
    with pytest.raises(ValueError, match=named):
        one(**size)


def test_holes_need_all_four_numbers() -> None:
    """Arrays of different lengths belong to different holes."""
    with pytest.raises(ValueError, match="equally long"):
        Potholes(np.zeros(2), np.zeros(2), np.ones(1), np.ones(2))
