"""Drawings where they belong: in a GIS reader they lie on the points that were driven, in the user's coordinates."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.roads.earth import tangent_plane
from tests.open_drive import Piece, Start, lane, lanes, plan
from vehicle.frames import FloatArray

PIECES = (Piece(60.0), Piece(40.0, 0.02), Piece(40.0))
START = Start(565_000.0, 5_936_000.0, 0.6)  # in zone 32 of UTM, north east of Hamburg's middle
SHIFT = (560_000.0, 5_930_000.0, 0.3)  # offset of an OpenDRIVE file: x, y [m] and turn [rad]
UTM, LAMBERT = (
    "EPSG:25832",
    "+proj=lcc +lat_1=53 +lat_2=54 +lat_0=53.5 +lon_0=10 +x_0=5000 +ellps=GRS80 +units=m",
)


def test_places_on_a_plane_are_the_degrees_they_came_from() -> None:
    """To 0.01 mm over 20 km, at all latitudes and heights."""
    for latitude in (-77.8, -33.9, 0.0, 53.5, 89.5):
        lat = latitude + np.linspace(-0.09, 0.09, 7)
        lon = 179.95 + np.linspace(-0.1, 0.04, 7)
        places, plane = tangent_plane(lat, lon, np.full(7, 4200.0))
        found = plane.degrees(places)
        np.testing.assert_allclose(found[:, 1], lat, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(found[:, 0], lon, rtol=0.0, atol=1e-10 / math.cos(math.radians(abs(latitude) + 0.1)))


def points(start: Start = START, spacing: float = 0.5) -> FloatArray:
    """Points of the line, arc and line (n, 2) [m]."""
    x, y, heading = start
    rows = []
    for length, curvature in PIECES:
        s = np.arange(0.0, length, spacing)
        turn = curvature * s
        ahead, aside = (np.sin(turn) / curvature, (1.0 - np.cos(turn)) / curvature) if curvature else (s, 0.0 * s)
        c, v = math.cos(heading), math.sin(heading)
        rows.append(np.column_stack([x + c * ahead - v * aside, y + v * ahead + c * aside]))
        turn_end = curvature * length
        end = (math.sin(turn_end) / curvature, (1.0 - math.cos(turn_end)) / curvature) if curvature else (length, 0.0)
        x, y, heading = x + c * end[0] - v * end[1], y + v * end[0] + c * end[1], heading + turn_end
    return np.concatenate(rows)


def transformed(xy: FloatArray, source: str, target: str) -> FloatArray:
    pyproj = pytest.importorskip("pyproj", reason="--crs needs the extra 'gis'")
    return np.column_stack(pyproj.Transformer.from_crs(source, target, always_xy=True).transform(*xy.T))


def csv(path: Path) -> Path:
    np.savetxt(path, points(), delimiter=",", header="x,y", comments="", fmt="%.4f")
    return path


def gpx(path: Path) -> Path:
    places = transformed(points(), UTM, "EPSG:4326").tolist()
    rows = (f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"/>' for lon, lat in places)
    path.write_text(f"<gpx><trk><trkseg>{''.join(rows)}</trkseg></trk></gpx>", encoding="utf-8")
    return path


def xodr(path: Path) -> Path:
    """The same line, in the middle of a lane, in a file that is moved and turned by its offset."""
    x, y, turn = SHIFT
    away = np.array([START.x - x, START.y - y]) @ [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    start = Start(float(away[0]), float(away[1]), START.heading - turn)
    header = (
        f'<header revMajor="1" revMinor="7"><geoReference><![CDATA[+proj=utm +zone=32 +ellps=GRS80 +units=m '
        f'+geoidgrids=egm96_15.gtx +vunits=m]]></geoReference><offset x="{x}" y="{y}" z="0" hdg="{turn}"/></header>'
    )
    middle = '<laneOffset s="0" a="2.0" b="0" c="0" d="0"/>'
    length = sum(piece.length for piece in PIECES)
    road = f'<road id="1" junction="-1" length="{length}">{plan(PIECES, start)}{lanes([], [lane(-1)], middle)}</road>'
    path.write_text(f"<OpenDRIVE>{header}{road}</OpenDRIVE>", encoding="utf-8")
    return path


def driven(file: Path, run: Path) -> Path:
    kind = "opendrive" if file.suffix == ".xodr" else "path"
    settings = (f"course.kind={kind}", f"course.file={file}", "off_tracking=truth", "trailer_steering=none")
    options = [text for one in settings for text in ("--set", one)]
    answer = CliRunner().invoke(app, ["run", "roundabout", *options, "--no-video", "--quiet", "--out", str(run)])
    assert answer.exit_code == 0, answer.output
    return run


def drawn(run: Path, kind: str, crs: str | None) -> Path:
    path = run / f"drawn.{kind}"
    path.unlink(missing_ok=True)
    options = [] if crs is None else ["--crs", crs]
    answer = CliRunner().invoke(app, ["draw", str(run), "--to", kind, "--out", str(path), *options])
    assert answer.exit_code == 0, answer.output
    return path


def course_in_a_gis(path: Path) -> tuple[str, Any]:
    """Coordinate system and course of a drawing, as GDAL reads them."""
    pyogrio = pytest.importorskip("pyogrio.raw", reason="not installed: pip install pyogrio")
    shapely = pytest.importorskip("shapely")
    about, _, geometries, (layers,) = pyogrio.read(path, columns=["layer"])
    (line,) = (shapely.from_wkb(one) for one, layer in zip(geometries, layers, strict=True) if layer == "COURSE")
    return about["crs"], line


@pytest.mark.slow
@pytest.mark.parametrize("make", [csv, gpx, xodr], ids=["a UTM table", "a GPX track", "an OpenDRIVE map"])
def test_the_path_lies_on_the_input_in_a_gis(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    """Within the distance that the smooth path has from the points, and 1 mm; that is below 1 cm in all."""
    shapely = pytest.importorskip("shapely")
    run = driven(make(tmp_path / f"drive.{make.__name__}"), tmp_path / "run")
    numbers = json.loads((run / "summary.json").read_text())["course"]
    assert numbers["path_deviation_m"] < 0.009
    own = "EPSG:4326" if make is gpx else None
    for crs in (None, UTM) if make is csv else (None, UTM, LAMBERT, "EPSG:4326"):
        read, line = course_in_a_gis(drawn(run, "geojson", crs))
        system = own if crs is None else crs
        if make is csv and crs is None:
            assert "Frame of the course's file" in read
        elif system and system.startswith("EPSG"):
            assert read == system
        back = np.array(line.coords) if make is csv else transformed(np.array(line.coords), read, UTM)
        path = shapely.LineString(back)
        worst = max(shapely.Point(point).distance(path) for point in points())
        assert worst < numbers["path_deviation_m"] + 0.001
    place = json.loads((run / "manifest.json").read_text())["placement"]
    assert numbers.items() >= {name: value for name, value in place.items() if name != "crs"}.items()
    told = json.loads((run / "drawn.geojson").read_text())
    assert told["placement"] == place


@pytest.mark.slow
def test_a_gpx_drive_is_on_the_site_plan(tmp_path: Path) -> None:
    """In DXF: metres of UTM if they are asked for, else of the plane that touches the earth; degrees are refused."""
    ezdxf = pytest.importorskip("ezdxf")
    run = driven(gpx(tmp_path / "drive.gpx"), tmp_path / "run")
    first, last = points().min(axis=0), points().max(axis=0)
    for crs, low in ((UTM, first), (None, 0.5 * (first - last))):
        document = ezdxf.readfile(drawn(run, "dxf", crs))
        (course,) = (one for one in document.modelspace() if one.dxf.layer == "COURSE")
        found = np.array(course.get_points("xy"))
        assert (np.abs(found.min(axis=0) - low) < 2.0).all()
        assert not document.audit().errors
        whole = points() - points().mean(axis=0)
        angle = math.atan2(*(found[-1] - found[0])[::-1]) - math.atan2(*(whole[-1] - whole[0])[::-1])
        assert abs(angle) < 0.03  # x is east: the grid of UTM is turned by 0.8 deg there
    refused = CliRunner().invoke(app, ["draw", str(run), "--crs", "EPSG:4326", "--out", str(run / "x.dxf")])
    assert refused.exit_code == 2
    assert "has degrees; DXF needs metres" in refused.stderr
    assert not (run / "x.dxf").exists()


@pytest.mark.slow
def test_a_system_that_is_none_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    run = driven(csv(tmp_path / "drive.csv"), tmp_path / "run")
    answer = CliRunner().invoke(app, ["draw", str(run), "--to", "geojson", "--crs", "EPSG:999999"])
    assert answer.exit_code == 2
    assert "--crs EPSG:999999: no coordinate system that is known" in answer.stderr
    assert answer.stderr.count("\n") == 1
    answer = CliRunner().invoke(app, ["draw", str(run), "--to", "geojson", "--crs", "EPSG:4326"])
    assert "has degrees; the course's file has metres" in answer.stderr
    assert not (run / "drawing.geojson").exists()
