"""The ground: slopes are the derivative of height, bodies stand along its normal; along a road, and as measured."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.frames import FloatArray
from vehicle.surface import PROFILE_WAVES, Beyond, MeasuredRoad, RoadRelief, Roughness, Surface

slopes = st.floats(-0.2, 0.2)
positions = st.floats(-50.0, 50.0)
surfaces = st.builds(
    Surface, friction=st.just(0.8), cross_fall=slopes, grade=slopes, centre=st.none() | st.tuples(positions, positions)
)


@given(surfaces, positions, positions)
def test_the_gradient_is_the_derivative_of_the_height(surface: Surface, x: float, y: float) -> None:
    h = 1e-4
    along_x = (surface.height(x + h, y) - surface.height(x - h, y)) / (2 * h)
    along_y = (surface.height(x, y + h) - surface.height(x, y - h)) / (2 * h)
    # curvature of the rounded tip / 6 * h^2 and rounding of 20 m / h
    np.testing.assert_allclose(surface.gradient(x, y), [along_x, along_y], atol=1e-9)


@given(surfaces, positions, positions, st.floats(-7.0, 7.0))
def test_a_body_stands_on_its_two_supports_with_its_heading(surface: Surface, x: float, y: float, psi: float) -> None:
    """Both supports touch the ground, the x axis runs towards psi as seen from above."""
    supports = (1.0, -8.0)
    X_WB = surface.pose_on(x, y, psi, supports)
    assert math.remainder(math.atan2(X_WB[1, 0], X_WB[0, 0]) - psi, math.tau) == pytest.approx(0.0, abs=1e-12)
    for support in supports:
        along = support / math.hypot(X_WB[0, 0], X_WB[1, 0])  # the slope is longer than it looks from above
        p = X_WB @ [along, 0.0, 0.0, 1.0]
        assert p[2] == pytest.approx(float(surface.height(p[0], p[1])), abs=1e-9)


@given(slopes, slopes, st.floats(-7.0, 7.0))
def test_on_a_plane_a_body_stands_along_the_normal(cross_fall: float, grade: float, psi: float) -> None:
    surface = Surface(friction=0.8, cross_fall=cross_fall, grade=grade)
    X_WB = surface.pose_on(3.0, -2.0, psi, (0.0, -9.3))
    slope_x, slope_y = surface.gradient(3.0, -2.0)
    normal = np.array([-slope_x, -slope_y, 1.0]) / math.sqrt(1.0 + slope_x**2 + slope_y**2)
    np.testing.assert_allclose(X_WB[:3, 2], normal, atol=1e-12)
    np.testing.assert_allclose(X_WB[:3, 3], [3.0, -2.0, float(surface.height(3.0, -2.0))], atol=1e-12)


def test_a_plane_falls_to_the_right_and_a_cone_away_from_its_centre() -> None:
    """Cross-fall has the sense a road builder gives it."""
    plane = Surface(friction=0.8, cross_fall=0.025)
    assert plane.height(0.0, -4.0) == pytest.approx(-0.1)
    cone = Surface(friction=0.8, cross_fall=0.025, centre=(10.0, 5.0))
    assert cone.height(60.0, 5.0) < cone.height(30.0, 5.0) < cone.height(10.0, 5.0)
    assert cone.gradient(60.0, 5.0) == pytest.approx((-0.025, 0.0), abs=1e-4)  # tip rounded: (3 m / 50 m)^2 / 2


@pytest.mark.parametrize("wrong", [{"friction": 0.0}, {"friction": 2.0}, {"cross_fall": 2.5}, {"grade": -0.3}])
def test_impossible_ground_is_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Surface(**({"friction": 0.8} | wrong))  # type: ignore[arg-type]  # any of the fields, by name


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
    line = np.stack([S, 5.0 * np.sin(S / 15.0)], axis=1)
    relief = RoadRelief(line, 0.5 * np.sin(S / 12.0), 0.05 * np.cos(S / 20.0), reach=12.0)
    surface = Surface(friction=0.8, reliefs=(relief,), cross_fall=0.01, grade=0.02)
    x, y = np.random.default_rng(1).uniform([[5.0], [-4.0]], [[90.0], [4.0]], (2, 40))
    step = 1e-3
    along = (surface.height(x + step, y) - surface.height(x - step, y)) / (2.0 * step)
    across = (surface.height(x, y + step) - surface.height(x, y - step)) / (2.0 * step)
    assert surface.gradient(x, y) == pytest.approx(np.stack([along, across], axis=1), abs=2e-3)  # curvature per point
    assert not surface.is_plane


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
    surface = Surface(friction=0.8, reliefs=(road.relief,), roughness=Roughness(measured=road))
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
