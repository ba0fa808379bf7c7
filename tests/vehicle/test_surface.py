"""The ground: slopes are the derivative of height, bodies stand along its normal."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.surface import Surface

slopes = st.floats(-0.2, 0.2)
positions = st.floats(-50.0, 50.0)
surfaces = st.builds(
    Surface,
    friction=st.just(0.8),
    cross_fall=slopes,
    grade=slopes,
    centre=st.none() | st.tuples(positions, positions),
)


@given(surfaces, positions, positions)
def test_the_gradient_is_the_derivative_of_the_height(surface: Surface, x: float, y: float) -> None:
    """Central differences of the height, on the plane and on the cone alike."""
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
    """With any supports: z axis normal to the ground, origin on it."""
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


def test_friction_has_the_common_shape_of_the_positions() -> None:
    """One coefficient everywhere, for any number of wheels."""
    surface = Surface(friction=0.3)
    np.testing.assert_array_equal(surface.friction_at(np.zeros((4, 1)), np.zeros(3)), np.full((4, 3), 0.3))


@pytest.mark.parametrize("wrong", [{"friction": 0.0}, {"friction": 2.0}, {"cross_fall": 2.5}, {"grade": -0.3}])
def test_impossible_ground_is_refused_by_name(wrong: dict[str, float]) -> None:
    """A cross-fall of 2.5 is per cent mistaken for a slope."""
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Surface(**({"friction": 0.8} | wrong))  # type: ignore[arg-type]  # any of the fields, by name
