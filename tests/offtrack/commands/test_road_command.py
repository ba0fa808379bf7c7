"""`offtrack road` as a user meets it: what a file holds, and that what it says can be driven is driven."""

import json
import shlex
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.options.scenario import load_scenario
from tests.open_drive import Piece, Start, bend, crossing, lane, lanes, road, sections
from tests.open_drive import file as network

POINT = '<trkpt lat="{:.7f}" lon="{:.7f}"/>'
STRAIGHT = POINT.format(57.7, 12.0) + POINT.format(57.7, 12.001)
GPX = f"<gpx><trk><name>There</name><trkseg>{STRAIGHT}</trkseg></trk><trk><trkseg>{{}}</trkseg></trk></gpx>"
NOISY = "".join(
    POINT.format(57.71 + 1e-5 * aside, 12.0 + 4e-5 * k)
    for k, aside in enumerate(np.random.default_rng(3).normal(0.0, 0.4, 60).tolist())
)


def shown(folder: Path, name: str, text: str, *more: str) -> tuple[str, Any]:
    """What the command prints, and its facts."""
    (folder / name).write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, ["road", str(folder / name), "--out", str(folder / "out"), *more])
    assert done.exit_code == 0, done.output
    return done.stdout, json.loads((folder / "out" / "facts.json").read_text(encoding="utf-8"))


def drives(output: str) -> list[str]:
    """Settings of the command that the output gives."""
    words = shlex.split(next(line for line in output.splitlines() if line.startswith("Drive it:")))
    return [word for before, word in pairwise(words) if before == "--set"]


def length(settings: list[str]) -> float:
    scenario = load_scenario("roundabout", settings)
    return course_of(scenario, vehicle_of(scenario)).length


def test_a_map_is_listed_with_its_lanes_and_the_words_for_its_ways(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each way through the crossing is driven by the word beside it; the plan has the ids."""
    monkeypatch.setenv("COLUMNS", "160")
    output, facts = shown(tmp_path, "crossing.xodr", crossing())
    assert length(drives(output)) == pytest.approx(facts["drive"]["length_m"])
    ways = facts["ways"]
    assert len(ways) > 1
    for way in ways:
        start = [f"course.road={way['from_road']}", f"course.lane={way['from_lane']}", f"course.route={way['word']}"]
        assert length([*drives(output)[:3], *start]) > 20.0
        assert way["word"] in output
    for one in facts["lanes"]:
        assert one["drivable"], one
        assert set(one) == {"road", "lane", "from_m", "to_m", "drivable", "reason"}
    svg = ElementTree.parse(tmp_path / "out" / "plan.svg")
    texts = {element.text for element in svg.iter() if element.tag.endswith("text")}
    assert {f"road {one['road']}" for one in facts["roads"]} <= texts
    with Image.open(tmp_path / "out" / "plan.png") as picture:
        assert picture.width > 800


def test_what_can_not_be_driven_has_its_reason(tmp_path: Path) -> None:
    beside = road("1", (Piece(100.0),), sections((0.0, [], [lane(-1, width=1.2), lane(-2)])))
    tight = road("2", (Piece(30.0), Piece(5.0, -0.3)), lanes([], [lane(-1)]), start=Start(0.0, 50.0, 0.0))
    text = network(beside, tight)
    output, facts = shown(tmp_path, "map.xodr", text)
    narrow, wide, bent = facts["lanes"]
    assert "1.20 m wide" in narrow["reason"]
    assert wide["drivable"]
    assert "the path has a radius of 1.7 m: the tractor would have to steer by" in bent["reason"]
    assert "1.20 m wide" in output
    assert facts["roads"][1]["smallest_radius_m"] == pytest.approx(1.0 / 0.3, rel=0.02)


def test_json_is_all_that_is_printed(tmp_path: Path) -> None:
    output, facts = shown(tmp_path, "bend.xodr", bend(40.0, 1.0), "--json")
    assert json.loads(output) == facts
    assert facts["roads"][0]["smallest_radius_m"] == pytest.approx(40.0 - 4.5)  # of the reference line


def test_tracks_are_listed_with_settings_that_drive_them(tmp_path: Path) -> None:
    """The first as it is; the second is noisy, so it needs a longer smoothing and a tolerance, which are found."""
    output, facts = shown(tmp_path, "two.gpx", GPX.format(NOISY))
    first, second = facts["tracks"]
    assert (first["name"], first["points"], first["settings"][2:]) == ("There", 2, ["course.track=1"])
    assert first["length_m"] == pytest.approx(59.6, abs=0.1)  # 0.001 deg on the parallel
    assert first["largest_jump_after"] == "line 1 (lat 57.7000000, lon 12.0000000)"
    assert second["drivable"]
    assert any(setting.startswith("course.smoothing=") for setting in second["settings"])
    assert "can be driven with course.smoothing=" in output
    for track in facts["tracks"]:
        assert length(["off_tracking=truth", *track["settings"]]) == pytest.approx(track["length_m"], rel=0.2)


def test_heights_of_a_table_have_range_and_grade(tmp_path: Path) -> None:
    rows = "\n".join(f"{10 * k};0;{5 + 0.3 * k:.2f}" for k in range(12)).replace(".", ",")
    output, facts = shown(tmp_path, "table.csv", f"x;y;z\n{rows}\n")
    (track,) = facts["tracks"]
    assert track["heights_m"] == pytest.approx([5.0, 8.3])
    assert track["steepest_grade"] == pytest.approx(0.03)
    assert length(drives(output)) == pytest.approx(110.0)


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("map.txt", "x", "must end with .xodr"),
        ("none.xodr", "<OpenDRIVE/>", "has no <road>"),
        ("none.gpx", "<gpx/>", "has 0 tracks"),
        ("map.csv", "a,b\n1,2\n", "unknown column 'a'"),
        ("map.csv --vehicle tank", "x,y\n0,0\n50,0\n", "unknown vehicle 'tank'"),
    ],
)
def test_a_wrong_file_ends_in_one_line(tmp_path: Path, name: str, text: str, wanted: str) -> None:
    name, *more = name.split()
    (tmp_path / name).write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, ["road", str(tmp_path / name), *more, "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert wanted in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
