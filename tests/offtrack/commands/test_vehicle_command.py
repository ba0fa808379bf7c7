"""`offtrack vehicle` as a user meets it, and the sheet it draws."""

import json
import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import typer
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from PIL import Image
from typer.testing import CliRunner, Result

from offtrack.commands.assess import vehicle
from offtrack.reports.vehicle_sheet import rover_sheet as rover_views
from offtrack.reports.vehicle_sheet.combination_sheet import open_sheet
from offtrack.reports.vehicle_sheet.combination_views import CombinationDrawing, plan_view, side_view
from offtrack.reports.vehicle_sheet.sheet import Scale, save_sheet
from vehicle.combination.data_sheet import data_sheet, handling_at
from vehicle.combination.description import load_vehicle, vehicle_names
from vehicle.rover.data_sheet import rover_sheet
from vehicle.rover.description import load_rover, load_soil, rover_names, soil_names
from vehicle.rover.plant import settled_sinkage

PARAMETERS = Path(__file__).parents[3] / "vehicle" / "parameters"
app = typer.Typer()
app.command()(vehicle)


@pytest.fixture
def offtrack_vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory on a wide terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    return tmp_path


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def test_without_a_name_all_vehicles_are_listed(offtrack_vehicle: Path) -> None:
    listed = run().stdout
    summaries = {name: load_vehicle(name).summary for name in vehicle_names()}
    summaries |= {name: load_rover(name).summary for name in rover_names()}
    for name, summary in summaries.items():
        assert f"{name} " in listed
        assert summary in listed
    assert json.loads(run("--json").stdout) == summaries


@pytest.mark.slow
def test_a_vehicle_is_shown_and_drawn(offtrack_vehicle: Path) -> None:
    """Loads as published, reach and handling, where the numbers come from, and where the sheet lies."""
    done = run("openpbs_tractor_semitrailer_6x2")
    assert done.exit_code == 0
    for words in ("7.32", "14.47", "42.94 t", "understeer gradient", "critical speed", "yaw damping", "±42.0°"):
        assert words in done.stdout
    assert "load [t]" in done.stdout  # brackets are no markup
    assert "numbers of the file state their source" in done.stdout
    sheet = offtrack_vehicle / "runs" / "vehicle-openpbs_tractor_semitrailer_6x2-1"
    assert {path.name for path in sheet.iterdir()} == {"sheet.svg", "sheet.png", "facts.json"}
    assert str(sheet.relative_to(offtrack_vehicle)) in done.stdout


@pytest.mark.slow
def test_json_is_the_data_sheet_and_nothing_else(offtrack_vehicle: Path) -> None:
    done = run("b_double", "--json", "--out", "sheet")
    numbers = json.loads(done.stdout)
    assert numbers == json.loads((offtrack_vehicle / "sheet" / "facts.json").read_text(encoding="utf-8"))
    steer, drive, _ = (axle["load_kg"] for axle in numbers["units"][0]["axles"])
    assert (steer, drive) == pytest.approx((5664.0, 7714.0), abs=1.0)  # [kg], lengths in the file are to micrometres
    handling = handling_at(load_vehicle("b_double"))
    assert numbers["handling"]["yaw_damping"] == handling.yaw_damping
    assert numbers["handling"]["critical_speed_kmh"] is None
    assert numbers["sources"]["stated"] > numbers["sources"]["assumed"] > 0


def test_a_vehicle_that_does_not_stand_is_drawn_with_a_warning(offtrack_vehicle: Path) -> None:
    """Its sheet is what shows the mistake: here a centre of gravity ahead of the front axle."""
    text = (PARAMETERS / "rigid_truck.toml").read_text(encoding="utf-8")
    (offtrack_vehicle / "mine.toml").write_text(text.replace("cg_x = { value = 2.185", "cg_x = { value = 6.0", 1))
    done = run("mine.toml")
    assert done.exit_code == 0
    assert "Warning: units.0.axles.1 (truck): carries -9.3 kN" in done.stdout
    assert "no handling figures" in done.stdout
    assert (offtrack_vehicle / "runs" / "vehicle-mine-1" / "sheet.svg").exists()


def side_of(name: str) -> Figure:
    """The side view alone, on axes with equal scales."""
    figure = Figure()
    chosen = load_vehicle(name)
    side_view(figure.add_subplot(aspect="equal"), CombinationDrawing(chosen, data_sheet(chosen), Scale(0.4)))
    return figure


