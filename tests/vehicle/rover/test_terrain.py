"""Ground that a rover drives on."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.vehicle.rovers import slope_towards
from vehicle.frames import FloatArray
from vehicle.rover.terrain import FirmPatch, HeightMap, Mound, Terrain, load_height_map

MOUND = Mound(x=1.0, y=-0.5, height=0.4, radius=1.5)


def grid(height: float) -> HeightMap:
    """A mound as a map of its heights, 5 m x 4 m."""
    x, y = np.meshgrid(np.arange(-1.5, 3.51, 0.05), np.arange(-2.5, 1.51, 0.05))
    mound = Mound(x=1.0, y=-0.5, height=height, radius=1.5)
    return HeightMap(heights=Terrain(mounds=(mound,)).height(x, y), spacing=0.05, x=-1.5, y=-2.5)


TERRAINS = {
    "slope": Terrain(slope_x=0.1, slope_y=-0.05),
    "mounds": Terrain(slope_y=0.08, mounds=(MOUND, Mound(x=0.0, y=0.3, height=-0.2, radius=0.8))),
    "height map": Terrain(slope_x=0.05, height_map=grid(0.4)),
}


def places() -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(2)
    return rng.uniform(-1.0, 2.5, (20, 3)), rng.uniform(-2.0, 1.0, (20, 3))


@pytest.mark.parametrize("terrain", TERRAINS.values(), ids=TERRAINS.keys())
def test_gradient_is_the_slope_of_the_height(terrain: Terrain) -> None:
    """Central differences over 20 micrometres: exact to the third derivative and to rounding, 1e-9."""
    (x, y), d = places(), 1e-5
    along = (terrain.height(x + d, y) - terrain.height(x - d, y)) / (2 * d)
    across = (terrain.height(x, y + d) - terrain.height(x, y - d)) / (2 * d)
    assert terrain.gradient(x, y) == pytest.approx(np.stack([along, across], axis=-1), abs=1e-8)


def test_a_slope_rises_by_its_angle_in_its_direction() -> None:
    """One metre in the direction of 0.5 rad rises by the tangent of the angle; across it the ground is level."""
    slope_x, slope_y = slope_towards(0.5, math.radians(5.0))
    terrain = Terrain(slope_x=slope_x, slope_y=slope_y)
    assert float(terrain.height(math.cos(0.5), math.sin(0.5))) == pytest.approx(math.tan(math.radians(5.0)))
    assert float(terrain.height(-math.sin(0.5), math.cos(0.5))) == pytest.approx(0.0, abs=1e-15)


def test_a_mound_has_its_height_and_ends_at_twice_its_radius() -> None:
    terrain = Terrain(mounds=(MOUND,))
    assert float(terrain.height(1.0, -0.5)) == pytest.approx(0.4)
    assert float(terrain.height(4.0, -0.5)) < 0.4 * 4e-4  # four standard deviations off: exp(-8)


def test_a_map_of_a_mound_is_the_mound() -> None:
    """Error of a bicubic spline: spacing to the fourth times the bell's fourth derivative, some 1e-6 m at 5 cm."""
    x, y = places()
    assert Terrain(height_map=grid(0.4)).height(x, y) == pytest.approx(Terrain(mounds=(MOUND,)).height(x, y), abs=1e-5)


def test_beyond_a_map_the_height_of_its_edge_continues() -> None:
    terrain = Terrain(height_map=grid(0.4))
    assert float(terrain.height(9.0, 0.0)) == float(terrain.height(3.5, 0.0))
    assert terrain.gradient(9.0, 0.0)[0] == 0.0


def test_a_height_map_is_read_from_text_and_from_an_array(tmp_path: Path) -> None:
    heights = np.arange(20.0).reshape(4, 5) ** 2 / 100.0
    np.savetxt(tmp_path / "heights.csv", heights, delimiter=",")
    np.save(tmp_path / "heights.npy", heights)
    for name in ("heights.csv", "heights.npy"):
        assert load_height_map(str(tmp_path / name), 0.5).heights == pytest.approx(heights)
    with pytest.raises(ValueError, match=r"none\.npy: cannot be read"):
        load_height_map(str(tmp_path / "none.npy"), 0.5)


def test_patches_are_firm_ground() -> None:
    terrain = Terrain(firm=(FirmPatch(x=1.0, y=0.0, radius=0.5), FirmPatch(x=3.0, y=0.0, radius=0.2)))
    assert terrain.is_firm([0.0, 1.4, 3.1, 3.3], 0.0).tolist() == [0.0, 1.0, 1.0, 0.0]
    assert not terrain.is_uniform


@pytest.mark.parametrize(
    ("build", "complaint"),
    [
        (lambda: Terrain(slope_x=1.5), "slope_x = 1.5"),
        (lambda: Terrain(friction=0.0), "friction = 0.0"),
        (lambda: Mound(x=0.0, y=0.0, height=1.0, radius=0.0), "radius = 0.0 m of a mound"),
        (lambda: FirmPatch(x=0.0, y=0.0, radius=-1.0), "radius = -1.0 m of a firm patch"),
        (lambda: HeightMap(heights=np.zeros((3, 9)), spacing=1.0), "at least 4 x 4"),
        (lambda: HeightMap(heights=np.full((4, 4), np.nan), spacing=1.0), "finite"),
        (lambda: HeightMap(heights=np.zeros((4, 4)), spacing=0.0), "spacing = 0.0 m"),
    ],
)
def test_impossible_ground_is_refused(build: object, complaint: str) -> None:
    assert callable(build)
    with pytest.raises(ValueError, match=complaint):
        build()
