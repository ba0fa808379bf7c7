"""Drawings of drives for CAD: closed polylines on named layers in metres, exact, and the same each time."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.exchange import drawings
from offtrack.exchange.drawings import DrivenPath, drawing, geojson, unit_layers, write_drawing
from offtrack.studies.standards.assessment import Assessment
from offtrack.studies.standards.assessment_report import write_drawings
from offtrack.studies.standards.proving_ground import Manoeuvre
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.log import Log, Signal, write_log
from scenarios.results.swept_path import UnitOutline
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

shapely = pytest.importorskip("shapely")
ezdxf = pytest.importorskip("ezdxf")

BODY = UnitOutline("Truck 1/ä", 3.0, -1.0, 2.0, (2.0, 0.0), (1.8, 1.8), ("steer_tractor", None))
QUICK = ("course.turn_deg=30", "course.entry=20", "course.exit=5", "off_tracking=truth", "trailer_steering=none")


def driven(path: FloatArray, **more: Any) -> DrivenPath:
    return DrivenPath(
        title="test",
        notes=("a note",),
        units=(BODY,),
        poses=(path,),
        steer=(np.zeros((len(path), 2)),),
        time=np.linspace(0.0, 10.0, len(path)),
        front_axle_x=2.0,
        **more,
    )


def straight() -> FloatArray:
    return np.column_stack([np.linspace(0.0, 20.0, 201), np.zeros(201), np.zeros(201)])


def circling() -> FloatArray:
    """A full circle of radius 10 m of the body's origin, about (0, 10)."""
    psi = np.linspace(0.0, 2.0 * math.pi, 2001)
    return np.column_stack([10.0 * np.sin(psi), 10.0 * (1.0 - np.cos(psi)), psi])


def areas(told: dict[str, Any], layer: str) -> list[Any]:
    chosen = [feature for feature in told["features"] if feature["properties"]["layer"] == layer]
    return [shapely.geometry.shape(feature["geometry"]) for feature in chosen]


def test_a_straight_drive_sweeps_a_rectangle() -> None:
    (swept,) = areas(geojson(drawing(driven(straight()))), drawings.SWEPT)
    assert swept.bounds == pytest.approx((-1.0, -1.0, 23.0, 1.0))
    assert swept.area == pytest.approx(24.0 * 2.0)


def test_a_circle_sweeps_a_ring_with_an_island() -> None:
    """Inner radius R - w/2, outer radius that of the front corner: the area of the ring to 0.1 %."""
    (swept,) = areas(geojson(drawing(driven(circling()))), drawings.SWEPT)
    outer, inner = math.hypot(11.0, 3.0), 9.0
    assert len(swept.interiors) == 1
    assert swept.is_valid
    assert swept.area == pytest.approx(math.pi * (outer**2 - inner**2), rel=1e-3)
    (left, bottom, right, top) = swept.bounds
    assert (right - left, top - bottom) == pytest.approx((2.0 * outer, 2.0 * outer), abs=5e-3)


def test_what_can_not_be_drawn_is_refused() -> None:
    """A file of signals from elsewhere may hold anything."""
    unknown, huge = straight(), straight()
    unknown[7, 2] = math.nan
    huge[-1, 0] = 1e9
    for path, every, says in (
        (unknown, 5.0, "not a number"),
        (huge, 5.0, "must be 0.1 m to 200 km"),
        (straight()[:1], 5.0, "drove 0 m"),
        (straight(), 1e-3, "every 0.001 m would be 20000 times, at most 5000"),
    ):
        with pytest.raises(ValueError, match=says):
            drawing(driven(path), every=every)


def test_a_road_is_an_area_with_its_edges() -> None:
    """20 m of road, 4 m to either side."""
    road = np.column_stack([np.linspace(0.0, 20.0, 41), np.zeros(41)])
    told = geojson(drawing(driven(straight(), road=road, road_half_width=4.0)))
    (area,) = areas(told, drawings.ROAD)
    assert area.bounds == pytest.approx((0.0, -4.0, 20.0, 4.0))
    assert [len(areas(told, layer)) for layer in (drawings.ROAD_CENTRE, drawings.COURSE)] == [1, 0]


def test_geojson_is_as_its_specification_asks() -> None:
    """RFC 7946: rings closed, outer ones counter-clockwise, holes clockwise; and it says that these are not degrees."""
    told = geojson(drawing(driven(circling())))
    assert told["type"] == "FeatureCollection"
    assert told["crs"]["properties"]["name"].startswith("ENGCRS[")
    assert "Coordinates: metres; x along the first heading" in told["notes"][-1]
    for feature in told["features"]:
        if feature["geometry"]["type"] == "Polygon":
            edge, *holes = feature["geometry"]["coordinates"]
            assert edge[0] == edge[-1]
            assert shapely.geometry.LinearRing(edge).is_ccw
            assert not any(shapely.geometry.LinearRing(hole).is_ccw for hole in holes)
    (place,) = [f["properties"] for f in told["features"] if f["properties"].get("travelled_m") == 0.0][:1]
    assert place["unit"] == BODY.name