def centre_of(circle: Circle) -> tuple[float, float]:
    x, y = np.asarray(circle.get_center()).tolist()
    return x, y


def test_wheels_stand_where_the_file_says_and_lifted_ones_hang() -> None:
    """Stations of the axles behind the front and their radius above the ground, in metres of the drawing."""
    (ax,) = side_of("eu_6x2_tractor_semitrailer").axes
    tyres = [p for p in ax.patches if isinstance(p, Circle) and p.get_radius() == 0.5]
    heights = {round(x, 6): z for x, z in map(centre_of, tyres)}
    assert sorted(heights) == [1.3, 5.0, 6.37, 10.84, 12.15, 13.46]
    assert [heights[x] for x in (1.3, 5.0, 12.15, 13.46)] == [0.5] * 4
    assert heights[6.37] > 0.5 < heights[10.84]


def test_the_side_view_says_every_load_and_length() -> None:
    """Axle loads, groups, kingpins and the chains of dimensions are lettered on it."""
    (ax,) = side_of("b_double").axes
    said = [text.get_text() for text in ax.texts]
    assert {"5.66", "7.71", "6.48", "6.40", "15.43 t", "19.44 t", "19.19 t", "11.64 t", "10.43 t"} <= set(said)
    assert {"3.25", "5.88", "8.30", "12.40", "25.73", "4.30"} <= set(said)
    assert "semitrailer, 29.62 t" in said


def wheel_angles(name: str) -> dict[tuple[float, bool], float]:
    """Angle to the left [deg] of every filled wheel in the plan, by station and whether it is a left wheel."""
    figure = Figure()
    ax = figure.add_subplot()
    chosen = load_vehicle(name)
    plan_view(ax, CombinationDrawing(chosen, data_sheet(chosen), Scale(0.4)))
    found = {}
    for patch in ax.patches:
        if isinstance(patch, Polygon) and patch.get_fill():
            corners = patch.get_xy()[:-1]
            x, y = corners.mean(axis=0)
            long_side = max(np.diff(patch.get_xy(), axis=0), key=lambda side: math.hypot(*side))
            angle = (math.degrees(math.atan2(long_side[1], long_side[0])) + 90.0) % 180.0 - 90.0
            found[round(float(x), 6), bool(y < 0.0)] = angle  # the left side is below the middle
    return found


