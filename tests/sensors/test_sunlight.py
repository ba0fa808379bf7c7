"""Position and light of the sun, and their effect on the rendered world."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from sensors.world.sky import HIGHEST, LOWEST, daylight, panorama
from sensors.world.world import World


@pytest.mark.parametrize(
    ("compass", "towards"), [(0.0, (0.0, 1.0)), (90.0, (1.0, 0.0)), (180.0, (0.0, -1.0)), (270.0, (-1.0, 0.0))]
)
def test_azimuth_is_read_as_on_a_compass(compass: float, towards: tuple[float, float]) -> None:
    light = daylight(1.0, azimuth=math.radians(compass), elevation=math.radians(30.0))
    np.testing.assert_allclose(light.direction[:2] / math.cos(math.radians(30.0)), towards, atol=1e-12)
    assert light.direction[2] == pytest.approx(0.5)


def test_a_low_sun_is_dim_and_red() -> None:
    """Its light has come through more air, which takes most from the blue."""
    noon, evening = (daylight(0.0, elevation=math.radians(degrees)) for degrees in (43.0, 8.0))
    kept = np.array(evening.sun_colour) / np.array(noon.sun_colour)
    assert 1.0 > kept[0] > kept[1] > kept[2] > 0.0
    assert kept[2] < 0.5


def test_clouds_leave_no_sun() -> None:
    """Light comes from everywhere, and more of it than from a clear sky."""
    light = daylight(0.0, overcast=True)
    assert light.sun_colour == (0.0, 0.0, 0.0)
    assert min(light.sky_colour) > max(daylight(0.0).sky_colour)


@pytest.mark.parametrize("degrees", [2.9, 90.1, -10.0, math.nan])
def test_a_sun_below_the_hills_is_refused(degrees: float) -> None:
    with pytest.raises(ValueError, match="must be between 3 and 90"):
        daylight(0.0, elevation=math.radians(degrees))


@pytest.mark.slow
def test_the_sun_is_drawn_where_it_stands() -> None:
    """The brightest place of the panorama, whose columns go round from W's x, its rows down from the highest."""
    light = daylight(0.0, azimuth=math.radians(200.0), elevation=math.radians(20.0))
    sky = panorama(np.random.default_rng(0), light)
    plain = panorama(np.random.default_rng(0), daylight(0.0))
    rows, columns = sky.shape[:2]
    column = round((90.0 - 200.0) % 360.0 / 360.0 * columns)
    row = round((HIGHEST - math.radians(20.0)) / (HIGHEST - LOWEST) * (rows - 1))
    assert sky[row, column].min() > 230
    assert sky[row, column].astype(int).sum() >= plain[row, column].sum()
    opposite = (column + columns // 2) % columns
    assert sky[row, opposite].mean() < plain[row, opposite].mean() + 1.0


@pytest.mark.slow
def test_shadows_are_long_in_the_evening(world: World, built_in: Callable[..., World]) -> None:
    """At 10 degrees they are five and a half times as long as things are high: much more of the land lies in them.

    At the usual 43 degrees they are as long as things are high.
    """
    evening = built_in(sun_elevation=math.radians(10.0)).road.light
    assert (evening < 0.5).mean() > 2.5 * (world.road.light < 0.5).mean()
