"""Read the points of a path from a file: CSV of x and y, a GPX track or route, a GeoJSON line; and XML files.

A document type is what lets an XML file define entities that grow without bound, or name other files and addresses. No
file of roads or tracks needs one, so it is refused.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import numpy as np

from scenarios.roads.crg_file import read_crg
from vehicle.foundation.data_file import Column, open_table
from vehicle.foundation.user_file import (
    MAX_ELEMENTS,
    MAX_NESTING,
    MAX_POINTS,
    FileKind,
    nearest,
    read_bytes,
    read_text,
    shown,
)
from vehicle.frames import FloatArray

_TEXT: Final = 10_000  # characters of an element's text that are kept


@dataclass(slots=True)
class Element:
    """An element; names are without the prefix of their namespace."""

    name: str
    attributes: dict[str, str]
    line: int  # in the file
    children: "list[Element]" = field(default_factory=list)
    text: str = ""

    def all(self, name: str) -> "list[Element]":
        """Its children of this name."""
        return [child for child in self.children if child.name == name]

    def first(self, name: str) -> "Element | None":
        """Its first child of this name; None if there is none."""
        return next((child for child in self.children if child.name == name), None)


def read_xml(path: Path, root: str) -> Element:
    """The root element of an XML file, which must have this name.

    Raises:
        ValueError: one line naming file and line, if the file cannot be read, is not XML, has a document type, too many
            elements or elements nested too deep, or another root.
    """
    content = read_bytes(path, FileKind.ROAD)
    builder = _Builder(path)
    try:
        builder.parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.errors.messages.get(error.code) or str(error)
        raise ValueError(f"{path}: not XML: line {error.lineno}: {shown(reason)}") from None
    except (LookupError, UnicodeError) as error:  # an encoding that Python does not know
        raise ValueError(f"{path}: not XML: {shown(str(error))}; save it as UTF-8") from None
    found = builder.top.children[0]
    if found.name != root:
        raise ValueError(f"{path}: its outermost element is <{shown(found.name, 40)}>: must be <{root}>")
    return found


class _Builder:
    """Builds the tree while expat parses."""

    def __init__(self, path: Path) -> None:
        self.top = Element("", {}, 0)
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._data
        self._path, self._count, self._stack = path, 0, [self.top]

    def _doctype(self, *_: object) -> None:
        raise ValueError(f"{self._path}: line {self.parser.CurrentLineNumber}: a document type (<!DOCTYPE) is refused")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise ValueError(f"{self._path}: has more than {MAX_ELEMENTS} elements")
        if len(self._stack) > MAX_NESTING:
            line = self.parser.CurrentLineNumber
            raise ValueError(f"{self._path}: line {line}: elements must be nested at most {MAX_NESTING} deep")
        element = Element(name.rpartition(":")[2], attributes, self.parser.CurrentLineNumber)
        self._stack[-1].children.append(element)
        self._stack.append(element)

    def _end(self, _: str) -> None:
        self._stack.pop()

    def _data(self, text: str) -> None:
        element = self._stack[-1]
        if len(element.text) < _TEXT:
            element.text += text[:_TEXT]


_A: Final = 6_378_137.0  # semi-major axis of WGS 84 [m]
_F: Final = 1.0 / 298.257223563  # its flattening
_E2: Final = _F * (2.0 - _F)  # square of its eccentricity


def tangent_plane(latitude: FloatArray, longitude: FloatArray, height: FloatArray) -> FloatArray:
    """Positions east and north (n, 2) [m] of points (n,) in degrees at heights above the ellipsoid [m].

    At 10 km from the middle distances are 12 mm too short by the curvature of the earth.
    """
    places = _geocentric(np.radians(latitude), np.radians(longitude), height)
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    lon = np.arctan2(middle[1], middle[0])
    # Bowring's first approximation of the geodetic latitude; near the ellipsoid it is right to 1e-9 rad.
    across = np.hypot(middle[0], middle[1])
    beta = np.arctan2(middle[2], (1.0 - _F) * across)
    lat = np.arctan2(
        middle[2] + _E2 / (1.0 - _E2) * (1.0 - _F) * _A * np.sin(beta) ** 3, across - _E2 * _A * np.cos(beta) ** 3
    )
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    plane: FloatArray = (places - middle) @ np.stack([east, north], axis=1)
    return plane


def _geocentric(lat: FloatArray, lon: FloatArray, height: FloatArray) -> FloatArray:
    """Earth-centred positions (n, 3) [m]."""
    n = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    across = (n + height) * np.cos(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), ((1.0 - _E2) * n + height) * np.sin(lat)], axis=1)


_COLUMNS: Final = {
    "x": Column("x", 1e8, "m"),  # any projected coordinates of the earth
    "y": Column("y", 1e8, "m"),
    "z": Column("z", 1e4, "m"),
    "bank": Column("bank", 0.2, "m/m"),  # a plane's limit, surface.cross_fall
    "left_width": Column("left_width", 100.0, "m"),
    "right_width": Column("right_width", 100.0, "m"),
    "friction": Column("friction", 1.5, "-"),
}
_LATITUDE, _LONGITUDE = Column("latitude", 90.0, "deg"), Column("longitude", 180.0, "deg")
_HEIGHT: Final = Column("elevation", 1e4, "m")
_READABLE: Final = ".csv, .gpx, .geojson, .json or .crg"
_CRG_SPACING: Final = 1.0  # of the points of a measured surface's reference line [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathPoints:
    """Points of a path in a plane, and what is known of the road there; None where the file does not say."""

    places: FloatArray  # (n, 2) [m]
    heights: FloatArray | None = None  # (n,) [m]
    banks: FloatArray | None = None  # (n,) rise of the road to the left [-]
    widths: FloatArray | None = None  # (n, 2) of the road to the left and right of the path [m]
    friction: FloatArray | None = None  # (n,) [-]
    lanes: FloatArray | None = None  # (n, 2) from the path to the left and right border of the lane [m]
    paved: FloatArray | None = None  # (n, 2) to the edges of the paved road that is seen, where it is wider [m]
    lines: FloatArray | None = None  # (n, k, 2) painted on the road: place to the left of the path [m], 1 if broken
    remarks: tuple[str, ...] = ()  # what a user should know of the file, a line each


def read_path(path: Path) -> PathPoints:
    """Points of a path; the ending of the file's name decides its format.

    Raises:
        ValueError: one line naming file, place, value and limit.
    """
    reader = {
        ".csv": _read_csv,
        ".gpx": _read_gpx,
        ".geojson": _read_geojson,
        ".json": _read_geojson,
        ".crg": _read_reference_line,
    }.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: the name of a file of a path must end with {_READABLE}")
    points = reader(path)
    count = len(points.places)
    if not 2 <= count <= MAX_POINTS:
        raise ValueError(f"{path}: has {count} points: a path must have 2 to {MAX_POINTS}")
    return points


def _read_csv(path: Path) -> PathPoints:
    table = open_table(path)
    for name in table.names:
        if name not in _COLUMNS:
            raise ValueError(
                f"{path}: unknown column '{name}'{nearest(name, _COLUMNS)} (the first line names the columns, with "
                "commas between them)"
            )
    wanted = tuple(dict.fromkeys(("x", "y", *table.names)))
    numbers = table.numbers([_COLUMNS[name] for name in wanted])
    columns = dict(zip(wanted, numbers.T, strict=True))
    sides = [name for name in ("left_width", "right_width") if name in columns]
    if len(sides) == 1:
        raise ValueError(f"{path}: has a column '{sides[0]}' only: give left_width and right_width, or neither")
    for name, low in (("left_width", 0.0), ("right_width", 0.0), ("friction", 0.05)):
        if name in columns and len(numbers) and columns[name].min() < low:
            line = int(np.argmin(columns[name])) + 2
            raise ValueError(f"{path}: line {line}: {name} = {columns[name].min():g} must be at least {low:g}")
    return PathPoints(
        places=np.column_stack([columns["x"], columns["y"]]),
        heights=columns.get("z"),
        banks=columns.get("bank"),
        widths=np.column_stack([columns[side] for side in sides]) if sides else None,
        friction=columns.get("friction"),
    )


def _read_reference_line(path: Path) -> PathPoints:
    """The reference line of an OpenCRG file; its heights are those of ``surface.crg``."""
    surface = read_crg(path)
    return PathPoints(places=surface.line[:: max(1, round(_CRG_SPACING / surface.line_step))])


def _read_gpx(path: Path) -> PathPoints:
    root = read_xml(path, "gpx")
    tracks, routes = root.all("trk"), root.all("rte")
    if len(tracks) + len(routes) != 1:
        raise ValueError(f"{path}: has {len(tracks)} tracks and {len(routes)} routes: must be one of them")
    segments = [*routes, *(segment for track in tracks for segment in track.all("trkseg"))]
    points = [point for segment in segments for point in segment.children if point.name in ("trkpt", "rtept")]
    return _on_earth(path, [_gpx_point(path, point) for point in points])


def _gpx_point(path: Path, point: Element) -> tuple[float, float, float | None]:
    place = f"{path}: line {point.line}"
    missing = next((name for name in ("lat", "lon") if name not in point.attributes), None)
    if missing:
        raise ValueError(f"{place}: a point has no attribute '{missing}'")
    height = point.first("ele")
    return (
        _LONGITUDE.number(point.attributes["lon"], place),
        _LATITUDE.number(point.attributes["lat"], place),
        None if height is None else _HEIGHT.number(height.text, place),
    )


def _read_geojson(path: Path) -> PathPoints:
    text = read_text(path, FileKind.ROAD)
    try:
        table = json.loads(text)
    except RecursionError:
        raise ValueError(f"{path}: tables and lists must be nested at most {MAX_NESTING} deep") from None
    except ValueError as error:  # also an integer of thousands of digits
        raise ValueError(f"{path}: not JSON: {shown(str(error))}") from None
    lines = list(_lines(table))
    if len(lines) != 1:
        raise ValueError(f"{path}: has {len(lines)} lines (geometries of type LineString): must be one")
    positions = lines[0].get("coordinates")
    if not isinstance(positions, list):
        raise ValueError(f"{path}: the line has no list of coordinates")
    return _on_earth(path, [_position(path, k, position) for k, position in enumerate(positions, start=1)])


def _lines(node: Any) -> Iterator[dict[str, Any]]:
    """All lines of a GeoJSON object: itself, or those in its features."""
    features = node.get("features", [node]) if isinstance(node, dict) else []
    for feature in features if isinstance(features, list) else []:
        geometry = feature.get("geometry", feature) if isinstance(feature, dict) else None
        if isinstance(geometry, dict) and geometry.get("type") == "LineString":
            yield geometry


def _position(path: Path, number: int, position: Any) -> tuple[float, float, float | None]:
    place = f"{path}: point {number}"
    if not isinstance(position, list) or len(position) < 2:
        raise ValueError(f"{place}: {shown(repr(position), 40)} must be a list of longitude, latitude and height")
    longitude, latitude, *height = (repr(value) for value in position[:3])
    return (
        _LONGITUDE.number(longitude, place),
        _LATITUDE.number(latitude, place),
        _HEIGHT.number(height[0], place) if height else None,
    )


def _on_earth(path: Path, points: Sequence[tuple[float, float, float | None]]) -> PathPoints:
    """Points by longitude, latitude [deg] and height [m], which all of them or none must have."""
    if not points:
        return PathPoints(places=np.empty((0, 2)))
    known = [height for *_, height in points if height is not None]
    if known and len(known) < len(points):
        raise ValueError(f"{path}: {len(known)} of {len(points)} points have a height: give it for all or none")
    heights = np.array(known) if known else np.zeros(len(points))
    plan = np.array([point[:2] for point in points])
    places = tangent_plane(plan[:, 1], plan[:, 0], np.full(len(points), heights.mean()))
    return PathPoints(places=places, heights=heights if known else None)