def test_the_plan_shows_a_left_turn_with_ackermann_and_opposite_trailer_axles() -> None:
    """Tractor wheels go left, the inner one further; trailer axles behind the turning point go right."""
    angles = wheel_angles("uk_longer_semitrailer")
    left, right = angles[1.4, True], angles[1.4, False]
    assert left > 42.0 > right > 0.0
    # the axes of both wheels of the tractor meet beside its rear axle, 3.80 m behind them
    assert 3.8 / math.tan(math.radians(right)) - 3.8 / math.tan(math.radians(left)) == pytest.approx(2.04)
    rear = [angle for (x, _), angle in angles.items() if x > 13.0]
    assert len(rear) == 4
    assert all(angle < 0.0 for angle in rear)
    assert angles[5.2, True] == angles[5.2, False] == 0.0  # the drive axle


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rigid_truck", "a_double", "wb67", "el_dorado_ii", "el_dorado_ii_skid"])
def test_the_sheet_is_to_scale_and_whole_and_the_same_each_time(name: str, tmp_path: Path) -> None:
    """Drawings can be compared and kept under version control."""
    sheet = open_sheet(name)
    svg, png = save_sheet(sheet.draw, tmp_path)
    before = svg.read_bytes()
    save_sheet(sheet.draw, tmp_path)
    assert svg.read_bytes() == before
    root = ElementTree.parse(svg).getroot()
    wide, high = (float(root.get(side, "").removesuffix("pt")) for side in ("width", "height"))
    with Image.open(png) as picture:
        pixels = np.asarray(picture.convert("L"))
    assert pixels.shape[1] / pixels.shape[0] == pytest.approx(wide / high, rel=2e-3)  # a pixel in 500
    margin = pixels.copy()
    inside = 13  # [px] the border lies at 0.14 in * 110 px/in = 15 px, two wide
    margin[inside:-inside, inside:-inside] = 255
    assert margin.min() == 255
    lettering = ["".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {name, sheet.summary, sheet.note, f"{sheet.numbers['length_m']:.2f}"} <= set(lettering)


@pytest.mark.slow
def test_a_rover_is_shown_with_its_loads_and_its_soils(offtrack_vehicle: Path) -> None:
    done = run("el_dorado_ii")
    assert done.exit_code == 0
    for words in ("front left", "uphill 51°", "69.7", "0.41 m/s", "±60°", "on the spot", "toyoura sand", "91%"):
        assert words in done.stdout
    numbers = json.loads(run("el_dorado_ii", "--json").stdout)
    skid = json.loads(run("el_dorado_ii_skid", "--json").stdout)  # it turns by wheel speeds
    assert (skid["steered"], skid["turning_radius_m"], skid["steer_limit_deg"]) == (False, None, None)
    assert skid["effective_track_m"] == load_rover("el_dorado_ii_skid").effective_track
    assert [wheel["load_n"] for wheel in numbers["wheels"]] == pytest.approx([28.4 * 9.81 / 4.0] * 4)
    assert numbers["tips_at_deg"]["sideways"] == pytest.approx(math.degrees(math.atan(0.275 / 0.24)))
    assert numbers["soils"].keys() == set(soil_names())
    assert numbers["soils"]["drift_sand"]["sinkage_m"] == pytest.approx(
        settled_sinkage(load_rover("el_dorado_ii"), load_soil("drift_sand"), 28.4 * 9.81 / 4.0)
    )


def test_the_wheels_of_a_rover_are_drawn_to_scale() -> None:
    """Axles half a wheelbase from the middle, tyres of the file's radius that touch the ground."""
    rover, ax = load_rover("el_dorado_ii"), Figure().add_subplot(aspect="equal")
    rover_views.side_view(ax, Scale(6.0), rover_sheet(rover, []))
    tyres = [patch for patch in ax.patches if isinstance(patch, Circle) and patch.get_radius() == rover.radius]
    centres = np.sort(np.array([centre_of(tyre) for tyre in tyres]), axis=0)
    assert centres == pytest.approx(np.array([(-0.3, rover.radius), (0.3, rover.radius)]))


@pytest.mark.parametrize("like", vehicle_names())
def test_a_new_vehicle_is_the_one_that_it_is_like(like: str, offtrack_vehicle: Path) -> None:
    """Every number is there, plain, and every number of a known kind says its unit."""
    assert run("new", "mine", "--like", like).exit_code == 0
    made = load_vehicle("mine.toml")
    assert made.model_copy(update={"name": like, "summary": ""}) == load_vehicle(like).model_copy(
        update={"summary": ""}
    )
    lines = Path("mine.toml").read_text(encoding="utf-8").splitlines()
    masses = [line for line in lines if line.startswith("mass = ")]
    assert masses
    assert all("# [kg], " in line and "usual: " in line for line in masses)


@pytest.mark.parametrize(("like", "axles"), [("eu_tractor_semitrailer", (3, 2)), ("b_double", (2, 4, 1))])
def test_a_new_vehicle_has_as_many_axles_as_asked_for(
    like: str, axles: tuple[int, ...], offtrack_vehicle: Path
) -> None:
    """Those of a group stand about the same middle, 1.31 m apart; the sheet can be drawn."""
    assert run("new", "mine", "--like", like, "--axles", ",".join(map(str, axles))).exit_code == 0
    made, model = load_vehicle("mine.toml"), load_vehicle(like)
    assert tuple(len(unit.axles) for unit in made.units) == axles
    places = [axle.x for axle in made.units[1].axles]
    assert np.mean(places) == pytest.approx(np.mean([axle.x for axle in model.units[1].axles]), abs=0.002)
    np.testing.assert_allclose(np.diff(places), -1.31, atol=0.002)
    assert run("mine.toml", "--quiet").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("new",), "vehicle new: name the vehicle"),
        (("new", "a/b"), "a name has letters"),
        (("new", "mine", "--axles", "2"), "--axles 2: expected 2 numbers from 1 to 10"),
        (("new", "mine", "--axles", "1,3"), "the first unit needs two axles"),
        (("new", "mine", "--like", "b_doubl"), "did you mean 'b_double'"),
        (("b_double", "mine"), "belong to: offtrack vehicle new NAME"),
    ],
)
def test_what_vehicle_new_can_not_make_is_one_line(
    arguments: tuple[str, ...], line: str, offtrack_vehicle: Path
) -> None:
    with pytest.raises(ValueError, match=re.escape(line)):
        CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert not Path("mine.toml").exists()
