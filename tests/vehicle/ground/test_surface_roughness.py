"""Rough roads: as uneven as their class of ISO 8608, alike in every direction, the same from a seed; and potholes."""

import math
import pickle
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import csd
from scipy.special import k1

from vehicle.frames import FloatArray
from vehicle.surface import (
    FrictionImage,
    FrictionPatch,
    PatchedFriction,
    Potholes,
    Roughness,
    RoughProfile,
    SplitFriction,
    Surface,
    displacement_psd,
    scattered_potholes,
)
from vehicle.surface.ground import PATCH_SPREAD

STEP = 0.1  # of the tracks that are looked at [m]
SEGMENT = 1024  # of Welch's method: 0.01 cycles/m apart, as fine as the tile itself


def tracks(road_class: str, *, apart: float = 0.0, count: int = 60) -> FloatArray:
    """Heights (count, 4096) along tracks of 410 m in all directions on three roads, ``apart`` to their left."""
    profiles = [RoughProfile(np.random.default_rng(seed), road_class) for seed in range(3)]
    along = STEP * np.arange(4 * SEGMENT)
    heading = 2.39996 * np.arange(count)  # golden angle: directions spread evenly
    start = np.random.default_rng(9).uniform(-200.0, 200.0, (count, 2))
    c, s = np.cos(heading), np.sin(heading)
    return np.array(
        [
            profiles[i % 3].height(start[i, 0] + c[i] * along - s[i] * apart, start[i, 1] + s[i] * along + c[i] * apart)
            for i in range(count)
        ]
    )


def spectrum(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Spatial frequencies [cycles/m] and the real part of the tracks' mean one-sided cross density [m3]."""
    n, density = csd(one, other, fs=1.0 / STEP, window="hann", nperseg=SEGMENT, detrend=False, axis=-1)
    return n, np.real(density.mean(axis=0))


def band_means(n: FloatArray, ratio: FloatArray, edges: FloatArray) -> FloatArray:
    return np.array([ratio[(n >= low) & (n < high)].mean() for low, high in pairwise(edges)])


@pytest.mark.parametrize("road_class", ["A", "C", "E"])
def test_a_track_has_the_density_of_its_class(road_class: str) -> None:
    """Gd(n0) (n/n0)^-2 over waves of 40 m to 0.3 m, less what a tyre of 0.2 m contact length averages out.

    Classes lie a factor of 4 apart: up to 1.5 cycles/m even the averaged road is within the bounds of its class.
    """
    heights = tracks(road_class)
    n, density = spectrum(heights, heights)
    edges = 0.025 * 2.0 ** np.arange(0.0, 7.1, 0.5)  # half octaves up to 3.2 cycles/m
    felt = displacement_psd(road_class, n[1:]) * np.exp(-((2.0 * np.pi * PATCH_SPREAD * n[1:]) ** 2))
    ratio = band_means(n[1:], density[1:] / felt, edges)
    # [-] the lowest bands hold but 1 to 4 waves of each of 3 roads; the highest one what interpolation mirrors into it
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    within = (n > 0.02) & (n < 1.5)
    smooth = np.convolve(density[within] / displacement_psd(road_class, n[within]), np.full(9, 1 / 9), mode="valid")
    assert smooth.min() > 0.5
    assert smooth.max() < 2.0


def test_the_classes_double_in_height() -> None:
    """ISO 8608: Gd(n0) = 16e-6 m3 in class A and four times as much from each class to the next."""
    n0 = np.array([0.1])
    assert displacement_psd("A", n0) == pytest.approx(16e-6)
    assert displacement_psd("D", n0) == pytest.approx(1024e-6)
    assert displacement_psd("H", n0) == pytest.approx(262144e-6)
    assert displacement_psd("C", 2 * n0) == pytest.approx(256e-6 / 4.0)


def test_left_and_right_wheels_are_lifted_together_by_long_waves_only() -> None:
    """Tracks 2 m apart: the cross density of an isotropic road, X K1(X) with X = 2 pi n d."""
    left, right = tracks("C", apart=2.0), tracks("C")
    n, cross = spectrum(left, right)
    _, own = spectrum(right, right)
    edges = np.array([0.02, 0.04, 0.08, 0.16, 0.32, 0.64])
    measured = band_means(n, cross / own, edges)
    X = 2.0 * np.pi * n[1:] * 2.0
    expected = band_means(n, np.append(1.0, X * k1(X)), edges)
    np.testing.assert_allclose(measured, expected, atol=0.08)  # 4 standard deviations of a mean over 60 tracks
    assert expected[0] > 0.8
    assert expected[-1] < 0.05


def test_a_road_has_no_seam() -> None:
    """From one millimetre to the next no step, on a way that leaves the tile on two of its sides."""
    height = RoughProfile(np.random.default_rng(0), "C").height(np.arange(0.0, 260.0, 1e-3), np.array(0.0))
    slope = np.diff(height) / 1e-3
    assert np.abs(slope).max() < 7.0 * slope.std()  # a normal distribution's largest of 2600 nodes is 4 of them


def test_no_straight_road_repeats_itself() -> None:
    """The waves of 1 km of road resemble no shifted copy of them."""
    profile = RoughProfile(np.random.default_rng(0), "C")
    x = np.arange(0.0, 1000.0, 0.1)
    height = profile.height(x, np.zeros_like(x))
    rough = height - np.convolve(height, np.full(101, 1 / 101), mode="same")  # waves below 10 m: they tell places apart
    padded = np.abs(np.fft.rfft(rough, 2 * len(rough))) ** 2
    correlation = np.fft.irfft(padded)[: len(x)] / np.sum(rough**2)
    assert correlation[0] == pytest.approx(1.0)
    assert np.abs(correlation[300:]).max() < 0.25  # a tile crossed straight would give 0.9 at 102.4 m


def test_the_seed_decides_the_road() -> None:
    """The same generator draws the same road to the last bit, and it survives a journey to another process."""
    x = np.linspace(-30.0, 200.0, 50)
    one, same, other = (RoughProfile(np.random.default_rng(seed), "B") for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.height(x, 0.3 * x), same.height(x, 0.3 * x))
    np.testing.assert_array_equal(one.height(x, 0.3 * x), pickle.loads(pickle.dumps(one)).height(x, 0.3 * x))
    assert not np.array_equal(one.height(x, 0.3 * x), other.height(x, 0.3 * x))


LINE = np.linspace([0.0, 7.0], [180.0, 247.0], 601)  # a straight road of 300 m, rising to the left at 4 in 3


def one(diameter: float, depth: float) -> Surface:
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


# Friction: split, patched, from an image, and one on another


def circle(x: float, y: float, radius: float, friction: float, edge: float = 0.0) -> FrictionPatch:
    return FrictionPatch(x=x, y=y, rounding=radius, friction=friction, edge=edge)


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
    patches = [
        FrictionPatch(x=1.0, y=0.5, heading=heading, half_length=2.0, half_width=1.0, friction=0.3),
        circle(-0.5, 0.0, 1.6, 0.1),
    ]
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
