"""The ground that a scenario asks for: sides, images and patches, roughness and potholes, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenarios.assembly.adapters import course_of, surface_of
from scenarios.options.scenario import Scenario, load_scenario, stream
from scenarios.results.trailer_result import friction_picture
from vehicle.combination.description import load_vehicle
from vehicle.surface import Surface

PATCHES = """
[[surface.patches]]
kind = "circle"
x = 20.0
y = 0.0
radius = 2.0
friction = 0.15

[[surface.patches]]
kind = "rectangle"
x = 20.0
y = 1.0
length = 4.0
width = 1.0
heading_deg = 90.0
friction = 0.3
edge = 0.5
"""


def surface(*settings: str, seed: int = 0, scenario: str = "roundabout") -> Surface:
    loaded = load_scenario(scenario, settings)
    return surface_of(loaded, course_of(loaded, load_vehicle(loaded.vehicle)), stream(seed, "surface"))


def written(tmp_path: Path, text: str) -> str:
    """Path of a roundabout's scenario file with that text at its end."""
    path = tmp_path / "own.toml"
    path.write_text('name = "own"\n[course]\nkind = "roundabout"\n' + text, encoding="utf-8")
    return str(path)


def test_ground_is_uniform_and_smooth_unless_asked_otherwise() -> None:
    assert surface("surface.friction=0.4").friction == 0.4
    assert surface().is_uniform
    assert surface().is_smooth


def test_one_side_of_the_road_may_be_named_alone() -> None:
    """The roundabout starts along +x and turns left: y > 0 is the left lane, and so is the circle's middle."""
    ground = surface("surface.friction_left=0.2")
    np.testing.assert_array_equal(ground.friction_at([-10.0, -10.0, 35.0], [1.0, -1.0, 11.0]), [0.2, 0.8, 0.2])
    ground = surface("surface.friction_right=0.3", "surface.friction=0.6")
    np.testing.assert_array_equal(ground.friction_at([-10.0, -10.0], [1.0, -1.0]), [0.6, 0.3])


def test_patches_come_from_tables(tmp_path: Path) -> None:
    ground = surface(scenario=written(tmp_path, PATCHES))
    assert ground.friction_at(18.5, 0.0) == pytest.approx(0.15)
    assert ground.friction_at(20.0, 2.5) == pytest.approx(0.3)
    assert ground.friction_at(20.0, 3.0) == pytest.approx(0.5 * (0.3 + 0.8))  # on the rectangle's far side
    assert ground.friction_at(23.0, 0.0) == pytest.approx(0.8)


def test_grey_values_of_an_image_are_frictions(tmp_path: Path) -> None:
    """Black is 0.1 and white 0.8 unless told otherwise; scale and corner place the image."""
    path = tmp_path / "ice.png"
    Image.fromarray(np.array([[0, 255], [51, 102]], dtype=np.uint8)).save(path)
    keys = (f"surface.friction_image={path}", "surface.friction_image_scale=2.0", "surface.friction_image_x=-2.0")
    ground = surface(*keys)
    expected = [0.1, 0.8, 0.1 + 0.7 * 0.2, 0.1 + 0.7 * 0.4]
    np.testing.assert_allclose(ground.friction_at([-1.0, 1.0, -1.0, 1.0], [3.0, 3.0, 1.0, 1.0]), expected)
    bright = surface(*keys, "surface.friction_image_white=1.2", "surface.friction=0.6")
    np.testing.assert_allclose(bright.friction_at([1.0, 9.0], [3.0, 3.0]), [1.2, 0.6])


def test_the_seed_decides_roughness_and_potholes() -> None:
    """The same seed gives the same road, and the same waves and holes whether there are the others or not."""
    keys = ("surface.roughness=C", "surface.potholes=20")
    x = np.linspace(0.0, 60.0, 200)
    one, same, other = surface(*keys), surface(*keys), surface(*keys, seed=1)
    np.testing.assert_array_equal(one.roughness_at(x, 0.0), same.roughness_at(x, 0.0))
    assert not np.array_equal(one.roughness_at(x, 0.0), other.roughness_at(x, 0.0))
    whole = surface("surface.roughness=C")
    assert one.roughness is not None
    np.testing.assert_array_equal(one.roughness.waves(x, 0.0 * x), whole.roughness_at(x, 0.0))
    holed = surface("surface.potholes=20")
    assert holed.roughness is not None
    assert holed.roughness.potholes is not None
    assert one.roughness.potholes is not None
    np.testing.assert_array_equal(one.roughness.potholes.x, holed.roughness.potholes.x)
    assert holed.roughness_at(x, np.linspace(-4.0, 4.0, 50)[:, None]).min() < -0.02


def test_a_resolved_scenario_runs_again_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    settings = ("surface.friction_left=0.2", "surface.roughness=B", "surface.friction_image=ice.png")
    scenario: Scenario = load_scenario(written(tmp_path, PATCHES), settings)
    assert scenario.surface.friction_image == str(tmp_path / "ice.png")
    again = tmp_path / "again.toml"
    again.write_text(scenario.to_toml(), encoding="utf-8")
    assert load_scenario(str(again)) == scenario


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("radius = 2.0", "radus = 2.0"), "unknown key 'surface.patches.0.radus'; did you mean"),
        (("heading_deg", "heding_deg"), "unknown key 'surface.patches.1.heding_deg'; did you mean"),
        (("friction = 0.15", "friction = 0.01"), "surface.patches.0.friction = 0.01 must be between 0.05 and 1.5"),
        (("length = 4.0", "length = 0.0"), "surface.patches.1.length = 0.0 m must be between 0.1 and"),
        (('kind = "circle"', 'kind = "cirle"'), "surface.patches.0.kind = 'cirle'; did you mean 'circle'"),
        (('kind = "circle"\n', ""), "key 'surface.patches.0.kind' is missing"),
    ],
)
def test_a_wrong_patch_is_refused_in_one_line(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=r"surface\.patches") as refused:
        load_scenario(written(tmp_path, PATCHES.replace(*change)))
    assert message in str(refused.value)


def test_an_image_that_is_none_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^surface.friction_image = .*nothing.png is missing$"):
        surface(f"surface.friction_image={tmp_path / 'nothing.png'}")
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(ValueError, match=r"^surface.friction_image = .*text.png is corrupt or not an image"):
        surface(f"surface.friction_image={tmp_path / 'text.png'}")


def test_the_plan_view_shows_where_it_is_slippery() -> None:
    """Friction on a grid around the road: both values of two sides, in their places; nothing for one friction."""
    ground = surface("surface.friction_right=0.3")
    road = np.array([[0.0, 0.0], [40.0, 0.0]])
    picture = friction_picture(ground, road)
    assert picture is not None
    rows, columns = picture.values.shape
    np.testing.assert_allclose(picture.high - picture.low, np.array([columns, rows]) * 0.1, rtol=0.01)
    assert set(np.unique(picture.values)) == {0.3, 0.8}
    assert picture.values[0, : columns // 3].max() == 0.3  # right of the road's middle
    straight = columns // 3  # of the road, before it bends
    assert picture.values[rows // 2 + 2, :straight].min() == 0.8
    assert friction_picture(surface(), road) is None
    assert friction_picture(surface("surface.friction_right=0.8"), road) is None