def test_dxf_opens_without_errors_in_metres_on_named_layers(tmp_path: Path) -> None:
    """Areas are closed polylines; the swept ring has two. Layer names hold nothing that CAD programs refuse."""
    write_drawing(drawing(driven(circling(), course=circling()[:, :2])), tmp_path / "a.dxf", "dxf")
    document = ezdxf.readfile(tmp_path / "a.dxf")
    assert not document.audit().errors
    assert document.header["$INSUNITS"] == 6
    assert document.header["$MEASUREMENT"] == 1
    assert document.header["$ACADVER"] == "AC1024"
    low, high = np.array(document.header["$EXTMIN"])[:2], np.array(document.header["$EXTMAX"])[:2]
    assert low[0] < -11.0 < 11.0 < high[0]  # the ring that a front corner drives
    assert (high - low < 60.0).all()
    scale = document.header["$PSVPSCALE"]
    page = np.array(document.header["$PLIMMAX"])  # A3 in metres, as LibreCAD reads it: the drawing is on it
    assert page.tolist() == [0.42, 0.297]
    assert (scale * (high - low) < page).all()
    np.testing.assert_allclose(np.array(document.header["$PINSBASE"])[:2] + scale * low, 0.01)
    by_layer: dict[str, list[Any]] = {}
    for entity in document.modelspace():
        by_layer.setdefault(entity.dxf.layer, []).append(entity)
    body = unit_layers([BODY.name])[BODY.name]
    assert body == "VEHICLE_TRUCK_1_A"
    assert len(set(unit_layers(["Ä", "A", "a", "挂车"]).values())) == 4
    closed = dict.fromkeys((drawings.SWEPT, body, drawings.WHEELS), True)
    closed |= dict.fromkeys((drawings.COURSE, drawings.FRONT_AXLE), False)
    for layer, is_closed in closed.items():
        assert layer in document.layers
        assert all(entity.closed is is_closed for entity in by_layer[layer]), layer
    assert len(by_layer[drawings.SWEPT]) == 2
    assert len(by_layer[drawings.WHEELS]) == 4 * len(by_layer[body])
    corner = np.array(by_layer[body][0].get_points("xy"))
    np.testing.assert_allclose(sorted(corner[:, 0]), [-1.0, -1.0, 3.0, 3.0], atol=1e-12)
    assert [text.dxf.text for text in by_layer[drawings.NOTES]][:2] == ["test", "a note"]


def test_names_from_files_do_not_break_the_drawing(tmp_path: Path) -> None:
    """A line break in a name would end a value of a DXF file."""
    path = tmp_path / "a.dxf"
    write_drawing(drawing(replace(driven(straight()), title="a\n  0\nEOF\n" + 1000 * "x")), path, "dxf")
    document = ezdxf.readfile(path)
    assert not document.audit().errors
    title = next(entity for entity in document.modelspace() if entity.dxf.layer == drawings.NOTES)
    assert len(title.dxf.text) < 400


def test_the_same_drive_gives_the_same_file(tmp_path: Path) -> None:
    for name in ("a", "b"):
        for kind in ("dxf", "geojson"):
            write_drawing(drawing(driven(straight())), tmp_path / f"{name}.{kind}", kind)
    assert (tmp_path / "a.dxf").read_bytes() == (tmp_path / "b.dxf").read_bytes()
    assert (tmp_path / "a.geojson").read_bytes() == (tmp_path / "b.geojson").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.dxf", "a.geojson", "b.dxf", "b.geojson"}


@pytest.mark.slow
def test_a_finished_run_is_drawn_where_it_drove(tmp_path: Path) -> None:
    """From the run directory alone: bodies at the places of the log, the road of its course, changed dimensions too."""
    scenario = load_scenario("roundabout", [*QUICK, "plant.units.semitrailer.width=3.0"])
    result = run(scenario, 1)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "scenario.toml").write_text(result.scenario_toml, encoding="utf-8")
    write_log(result.log, tmp_path / "run" / "signals.parquet")
    done = CliRunner().invoke(app, ["draw", str(tmp_path / "run"), "--to", "both", "--every", "10"])
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "run" / "drawing.geojson").read_text(encoding="utf-8"))
    first, *_ = areas(told, "VEHICLE_SEMITRAILER")
    trailer = result.units[1]
    length = trailer.front_x - trailer.rear_x
    assert sorted(math.dist(*pair) for pair in zip(first.exterior.coords, first.exterior.coords[1:], strict=False)) == (
        pytest.approx([3.0, 3.0, length, length], abs=1e-3)
    )
    (swept,) = areas(told, drawings.SWEPT)
    for unit in result.units:
        origin = shapely.points(unit.poses(result.log)[:, :2])
        assert shapely.contains(swept.buffer(0.01), origin).all()
    assert not ezdxf.readfile(tmp_path / "run" / "drawing.dxf").audit().errors
    again = CliRunner().invoke(app, ["draw", str(tmp_path / "run")])
    assert again.exit_code == 2
    assert "exists already" in again.stderr


def test_assessments_draw_what_follows_a_path(tmp_path: Path) -> None:
    vehicle = load_vehicle("rigid_truck")
    path = straight()
    signals = [Signal(name, "-", name) for name in ("time", "x_truck", "y_truck", "psi_truck")]
    log = Log(tuple(signals), np.column_stack([np.linspace(0.0, 10.0, 201), path]))
    still = Log(log.signals, log.rows[:1])
    manoeuvres = tuple(
        Manoeuvre(key=key, title=key, how="", outcome="completed", figures={}, log=driven_log, course=course)
        for key, driven_log, course in (
            ("turn", log, path[:, :2]),
            ("pulse", log, None),
            ("roundabout", still, path[:, :2]),
        )
    )
    case = Assessment(vehicle=vehicle, trailer_steering="none", manoeuvres=manoeuvres, linear={})
    write_drawings(case, tmp_path, "full-left-", ("dxf", "geojson"))
    assert {file.name for file in tmp_path.iterdir()} == {"full-left-turn.dxf", "full-left-turn.geojson"}
    (swept,) = areas(json.loads((tmp_path / "full-left-turn.geojson").read_text(encoding="utf-8")), drawings.SWEPT)
    truck = vehicle.units[0]
    assert swept.area == pytest.approx((20.0 + truck.front_x - truck.rear_x) * truck.width, rel=1e-3)
