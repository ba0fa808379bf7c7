"""Friction from place to place: the right value on the right side, in the right pixel, on the right patch."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.frames import FloatArray
from vehicle.surface import FrictionImage, PatchedFriction, SplitFriction, Surface, circle, rectangle

positions = st.floats(-80.0, 80.0)
STRAIGHT = np.array([[0.0, 0.0], [20.0, 10.0]])


@given(positions, positions)
def test_a_split_is_told_by_the_side_of_the_line_even_beyond_its_ends(x: float, y: float) -> None:
    """The line goes on straight: left is where the cross product with its direction is positive."""
    surface = Surface(friction=SplitFriction(0.2, 0.8, STRAIGHT))
    off = 20.0 * y - 10.0 * x  # cross product, 22.4 times the distance
    if abs(off) > 1e-6:  # on the line itself either side is right
        assert surface.friction_at(x, y) == (0.2 if off > 0.0 else 0.8)


@given(st.floats(0.0, math.tau), st.floats(-8.0, 8.0))
def test_the_split_of_a_round_road_is_a_circle(angle: float, off: float) -> None:
    """Driven to the left, all inside is left: points 0.1 m apart leave R = 12 m by 0.1 mm, the polyline by 1 mm."""
    way = np.linspace(0.0, math.tau, 241)
    line = 12.0 * np.column_stack([np.cos(way), np.sin(way)])
    split = SplitFriction(0.2, 0.8, line)
    if abs(off) > 2e-3:
        x, y = (12.0 - off) * np.cos(angle), (12.0 - off) * np.sin(angle)
        assert split.at(np.array(x), np.array(y)) == (0.2 if off > 0.0 else 0.8)


def grid(surface: Surface) -> FloatArray:
    """Friction over 41 x 41 nodes 0.25 m apart about the origin."""
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 41), np.linspace(-5.0, 5.0, 41))
    return surface.friction_at(x, y)


def test_patches_cover_their_outlines_and_the_later_lies_on_top() -> None:
    """A turned rectangle and a circle over it, each against the inequality that defines it."""
    heading = math.radians(30.0)
    patches = [rectangle(1.0, 0.5, 4.0, 2.0, 0.3, heading=heading), circle(-0.5, 0.0, 1.6, 0.1)]
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 41), np.linspace(-5.0, 5.0, 41))
    along = (x - 1.0) * np.cos(heading) + (y - 0.5) * np.sin(heading)
    across = (y - 0.5) * np.cos(heading) - (x - 1.0) * np.sin(heading)
    expected = np.where((np.abs(along) <= 2.0) & (np.abs(across) <= 1.0), 0.3, 0.8)
    expected = np.where(np.hypot(x + 0.5, y) <= 1.6, 0.1, expected)
    np.testing.assert_array_equal(grid(Surface(friction=PatchedFriction(0.8, patches))), expected)


def test_a_soft_edge_passes_linearly_across_the_outline() -> None:
    """Half way on the outline itself, done half an edge's width to either side."""
    surface = Surface(friction=PatchedFriction(0.8, [circle(0.0, 0.0, 3.0, 0.2, edge=1.0)]))
    np.testing.assert_allclose(
        surface.friction_at([2.4, 2.5, 2.75, 3.0, 3.25, 3.5, 3.6], 0.0),
        [0.2, 0.2, 0.35, 0.5, 0.65, 0.8, 0.8],
        atol=1e-8,  # a sharp edge counts as 1 nm wide
    )


def test_an_image_lies_with_its_upper_edge_to_the_north() -> None:
    """Pixel centres have the pixel's value, half way between two the mean; outside of the image the rest counts."""
    values = np.array([[0.2, 0.4], [0.6, 0.8]])  # the first row is the northern one
    image = FrictionImage(values, cell=2.0, corner=(10.0, -4.0), outside=0.9)
    surface = Surface(friction=image)
    assert surface.friction_at([11.0, 13.0], [-1.0, -1.0]) == pytest.approx([0.2, 0.4])
    assert surface.friction_at([11.0, 13.0], [-3.0, -3.0]) == pytest.approx([0.6, 0.8])
    assert surface.friction_at(12.0, -2.0) == pytest.approx(0.5)
    assert surface.friction_at([10.0, 9.99, 14.01, 12.0], [-4.0, -4.0, -1.0, 0.01]) == pytest.approx(
        [0.6, 0.9, 0.9, 0.9]
    )


def test_maps_lie_on_top_of_one_another() -> None:
    surface = Surface(friction=PatchedFriction(SplitFriction(0.5, 0.8, STRAIGHT), [circle(0.0, 3.0, 1.0, 0.1)]))
    np.testing.assert_array_equal(surface.friction_at([0.0, 0.0, 0.0], [3.0, 5.0, -3.0]), [0.1, 0.5, 0.8])
    assert not surface.is_uniform
    assert Surface(friction=0.8).is_uniform


@pytest.mark.parametrize(
    "friction",
    [
        0.4,
        SplitFriction(0.2, 0.8, STRAIGHT),
        PatchedFriction(0.8, [circle(0.0, 0.0, 1.0, 0.1)]),
        FrictionImage(np.full((3, 3), 0.4), cell=1.0, corner=(0.0, 0.0), outside=0.8),
    ],
)
def test_every_map_answers_for_any_shape(friction: float | SplitFriction | PatchedFriction | FrictionImage) -> None:
    """One wheel, all wheels of one vehicle, or those of a batch, and the same for each of them, in any process."""
    surface = Surface(friction=friction)
    x, y = np.linspace(-2.0, 4.0, 6).reshape(2, 3, 1), np.linspace(-3.0, 3.0, 4)
    all_at_once = surface.friction_at(x, y)
    assert all_at_once.shape == (2, 3, 4)
    assert all_at_once[1, 2, 3] == surface.friction_at(float(x[1, 2, 0]), float(y[3]))
    assert surface.friction_at(0.0, 0.0).shape == ()
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(surface)).friction_at(x, y), all_at_once)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: SplitFriction(0.0, 0.8, STRAIGHT), "left = 0.0"),
        (lambda: SplitFriction(0.8, 2.0, STRAIGHT), "right = 2.0"),
        (lambda: SplitFriction(0.8, 0.2, np.zeros((3, 2))), "line"),
        (lambda: circle(0.0, 0.0, 0.0, 0.2), "radius = 0.0 m"),
        (lambda: circle(0.0, 0.0, 1.0, 0.01), "friction = 0.01"),
        (lambda: circle(0.0, 0.0, 1.0, 0.2, edge=-1.0), "edge = -1.0 m"),
        (lambda: rectangle(0.0, 0.0, 1.0, -1.0, 0.2), "width = -1.0 m"),
        (lambda: PatchedFriction(9.0, []), "base = 9.0"),
        (lambda: FrictionImage(np.full((2, 2), 0.01), cell=1.0, corner=(0.0, 0.0), outside=0.8), "lowest of values"),
        (lambda: FrictionImage(np.full((2, 2), 0.5), cell=0.0, corner=(0.0, 0.0), outside=0.8), "cell = 0.0 m"),
        (lambda: FrictionImage(np.full((2, 2), 0.5), cell=1.0, corner=(0.0, 0.0), outside=3.0), "outside = 3.0"),
    ],
)
def test_impossible_friction_is_refused_by_name(make: object, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        make()  # type: ignore[operator]  # lambdas of different types
