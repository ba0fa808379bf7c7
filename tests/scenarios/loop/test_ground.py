"""The ground that a scenario asks for: sides, images and patches, roughness and potholes, and what is refused."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyopencrg
import pytest
from PIL import Image

from scenarios.assembly.adapters import course_of, surface_of
from scenarios.assembly.trailer_run import measured_ground
from scenarios.courses import Course
from scenarios.loop.runner import run
from scenarios.options.scenario import Scenario, load_scenario, stream
from scenarios.results.trailer_result import friction_picture
from scenarios.roads import crg_file
from scenarios.roads.crg_file import read_crg
from scenarios.roads.path_file import read_path
from sensors.world.ground import Centreline, Landscape, ground_mesh
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray
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


# OpenCRG surfaces: read in every format, laid along the course, felt by the wheels and drawn for the cameras


U, V = np.arange(0.0, 20.001, 0.05), np.arange(-2.0, 2.001, 0.1)  # [m]
BUMP: Final = 0.06 * np.exp(-0.5 * ((U - 10.0) / 0.4) ** 2)[:, None] * np.ones_like(V)  # a rounded speed hump [m]


def crg_written(path: Path, heights: FloatArray = BUMP, kind: str = "LDFI", **keys: Any) -> Path:
    """Path of an OpenCRG file with these heights."""
    pyopencrg.CrgRoad(heights, u_inc=0.05, **{"v": V, **keys}).save(path, fmt=kind)
    return path


def scenario_on(path: Path, *settings: str) -> Scenario:
    return load_scenario("lane-change", (f"surface.crg={path}", "off_tracking=truth", *settings))


def laid(path: Path, *settings: str) -> tuple[Surface, Course]:
    scenario = scenario_on(path, *settings)
    course = course_of(scenario, load_vehicle(scenario.vehicle))
    measured, _ = measured_ground(scenario.surface, course)
    return surface_of(scenario, course, stream(1, "surface"), measured), course


@pytest.mark.parametrize("kind", ["LRFI", "LDFI", "KRBI", "KDBI"])
def test_all_formats_are_read(tmp_path: Path, kind: str) -> None:
    surface = read_crg(crg_written(tmp_path / "hump.crg", kind=kind))
    np.testing.assert_allclose(surface.heights, BUMP, atol=1e-6)
    np.testing.assert_allclose(surface.v, V, atol=1e-6)
    assert surface.length == pytest.approx(20.0)


def test_slope_banking_and_uneven_spacing_are_in_the_heights(tmp_path: Path) -> None:
    """A plane on positions across the road that lie closer in the wheel tracks."""
    v = np.array([-2.0, -1.5, -1.2, -1.0, 0.0, 1.0, 1.2, 1.5, 2.0])
    heights = np.tile(0.01 * v, (len(U), 1))
    surface = read_crg(crg_written(tmp_path / "plane.crg", heights, v=v, slope=0.03, banking=0.02))
    assert np.ptp(np.diff(surface.v)) < 1e-12
    expected = 0.03 * U[:, None] + (0.01 + 0.02) * surface.v
    np.testing.assert_allclose(surface.heights, expected, atol=1e-6)


def test_finer_heights_are_averaged_where_they_are(tmp_path: Path) -> None:
    """Blocks of 4 x 4 of a grid of 1 cm: heights of a slope with a wave are those of their middles."""
    u, v = np.arange(0.0, 4.0, 0.01), np.arange(-0.5, 0.501, 0.01)
    heights = 0.01 * np.sin(2.0 * u)[:, None] + 0.02 * v
    path = tmp_path / "fine.crg"
    pyopencrg.CrgRoad(heights, u_inc=0.01, v=v, slope=0.03).save(path, fmt="KDBI")
    surface = read_crg(path)
    assert surface.u_step == pytest.approx(0.04)
    assert surface.v[1] - surface.v[0] == pytest.approx(0.04)
    middles = surface.u_start + surface.u_step * np.arange(len(surface.heights))
    expected = (0.01 * np.sin(2.0 * middles) + 0.03 * middles)[:, None] + 0.02 * surface.v
    np.testing.assert_allclose(surface.heights, expected, atol=1e-5)
    assert surface.length == pytest.approx(3.99)


def test_missing_heights_are_filled_from_beside_and_told(tmp_path: Path) -> None:
    """A hole, and an edge that the scanner did not see."""
    heights = np.tile(0.01 * V, (len(U), 1))
    heights[100:120, 15:20], heights[200:210, :6] = np.nan, np.nan
    path = crg_written(tmp_path / "holes.crg", heights)
    surface = read_crg(path)
    np.testing.assert_allclose(surface.heights[100:120], np.tile(0.01 * V, (20, 1)), atol=1e-6)
    np.testing.assert_allclose(surface.heights[200:210, :6], 0.01 * V[6], atol=1e-6)
    scenario = scenario_on(path)
    _, (missing, narrow) = measured_ground(scenario.surface, course_of(scenario, load_vehicle(scenario.vehicle)))
    assert missing == "surface.crg: 0.97 % of its heights are missing: filled in from beside"
    assert narrow.startswith("surface.crg: reaches from -2.00 to +2.00 m across, the road from -4.50 to +4.50 m")


def test_it_begins_where_the_guided_point_starts(tmp_path: Path) -> None:
    path = crg_written(tmp_path / "hump.crg")
    for settings, begin in ((), 0.0), (("surface.crg_start=30",), 30.0):
        surface, course = laid(path, *settings)
        x = course.path.start.x + begin + np.arange(0.0, 20.0, 0.01)
        height = surface.height(x, 0.0 * x) + surface.roughness_at(x, 0.0 * x)
        assert x[np.argmax(height)] - course.path.start.x - begin == pytest.approx(10.0, abs=0.03)
        assert np.ptp(height) == pytest.approx(0.06, rel=0.03)  # a tyre spans little of it


def test_its_own_reference_line_is_a_course(tmp_path: Path) -> None:
    """A bend of 40 m radius as ``course.file`` and ``surface.crg``."""
    heading = U[:-1] / 40.0
    path = crg_written(tmp_path / "bend.crg", heading=heading)
    places = read_path(path).places
    middle = np.array([0.0, 40.0])
    np.testing.assert_allclose(np.linalg.norm(places - middle, axis=1), 40.0, atol=0.03)
    assert math.dist(places[0], places[1]) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_wheels_and_cameras_meet_the_same_hump(tmp_path: Path) -> None:
    """Half a hump lifts the wheels of one side; the drawn ground is as high as it, within 5 mm."""
    path = crg_written(tmp_path / "hump.crg", np.where(V > 0.0, BUMP, 0.0), "KRBI")
    passed = run(scenario_on(path, "course.exit=20", "speed_kmh=40"), 1)
    level = run(load_scenario("lane-change", ("off_tracking=truth", "course.exit=20", "speed_kmh=40")), 1)
    assert passed.outcome == "completed"
    for unit in "tractor", "semitrailer":
        by_hump = passed.log[f"roll_{unit}"] - level.log[f"roll_{unit}"]
        assert by_hump.max() > math.radians(0.3)  # to the right, + about the forward axis
        assert by_hump.max() > -1.5 * by_hump.min()
    surface, course = laid(path)
    low, high = course.centreline.min(axis=0), course.centreline.max(axis=0)
    landscape = Landscape(np.random.default_rng(0), surface, low, high)
    line = Centreline(course.centreline, course.road_half_width)
    mesh = ground_mesh(np.random.default_rng(0), landscape, line, low, high)
    x, y, z = mesh.vertices.T
    for side, height in ((1.0, 0.06), (-1.0, 0.0)):
        near = (np.abs(y - side) < 0.6) & (np.abs(x - course.path.start.x - 10.0) < 0.6)
        assert near.sum() > 30
        assert z[near].max() == pytest.approx(height, abs=0.005)


@pytest.mark.parametrize(
    "name", ["hump.crg", "../{}/hump.crg ! there", "* a remark\n../\n{}/hump.crg", "$$ROADS/hump.crg"]
)
def test_a_file_may_refer_to_another_one(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative to its own folder, in one line or several, or through a variable of the environment."""
    monkeypatch.setenv("ROADS", str(tmp_path))
    own = read_crg(crg_written(tmp_path / "hump.crg"))
    (tmp_path / "refers.crg").write_text(f"$CT\n$\n$ROAD_CRG_FILE\n{name.format(tmp_path.name)}\n$\n", encoding="utf-8")
    assert np.array_equal(read_crg(tmp_path / "refers.crg").heights, own.heights)
    mods = "$ROAD_CRG_MODS\nSCALE_Z_GRID = 2\n$\n"
    (tmp_path / "again.crg").write_text(f"$CT\n$\n{mods}$ROAD_CRG_FILE\nrefers.crg\n$\n", encoding="utf-8")
    assert read_crg(tmp_path / "again.crg").heights == pytest.approx(2.0 * own.heights, abs=1e-6)
    (tmp_path / "refers.crg").write_text("$ROAD_CRG_FILE\nagain.crg\n$\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"again.crg: more than 8 files refer to each other"):
        read_crg(tmp_path / "again.crg")


def test_a_coarse_file_is_connected_by_straight_lines(tmp_path: Path) -> None:
    """Heights and reference line every 20 m, in steps of a metre between; the length along the line is the file's."""
    heights = 0.1 * np.arange(12.0)[:, None] ** 2 * np.ones(len(V))
    pyopencrg.CrgRoad(heights, u_inc=20.0, v=V, heading=np.linspace(0.0, 0.5, 11)).save(
        tmp_path / "coarse.crg", fmt="LDFI"
    )
    surface = read_crg(tmp_path / "coarse.crg")
    assert (surface.length, surface.u_step, surface.line_step) == pytest.approx((220.0, 1.0, 1.0))
    assert surface.heights[20 * 7 + 5, 3] == pytest.approx(0.1 * (49.0 + 0.25 * 15.0))
    assert np.hypot(*np.diff(surface.line, axis=0).T) == pytest.approx(1.0)


def test_a_reference_line_needs_no_heights(tmp_path: Path) -> None:
    """Two long sections without a height, every 10 m; a surface of it is refused."""
    path = tmp_path / "line.crg"
    road = pyopencrg.CrgRoad(np.zeros((30, 2)), u_inc=10.0, v=np.array([-1.0, 1.0]), heading=np.linspace(0.3, 0.9, 29))
    road.z[:] = np.nan
    road.save(path, fmt="KRBI")
    places = read_path(path).places
    legs = np.diff(places, axis=0)
    assert np.hypot(*legs.T) == pytest.approx(10.0)
    assert np.ptp(np.arctan2(legs[:, 1], legs[:, 0])) == pytest.approx(0.6, abs=1e-6)
    with pytest.raises(ValueError, match="only NaN"):
        read_crg(path)


BAD: Final[dict[str, tuple[Callable[[Path], object], str]]] = {
    "empty": (lambda path: path.write_bytes(b""), "not a readable OpenCRG file"),
    "cut binary": (lambda path: _cut(path, "KRBI", -4000), "not a readable OpenCRG file"),
    "nothing": (lambda path: crg_written(path, np.full_like(BUMP, np.nan)), "not a readable OpenCRG file"),
    "missing": (lambda path: crg_written(path, np.where(V > -1.5, np.nan, BUMP)), "share of missing heights = 0.8"),
    "short": (lambda path: crg_written(path, BUMP[:10]), r"length = 0.45 m must be between 1 and 50000 m"),
    "narrow": (lambda path: crg_written(path, v=0.001 * V), "increment"),
    "coarse": (
        lambda path: pyopencrg.CrgRoad(BUMP[:50], u_inc=500.0, v=V).save(path),
        "spacing along the road = 500.0 m",
    ),
    "millimetres": (lambda path: crg_written(path, 1000.0 * BUMP), "m higher or lower than its mean profile"),
    "wall": (lambda path: crg_written(path, slope=0.4), "slope = 0.28"),  # of the profile, which ends 20 m on
    "elsewhere": (
        lambda path: path.write_bytes(b"$ROAD_CRG_FILE\nother.crg\n$$$$\n"),
        r"refers to another file \(\$ROAD_CRG_FILE\): .*other.crg: cannot be read",
    ),
}


def _cut(path: Path, kind: str, end: int) -> None:
    crg_written(path, kind=kind)
    path.write_bytes(path.read_bytes()[:end])


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    write, wanted = BAD[case]
    path = tmp_path / "bad.crg"
    write(path)
    with pytest.raises(ValueError, match=r"^surface\.crg = [^\n]{1,500}$") as refusal:
        laid(path)
    assert "bad.crg" in str(refusal.value)
    assert refusal.match(wanted)


def test_a_file_too_large_is_refused_before_its_heights_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crg_file, "_MOST_HEIGHTS", 1000)
    with pytest.raises(ValueError, match="has 16441 heights: must be at most 1000"):
        read_crg(crg_written(tmp_path / "hump.crg"))


def test_without_the_package_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"need the extra 'roads': pip install 'offtrack\[roads\]'"):
        read_crg(tmp_path / "hump.crg")
