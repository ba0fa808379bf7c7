"""A measured road: profile and roughness are together what was measured, along any line."""

from __future__ import annotations

import numpy as np
import pytest

from vehicle.frames import FloatArray
from vehicle.surface import PROFILE_WAVES, Beyond, MeasuredRoad, Roughness, Surface

RADIUS, START, STEP, SPREAD = 60.0, 30.0, 0.05, 0.05  # [m]
U, V = np.arange(0.0, 120.0, STEP), np.arange(-2.0, 2.001, 0.05)
STATIONS = np.arange(0.0, 200.0, 0.25)


def _places(station: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places on a left turn about (0, RADIUS)."""
    angle = station / RADIUS
    return (RADIUS - v) * np.sin(angle), RADIUS - (RADIUS - v) * np.cos(angle)


LINE = np.stack(_places(STATIONS, np.zeros_like(STATIONS)), axis=1)


def _road(heights: FloatArray, beyond: Beyond = "level") -> MeasuredRoad:
    return MeasuredRoad(LINE, heights, u_step=STEP, v=V, start=START, beyond=beyond, tyre_spread=SPREAD)


def _heights(road: MeasuredRoad, u: FloatArray, v: FloatArray) -> FloatArray:
    """Height of profile and roughness."""
    surface = Surface(friction=0.8, relief=road.relief, roughness=Roughness(measured=road))
    x, y = _places(START + u, v)
    return surface.height(x, y) + surface.roughness_at(x, y)


def _felt(wavelength: float) -> float:
    """Share of a wave that is left after the average by a tyre."""
    return float(np.exp(-0.5 * (2.0 * np.pi * SPREAD / wavelength) ** 2))


def test_profile_and_roughness_add_up_to_the_waves_that_were_measured() -> None:
    """Waves along and across on a banked slope round a bend."""
    along, across, slope, bank = 1.0, 0.8, 0.03, 0.01
    grid = 0.02 * np.sin(2.0 * np.pi * U / along)[:, None] + 0.005 * np.sin(2.0 * np.pi * V / across)
    road = _road(grid + slope * U[:, None] + bank * V)
    u, v = np.linspace(1.0, 118.0, 400), 1.6 * np.sin(np.arange(400.0))
    expected = (
        0.02 * _felt(along) * np.sin(2.0 * np.pi * u / along)
        + 0.005 * _felt(across) * np.sin(2.0 * np.pi * v / across)
        + slope * u
        + bank * v
    )
    error = _heights(road, u, v) - expected
    assert np.ptp(error) < 0.6e-3  # linear between nodes 0.05 m apart: STEP^2 / 8 * k^2 A = 0.2 mm


@pytest.mark.parametrize(("wavelength", "share"), [(PROFILE_WAVES, 0.5), (10.0, 0.0), (8.0 * PROFILE_WAVES, 1.0)])
def test_long_waves_are_the_profile(wavelength: float, share: float) -> None:
    """Half of a wave of the limiting length, none of a short one, all of a long one."""
    road = _road(np.tile(0.05 * np.sin(2.0 * np.pi * U / wavelength)[:, None], len(V)))
    middle = U[(U > 35.0) & (U < 85.0)]  # far from the ends, as long as the limiting wave
    x, y = _places(START + middle, np.zeros_like(middle))
    wave = np.sin(2.0 * np.pi * middle / wavelength)
    fit = np.polyfit(wave, road.relief.height(x, y), 1)[0]
    assert fit / 0.05 == pytest.approx(share, abs=0.02)


def test_the_road_is_level_before_and_after() -> None:
    """Roughness ends over 2 m; a slope's height remains."""
    road = _road(0.02 * np.sin(2.0 * np.pi * U)[:, None] * np.ones_like(V) + 0.02 * U[:, None])
    v = np.zeros(20)
    before = _heights(road, np.linspace(-29.0, -2.1, 20), v)
    assert np.abs(before).max() < 1e-4
    after = _heights(road, np.linspace(122.5, 160.0, 20), v)
    assert np.ptp(after) < 1e-3
    assert after[0] == pytest.approx(0.02 * U[-1], abs=0.02)  # the height of the wave where it was cut off


def test_mirrored_it_has_no_seams() -> None:
    """The same heights backwards after its end and before its start."""
    heights = np.random.default_rng(3).normal(0.0, 0.01, (len(U), len(V)))
    road, u, v = _road(heights, "mirrored"), np.linspace(0.5, 25.0, 100), np.linspace(-1.5, 1.5, 100)
    end = U[-1]
    inside = _heights(road, u, v)
    np.testing.assert_allclose(_heights(road, -u, v), inside, atol=2e-5)  # the line has chords
    np.testing.assert_allclose(_heights(road, end + u, v), _heights(road, end - u, v), atol=2e-5)
    near_end = _heights(road, end + np.linspace(-0.05, 0.05, 50), np.zeros(50))
    assert np.abs(np.diff(near_end)).max() < 1e-3


def test_beside_it_the_height_of_its_edge_goes_on() -> None:
    """A kerb of 0.1 m along the left edge."""
    road = _road(np.where(V > 1.7, 0.1, 0.0) * np.ones((len(U), 1)))
    middle, edge, beside = _heights(road, np.full(3, 60.0), np.array([0.0, 2.0, 4.0])).tolist()
    assert beside == pytest.approx(edge, abs=1e-6)
    assert edge - middle == pytest.approx(0.1, abs=1e-4)


def test_places_of_high_forms_are_found() -> None:
    """One bump of 0.05 m, and nothing else."""
    bump = 0.05 * np.exp(-0.5 * ((U - 40.0) / 0.15) ** 2)[:, None] * np.exp(-0.5 * (V / 0.3) ** 2)
    places = _road(bump).uneven_places(0.002, 2.5)
    x, y = _places(np.array([START + 40.0]), np.array([0.0]))
    away = np.hypot(places[:, 0] - x, places[:, 1] - y)
    assert len(places) > 100
    assert away.max() < 1.5
    assert away.min() < 0.1
    assert len(_road(0.01 * bump).uneven_places(0.002, 2.5)) == 0


def test_a_profile_too_steep_for_a_road_is_refused() -> None:
    with pytest.raises(ValueError, match=r"slope = 0\.3"):
        _road(np.tile(0.3 * U[:, None], len(V)))
