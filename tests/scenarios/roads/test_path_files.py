"""Tracks and tables as other programs write them: read as they are, or refused in one line with the file's words."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.options.course import PathOptions
from scenarios.roads.fitted_path import Fit, fitted_path
from scenarios.roads.path_file import PathPoints, read_path
from scenarios.roads.standstill import means, standstills
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

RADIUS = 50.0
ANGLES = np.arange(0.0, 1.5 * math.pi, 0.04)
CIRCLE = RADIUS * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)  # east and north [m]
A, F = 6378137.0, 1.0 / 298.257223563  # WGS 84
E2 = F * (2.0 - F)
GOTHENBURG, FIJI, SVALBARD, SYDNEY, EQUATOR = (57.7, 11.97), (-17.0, 180.0), (78.2, 15.6), (-33.9, 151.2), (0.0, 0.0)


def geodetic(enu: FloatArray, origin: tuple[float, float], height: float = 0.0) -> FloatArray:
    """Latitude and longitude (n, 2) [deg] of east and north (n, 2) [m] in the plane that touches the earth.

    Earth-centred positions by the rotation of the local frame, and back by fixed-point iteration of the latitude.
    """
    lat, lon = np.radians(origin)
    n = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    centre = np.array([(n + height) * math.cos(lat), 0.0, ((1.0 - E2) * n + height) * math.sin(lat)])
    east, north = np.array([0.0, 1.0, 0.0]), np.array([-math.sin(lat), 0.0, math.cos(lat)])
    x, y, z = (centre + enu[:, :1] * east + enu[:, 1:] * north).T
    across, found = np.hypot(x, y), np.full(len(x), lat)
    for _ in range(30):
        found = np.arctan2(z + E2 * A / np.sqrt(1.0 - E2 * np.sin(found) ** 2) * np.sin(found), across)
    longitude = np.degrees(np.arctan2(y, x) + lon)
    places: FloatArray = np.stack([np.degrees(found), (longitude + 180.0) % 360.0 - 180.0], axis=1)
    return places


def utm(places: FloatArray, zone: int, south: bool = False) -> FloatArray:
    """Eastings and northings (n, 2) [m] of latitudes and longitudes [deg], by the series in powers of the longitude.

    The arc of the meridian is summed up numerically: nothing is shared with the package.
    """
    lat, lon = np.radians(places[:, 0]), np.radians(places[:, 1] - (6.0 * zone - 183.0))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    at = 0.5 * lat[:, None] * (nodes + 1.0)
    arc = 0.5 * lat * (A * (1.0 - E2) / (1.0 - E2 * np.sin(at) ** 2) ** 1.5 @ weights)
    n, t, c = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2), np.tan(lat) ** 2, E2 / (1.0 - E2) * np.cos(lat) ** 2
    a = lon * np.cos(lat)
    easting = n * (a + (1 - t + c) * a**3 / 6 + (5 - 18 * t + t**2 + 14 * c - 58 * t * c) * a**5 / 120)
    northing = arc + n * np.tan(lat) * (a**2 / 2 + (5 - t + 9 * c + 4 * c**2) * a**4 / 24)
    northing = northing + n * np.tan(lat) * (61 - 58 * t + t**2 + 270 * c - 330 * t * c) * a**6 / 720
    grid: FloatArray = 0.9996 * np.stack([easting, northing], axis=1) + np.array([500e3, 10e6 if south else 0.0])
    return grid


def off_circle(places: FloatArray) -> float:
    """Largest distance of points from the circle, with the same begin, wherever its centre is."""
    return float(np.abs(places - places[0] - (CIRCLE - CIRCLE[0])).max())


def trackpoints(places: FloatArray, inner: str = "", tag: str = "trkpt") -> str:
    return "".join(f'<{tag} lat="{lat:.9f}" lon="{lon:.9f}">{inner}</{tag}>\n' for lat, lon in places.tolist())


def gpx(body: str, head: str = '<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1">') -> str:
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{head}{body}</gpx>'


def trk(points: str, name: str = "") -> str:
    return f"<trk>{f'<name>{name}</name>' if name else ''}<trkseg>{points}</trkseg></trk>"


GARMIN = (
    "<ele>12.5</ele><time>2024-05-01T10:00:00.000Z</time><extensions><ns3:TrackPointExtension><ns3:atemp>20</ns3:atemp>"
    "<ns3:hr>120</ns3:hr></ns3:TrackPointExtension></extensions>"
)
GARMIN_HEAD = (
    '<gpx creator="Garmin Connect" version="1.1" xmlns="http://www.topografix.com/GPX/1/1" '
    'xmlns:ns3="http://www.garmin.com/xmlschemas/TrackPointExtension/v1">'
)
TOPO = '<gpx:gpx version="1.0" creator="GPSBabel" xmlns:gpx="http://www.topografix.com/GPX/1/0">'
HERE = geodetic(CIRCLE, GOTHENBURG)
LON_LAT = HERE[:, ::-1].tolist()
FIRST, LAST = HERE[:60], HERE[60:]


def feature(geometry: Any, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties or None, "geometry": geometry}


def collection(*features: Any, **more: Any) -> str:
    return json.dumps({"type": "FeatureCollection", **more, "features": list(features)})


def line_string(coordinates: Any = LON_LAT) -> dict[str, Any]:
    return {"type": "LineString", "coordinates": coordinates}


def crs(name: str) -> dict[str, Any]:
    return {"type": "name", "properties": {"name": name}}


def projected(zone: int, origin: tuple[float, float], name: str, shift: float = 0.0) -> str:
    places = utm(geodetic(CIRCLE, origin), zone, origin[0] < 0.0) + np.array([shift, 0.0])
    return collection(feature(line_string(places.tolist())), crs=crs(name))


MERCATOR = [[A * math.radians(lon), A * math.asinh(math.tan(math.radians(lat)))] for lon, lat in LON_LAT]
POINT = {"type": "Point", "coordinates": LON_LAT[0]}
MARKER = feature(POINT, name="gate")
TRACKS: dict[str, tuple[str, str]] = {  # all of them are the circle
    "GPX 1.1": ("gpx", gpx(trk(trackpoints(HERE)))),
    "GPX 1.0 with a prefix": (
        "gpx",
        gpx(trk(trackpoints(HERE)), TOPO).replace("<t", "<gpx:t").replace("</", "</gpx:"),
    ),
    "route": ("gpx", gpx(f"<rte><name>there</name>{trackpoints(HERE, tag='rtept')}</rte>")),
    "Garmin": ("gpx", gpx(f"<metadata><time/></metadata>{trk(trackpoints(HERE, GARMIN), 'Gate')}", GARMIN_HEAD)),
    "waypoints beside it": ("gpx", gpx(trackpoints(HERE[:3], tag="wpt") + trk(trackpoints(HERE)))),
    "empty track beside it": ("gpx", gpx(f"<trk/><trk><trkseg/></trk>{trk(trackpoints(HERE))}")),
    "two segments": ("gpx", gpx(trk(f"{trackpoints(FIRST)}</trkseg><trkseg/><trkseg>{trackpoints(LAST)}"))),
    "no heights written": ("gpx", gpx(trk(trackpoints(HERE, "<ele/>")))),
    "LineString": ("geojson", json.dumps(line_string())),
    "Feature": ("geojson", json.dumps(feature(line_string()))),
    "geojson.io": ("geojson", collection(feature(line_string()), MARKER)),
    "QGIS": ("geojson", collection(
        feature({"type": "MultiLineString", "coordinates": [LON_LAT]}, id=1, name=None),
        name="track", crs=crs("urn:ogc:def:crs:OGC:1.3:CRS84"),
    )),
    "parts that touch": ("json", json.dumps({"type": "MultiLineString", "coordinates": [LON_LAT[:60], LON_LAT[59:]]})),
    "MultiPoint": ("geojson", json.dumps({"type": "MultiPoint", "coordinates": LON_LAT})),
    "a point each": ("geojson", collection(*(feature({"type": "Point", "coordinates": one}) for one in LON_LAT))),
    "GeometryCollection": ("json", json.dumps({"type": "GeometryCollection", "geometries": [POINT, line_string()]})),
    "ogr2ogr in 3D": ("geojson", json.dumps({
        "type": "FeatureCollection", "bbox": [11, 57, 0, 12, 58, 9], "crs": crs("urn:ogc:def:crs:EPSG::4979"),
        "features": [{**feature(line_string([[*one, 7.5] for one in LON_LAT])), "id": 3, "bbox": [1, 2, 3, 4]}],
    })),
    "no crs": ("geojson", collection(feature(line_string()), crs=None)),
    "UTM 32 N": ("geojson", projected(32, GOTHENBURG, "urn:ogc:def:crs:EPSG::25832")),
    "UTM 33 N": ("geojson", projected(33, GOTHENBURG, "EPSG:32633")),
    "SWEREF 99 TM": ("geojson", projected(33, GOTHENBURG, "http://www.opengis.net/def/crs/EPSG/0/3006")),
    "UTM 56 S": ("geojson", projected(56, SYDNEY, "urn:ogc:def:crs:EPSG::32756")),
    "UTM in words": ("geojson", projected(33, SVALBARD, "WGS 84 / UTM zone 33N")),
    "zone before the easting": ("geojson", projected(32, GOTHENBURG, "EPSG:4647", 32e6)),
    "Web Mercator": ("geojson", collection(feature(line_string(MERCATOR)), crs=crs("urn:ogc:def:crs:EPSG::3857"))),
    "code of an old server": ("geojson", projected(32, GOTHENBURG, "").replace(
        json.dumps(crs("")), '{"type": "EPSG", "properties": {"code": 25832}}')),
    **{f"{name}": ("gpx", gpx(trk(trackpoints(geodetic(CIRCLE, origin)))))
       for name, origin in {"date line": FIJI, "78 deg north": SVALBARD, "south": SYDNEY, "0, 0": EQUATOR}.items()},
}  # fmt: skip


@pytest.mark.parametrize("case", TRACKS)
def test_a_track_is_where_the_earth_has_it(tmp_path: Path, case: str) -> None:
    """A circle of 50 m on the ellipsoid; degrees with nine decimals are 0.1 mm."""
    suffix, text = TRACKS[case]
    (tmp_path / f"track.{suffix}").write_text(text, encoding="utf-8")
    places = read_path(tmp_path / f"track.{suffix}").places
    assert off_circle(places) < 0.0015  # of UTM too: the plane's north is that of the earth, not of the grid


def table(rows: FloatArray, names: str = "x,y", separator: str = ",", form: str = "{:.6f}") -> str:
    lines = (separator.join(form.format(number) for number in row) for row in rows.tolist())
    return "\n".join([*([names] if names else []), *lines, ""])


SHIFTED = CIRCLE + np.array([565_000.0, 6_395_000.0])  # as eastings and northings
WITH_Z = np.column_stack([CIRCLE, np.full(len(CIRCLE), 12.0)])
NUMBERED = np.column_stack([np.arange(len(CIRCLE)), CIRCLE])


def german(text: str, group: str = ".") -> str:
    return text.replace(",", "!").replace(".", ",").replace("!", group)


def grouped(rows: FloatArray, separator: str, change: Callable[[str], str], quote: str = "") -> str:
    lines = (separator.join(f"{quote}{change(f'{number:,.6f}')}{quote}" for number in row) for row in rows.tolist())
    return "\n".join(["easting" + separator + "northing", *lines])


TABLES: dict[str, str | bytes] = {  # all of them are the circle
    "plain": table(CIRCLE),
    "capitals": table(CIRCLE, "X,Y"),
    "units": table(CIRCLE, "x [m], Y(m)"),
    "units behind": table(CIRCLE, "x_m,y / m"),
    "no names": table(CIRCLE, ""),
    "no names, heights": table(WITH_Z, ""),
    "semicolons": table(CIRCLE, "x;y", ";"),
    "tabs": table(CIRCLE, "x\ty", "\t"),
    "spaces": table(CIRCLE, "x y", "  "),
    "numpy": table(CIRCLE, "# x, y", " ").replace("x, y", "x y"),
    "remarks": "# depot\n# surveyed in May\n" + table(CIRCLE),
    "decimal comma": german(table(CIRCLE, "x;y", ";")),
    "decimal comma, no names": german(table(CIRCLE, "", ";")),
    "decimal comma, tabs": german(table(CIRCLE, "x\ty", "\t")),
    "decimal comma, quotes": grouped(CIRCLE, ",", german, '"'),
    "German groups": grouped(SHIFTED, ";", german),
    "English groups": grouped(SHIFTED, ",", str, '"'),
    "groups with spaces": grouped(SHIFTED, ";", lambda text: german(text, "\u00a0")),
    "Swiss groups": grouped(SHIFTED, ";", lambda text: text.replace(",", "'")),
    "stated separator": "sep=;\r\n" + table(CIRCLE, "x;y", ";").replace("\n", "\r\n"),
    "byte order mark": "\ufeff" + table(CIRCLE),
    "UTF-16": ("\ufeff" + table(CIRCLE, "x\ty", "\t")).encode("utf-16-le"),
    "UTF-16 of another machine": ("\ufeff" + table(CIRCLE)).encode("utf-16-be"),
    "Windows code page": table(WITH_Z, "x,y,Höhe").encode("cp1252"),
    "trailing separators": table(CIRCLE, "x;y;;", ";").replace("\n", ";;\n").replace("y;;;;", "y;;"),
    "empty rows": table(CIRCLE) + ",\n,,\n\n",
    "quotes": table(CIRCLE, '"x","y"'),
    "index and time": table(np.column_stack([NUMBERED, NUMBERED[:, 0]]), ",x,y,time"),
    "UTM": table(SHIFTED, "Easting,Northing"),
    "Gauss-Krüger": table(SHIFTED, "Rechtswert;Hochwert", ";"),
    "ArcGIS": table(np.column_stack([NUMBERED[:, 0], SHIFTED]), "OBJECTID,POINT_X,POINT_Y"),
    "degrees": table(HERE, "lat,lon", form="{:.9f}"),
    "degrees in words": table(HERE[:, ::-1], "Longitude (deg);Latitude (deg)", ";", "{:.9f}"),
    "degrees with a comma": german(table(HERE, "Breite;Länge", ";", "{:.9f}")),
    "minus of a typesetter": table(CIRCLE).replace("-", "\u2212"),
    "exponents": table(CIRCLE, form="{:.12E}"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLES)
def test_a_table_of_another_program_is_read(tmp_path: Path, case: str) -> None:
    """A circle of 50 m; six decimals are a micrometre, nine of a degree 0.1 mm."""
    content = TABLES[case]
    (tmp_path / "path.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    points = read_path(tmp_path / "path.csv")
    assert off_circle(points.places) < 0.001
    assert (points.heights is not None) == ("eights" in case or "code page" in case)


KNOWN = gpx(
    trk(trackpoints(HERE[:2])) + trk(trackpoints(HERE[:3]), "7") + trk(trackpoints(HERE[:4]), "Gate &amp; yard")
)
LINES = collection(*(feature(line_string(LON_LAT[:n]), Name=name) for n, name in ((2, "A"), (3, "B"), (4, "B"))))


@pytest.mark.parametrize(
    ("name", "text", "track", "count"),
    [
        *(("t.gpx", KNOWN, track, n) for track, n in (("1", 2), ("7", 3), ("3", 4), ("Gate & yard", 4))),
        *(("t.geojson", LINES, track, n) for track, n in (("A", 2), ("2", 3), ("3", 4))),
        ("t.gpx", gpx(trk(trackpoints(HERE[:9]) + "</trkseg><trkseg>" + trackpoints(HERE[:5] + 0.01))), "2", 5),
        ("t.csv", table(CIRCLE), "1", len(CIRCLE)),
    ],
)  # fmt: skip
def test_a_track_is_chosen_by_name_or_number(tmp_path: Path, name: str, text: str, track: str, count: int) -> None:
    """A name goes before a number; segments with a gap of 1 km are tracks of their own."""
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert len(read_path(tmp_path / name, track).places) == count


STRAIGHT = np.stack([np.arange(0.0, 200.0, 4.0), np.zeros(50)], axis=1)
TURN = 4.0 * np.stack([np.sin(np.arange(0.0, 3.1, 0.1)), 1.0 - np.cos(np.arange(0.0, 3.1, 0.1))], axis=1)
LINE = geodetic(STRAIGHT, GOTHENBURG)
BACK = np.concatenate([STRAIGHT[:40], STRAIGHT[10:39][::-1]])
TIGHT = np.concatenate([STRAIGHT[:10], TURN + STRAIGHT[9]])
GAP = np.concatenate([LINE[:20], LINE[20:] + np.array([0.005, 0.0])])
CORNER = np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 0.0], [40.0, 20.0], [40.0, 40.0]])


def climbing(height: Callable[[int], object]) -> str:
    points = (trackpoints(LINE[k : k + 1], f"<ele>{height(k)}</ele>") for k in range(len(LINE)))
    return gpx(trk("".join(points)))


def as_json(places: FloatArray) -> str:
    return json.dumps(line_string(places[:, ::-1].tolist()))


METRES = [[565_000 + 4 * k, 6_395_000] for k in range(40)]
REFUSED: dict[str, tuple[str, str | bytes, str]] = {  # with what the line says, in the words of the file
    "gap": ("gpx", gpx(trk(trackpoints(GAP))), "line 21 (lat 57.7000000, lon 11.9712746) and line 22 (lat 57.705"),
    "gap in JSON": ("geojson", as_json(GAP), "556.9 m between point 20 ([11.9712746, 57.7000000]) and point 21"),
    "gap in a table": ("csv", table(GAP, "lat,lon", form="{:.7f}"), "between line 21 (lat 57.7000000, lon 11.9712746)"),
    "way back": ("gpx", gpx(trk(trackpoints(geodetic(BACK, GOTHENBURG)))), "180 deg at line 41 (lat 57.7000000, lon"),
    "way back in a table": ("csv", table(BACK + SHIFTED[0]), "180 deg at line 41 (565206.00, 6395000.00)"),
    "corner": ("geojson", as_json(geodetic(CORNER, GOTHENBURG)), "aside between point 2 ([11.9703354, 57.7"),
    "too tight": ("csv", table(TIGHT), "near line 41 (36.96, "),
    "too narrow": ("csv", table(np.column_stack([STRAIGHT, 0 * STRAIGHT + 1.0]), "x,y,left_width,right_width"),
                   "too narrow from 0.0 m on, near line 2 (0.00, 0.00)"),
    "wall": ("gpx", climbing(lambda k: 20 * (k > 25)), "near line 27 (lat 57.7000000, lon 11.9716771)"),
    "height of a text": ("gpx", climbing(lambda k: "NaN" if k == 7 else 2), "line 9 (lat 57.7000000, lon 11.9704696)"),
    "height of an aircraft": ("gpx", climbing(lambda k: 123456), "elevation = 123456 must be within -10000 to 10000 m"),
    "some heights": ("gpx", climbing(lambda k: "" if k == 3 else 2), "line 5 (lat 57.7000000, lon 11.9702013) has"),
    "null height": ("geojson", as_json(np.insert(LINE, 0, 2.0, axis=1)).replace("2.0]", "null]", 1),
                    "49 of 50 points have a height, point 1 ([11.9700000, 57.7000000]) has none"),
    "blank height": ("csv", "x,y,z\n0,0,1\n20,0,\n40,0,2\n", "line 3: z = '' is not a finite number; course.h"),
    "several tracks": ("gpx", KNOWN, "choose one by course.track: 1 (2 m), 2 '7' (4 m), 3 'Gate & yard' (6 m)"),
    "several lines": ("geojson", LINES, "has 3 tracks, lines or segments far apart"),
    "segments far apart": ("gpx", gpx(trk(f"{trackpoints(LINE)}</trkseg><trkseg>{trackpoints(LINE + 1)}")), "1 (195"),
    "waypoints": ("gpx", gpx(trackpoints(LINE, tag="wpt")), "0 tracks, 0 routes and 50 waypoints"),
    "one point": ("gpx", gpx(trk(trackpoints(LINE[:1]))), "has no track or line of two points or more"),
    "latitude of 157": ("gpx", gpx(trk(trackpoints(LINE + 100.0))), "line 2: latitude = 157.7"),
    "US feet": ("geojson", collection(feature(line_string(METRES)), crs=crs("EPSG:2263")),
                "'EPSG:2263' (NAD83 / New York Long Island (ftUS)): must be in degrees (EPSG:4326) or metres"),
    "northing first": ("geojson", collection(feature(line_string([[y, x] for x, y in METRES])), crs=crs("EPSG:25832")),
                       "outside of the area of EPSG:25832: are easting and northing in its order"),
    "zone before": ("geojson", projected(32, GOTHENBURG, "EPSG:25832", 32e6), "without the number of a zone"),
    "another datum": ("geojson", collection(feature(line_string()), crs=crs("EPSG:4230")), "(ED50): must be"),
    "unknown system": ("geojson", collection(feature(line_string(METRES)), crs=crs("local")), "system is 'local'"),
    "linked system": ("geojson", collection(feature(line_string()), crs={"properties": {"href": "x"}}), "'href'"),
    "metres without a system": ("geojson", json.dumps(line_string(METRES)), "point 1: longitude = 565000 must be"),
    "polygon": ("geojson", json.dumps({"type": "Polygon", "coordinates": [LON_LAT]}), "it has 1 Polygon"),
    "other JSON": ("json", "[1, 2]", "must hold a JSON object"),
    "kilometres": ("csv", table(STRAIGHT, "x [km],y [km]"), "column 'x [km]' is in km: must be in m"),
    "degrees as x, y": ("csv", table(LINE, ""), "columns lat and lon"),
    "commas twice": ("csv", german(table(STRAIGHT, "x;y", ";")).replace(";", ","), "separate the columns by semi"),
    "two decimal signs": ("csv", "x;y\n0,5;0\n100;0.25\n", "line 2 has '0,5' and line 3 '0.25': write all"),
    "inconsistent groups": ("csv", "x;y\n1.234,5;0\n1.23;0\n", "line 3: '1.23' is no number: ',' is the decimal sign"),
    "index without a name": ("csv", table(NUMBERED, ""), "its first column counts the lines"),
    "four columns": ("csv", table(np.column_stack([STRAIGHT, STRAIGHT]), ""), "names no columns and it has 4"),
    "degrees and minutes": ("csv", "lat,lon\n57°42'00N,11°58'12E\n", "'57°42'00N' is not a finite number (decimal"),
    "x twice": ("csv", table(np.column_stack([STRAIGHT, STRAIGHT]), "x,y,X,Y"), "the columns 'x' and 'X' are both x"),
    "two pairs": ("csv", table(np.column_stack([STRAIGHT, LINE]), "x,y,lat,lon"), "and of lat or lon: keep one pair"),
    "latitude alone": ("csv", table(LINE, "lat,name"), "column 'lon' is missing"),
    "cut row": ("csv", "x,y\n0,0\n10\n", "line 3 has 1 values for 2 columns"),
    "null bytes": ("csv", b"x,y\n\x00\x01", "not a text in UTF-8"),
    "unknown track": ("gpx", KNOWN, "course.track = 9 is none of its 3 tracks"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_names_the_place_in_the_file(tmp_path: Path, case: str) -> None:
    """One line, with the line or number of the point and its coordinates as they are written there."""
    suffix, content, wanted = REFUSED[case]
    path = tmp_path / f"path.{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    track = "9" if case == "unknown track" else None
    options = PathOptions(kind="path", file=str(path), track=track)
    with pytest.raises(ValueError, match=r"^[^\n]{1,500}$") as refusal:
        options.course(load_vehicle("uk_longer_semitrailer").units[0], 4.0)
    assert path.name in str(refusal.value)
    assert wanted in str(refusal.value)


@pytest.mark.parametrize("case", ["wall", "height of a text", "height of an aircraft", "some heights", "null height"])
def test_heights_that_are_not_wanted_are_not_read(tmp_path: Path, case: str) -> None:
    suffix, content, _ = REFUSED[case]
    path = tmp_path / f"path.{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    course = PathOptions(kind="path", file=str(path), heights=False).course(
        load_vehicle("uk_longer_semitrailer").units[0], 4.0
    )
    assert course.relief is None
    assert course.length == pytest.approx(196.0, abs=0.01)


@pytest.mark.parametrize("where", [0, 30, 60])
@pytest.mark.parametrize(("jitter", "count"), [(0.0, 5), (0.05, 300), (0.4, 40), (0.4, 300), (1.0, 6)])
@pytest.mark.parametrize("spacing", [1.0, 3.0])
def test_a_standstill_is_one_point(where: int, jitter: float, count: int, spacing: float) -> None:
    """At the begin, on the way and at the end of a bend of 25 m: the path is as long as without, and keeps to it."""
    angles = np.arange(0.0, 61.0) * spacing / 40.0
    driven = 40.0 * np.stack([np.sin(angles), 1.0 - np.cos(angles)], axis=1)
    stood = driven[where] + jitter * np.random.default_rng(count).normal(size=(count, 2))
    points = np.concatenate([driven[:where], stood, driven[where:]])
    groups = standstills(points, 4.0)
    places = means(groups, points)
    fit = Fit(source="points", smoothing=8.0, tolerance=max(0.1, jitter), shortest=10.0)
    smooth, _ = fitted_path(PathPoints(places=places), fit)
    assert smooth.path.length == pytest.approx(60.0 * spacing, abs=max(0.1, 2.0 * jitter))
    assert np.ptp(groups) < 62


def test_what_is_driven_is_no_standstill() -> None:
    """Circles, reversals of more than some metres, and dense points with noise: no point is lost, or few."""
    assert len(np.unique(standstills(CIRCLE, 4.0))) == len(CIRCLE)
    assert len(np.unique(standstills(4.0 * CIRCLE / RADIUS, 4.0))) == len(CIRCLE)
    back = means(standstills(BACK, 4.0), BACK)
    assert np.abs(back[:, 0]).max() > 150.0  # the tip at 156 m stays within two spacings
    with pytest.raises(ValueError, match="turns back"):
        fitted_path(PathPoints(places=back), Fit(source="points", smoothing=8.0, tolerance=0.1, shortest=10.0))
