"""Read the points of a path from a file: a table, a GPX track or route, a GeoJSON line; and XML files.

A document type is what lets an XML file define entities that grow without bound, or name other files and addresses. No
file of roads or tracks needs one, so it is refused.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.parsers import expat

import numpy as np

from scenarios.roads.crg_file import read_crg_line
from scenarios.roads.earth import coordinate_system, from_metres, tangent_plane
from scenarios.roads.placement import DEGREES, UNPLACED, Placement
from scenarios.roads.point_table import EAST, HEIGHT, LATITUDE, LONGITUDE, NORTH, read_points
from scenarios.roads.standstill import means, standstills
from vehicle.foundation.user_file import (
    MAX_ELEMENTS,
    MAX_NESTING,
    MAX_POINTS,
    FileKind,
    read_bytes,
    read_json,
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
    things: tuple[FloatArray, ...] = ()  # outlines (m, 2) of kerbs, islands and signals beside the path [m]
    remarks: tuple[str, ...] = ()  # what a user should know of the file, a line each
    rows: FloatArray | None = None  # (n,) of the points in the file; with a fraction where several were averaged
    where: Callable[[int], str] | None = None  # place of a row in the file and the coordinates there, for messages
    placement: Placement = UNPLACED  # of the plane in the coordinates of the file

    def changed(self, change: Callable[[FloatArray], FloatArray]) -> "PathPoints":
        """The points with each of their arrays that is known changed."""
        known: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        changed: dict[str, Any] = {name: change(one) for name, one in known.items() if isinstance(one, np.ndarray)}
        return replace(self, **changed)

    def named(self, k: int) -> str:
        """Point k in messages."""
        if self.where is None or self.rows is None:
            return "the point ({:.2f}, {:.2f})".format(*self.places[k])
        return self.where(round(float(self.rows[k])))


TRACK: Final = "Track of a GPX file or line of a GeoJSON file, by name or number; not given: the only one."
_STANDING: Final = 0.5  # reach of a standstill per smoothing length
_FARTHEST: Final = 6.0  # reach of a standstill [m]: trucks turn back in 12 m
READABLE: Final = ".csv, .gpx, .geojson, .json or .crg"
_CRG_SPACING: Final = 1.0  # of the points of a measured surface's reference line [m]
_METRES: Final = "line {} ({:.2f}, {:.2f})"


def read_path(path: Path, track: str | None = None, *, heights: bool = True, smoothing: float = 0.0) -> PathPoints:
    """Points of a path; the ending of the file's name decides its format.

    Args:
        path: of the file.
        track: name or number of a track, route or line; None: the only one.
        heights: False: heights and banks are not read.
        smoothing: of the path [m], which says how far apart the points of a standstill may be; 0: all are kept.

    Raises:
        ValueError: one line naming file, place, value and limit.
    """
    suffix = path.suffix.lower()
    if suffix in (".gpx", ".geojson", ".json"):
        points = _on_earth(path, _chosen(path, tracks_in(path), track), heights=heights)
    elif suffix not in (".csv", ".crg"):
        raise ValueError(f"{path}: the name of a file of a path must end with {READABLE}")
    elif track not in (None, "1"):
        raise ValueError(f"{path}: course.track = {shown(track, 40)}: a file {suffix} has one path only")
    else:
        points = _read_csv(path, heights=heights) if suffix == ".csv" else _read_reference_line(path)
    count = len(points.places)
    if not 2 <= count <= MAX_POINTS:
        raise ValueError(f"{path}: has {count} points: a path must have 2 to {MAX_POINTS}")
    if smoothing:
        groups = standstills(points.places, min(_STANDING * smoothing, _FARTHEST))
        joined = count - int(groups[-1]) - 1
        if joined:
            place = points.named(int(np.flatnonzero(np.diff(groups) == 0)[0]))
            remark = f"course.file: {joined} points that make no headway were joined with others, the first at {place}"
            points = replace(points.changed(lambda values: means(groups, values)), remarks=(remark,))
    return points


def _read_csv(path: Path, *, heights: bool) -> PathPoints:
    columns, lines = read_points(path, heights=heights)
    known = {name: columns.get(name) for name in ("z", "bank", "left_width", "right_width", "friction")}
    height, bank, left, right, friction = known.values()
    on_earth = "lat" in columns
    first, second = (columns[name] for name in (("lat", "lon") if on_earth else ("x", "y")))
    places, placement = np.column_stack([first, second]), UNPLACED
    if on_earth:
        places, placement = _plane(first, second, height, DEGREES)
    return PathPoints(
        places=places,
        placement=placement,
        heights=height,
        banks=bank,
        widths=None if left is None or right is None else np.column_stack([left, right]),
        friction=friction,
        rows=np.arange(float(len(lines))),
        where=lambda row: (_DEGREES if on_earth else _METRES).format(int(lines[row]), first[row], second[row]),
    )


def _plane(
    latitude: FloatArray, longitude: FloatArray, height: FloatArray | None, crs: str
) -> tuple[FloatArray, Placement]:
    if not len(latitude):
        return np.empty((0, 2)), UNPLACED
    middle = 0.0 if height is None else float(height.mean())
    places, plane = tangent_plane(latitude, longitude, np.full(len(latitude), middle))
    return places, Placement(crs=crs, plane=plane)


def _read_reference_line(path: Path) -> PathPoints:
    """The reference line of an OpenCRG file; its heights are those of ``surface.crg``."""
    line, step = read_crg_line(path)
    every = max(1, round(_CRG_SPACING / step))
    line = line[::every]
    return PathPoints(
        places=line,
        rows=np.arange(float(len(line))),
        where=lambda row: "u = {:.2f} m ({:.2f}, {:.2f})".format(row * every * step, *line[row]),
    )


_DEGREES: Final = "line {} (lat {:.7f}, lon {:.7f})"
_JOINED: Final = 250.0  # between segments of one track [m], as between the points of a path
_TOUCHING: Final = 1.0  # between parts of one line [m]
_RADIUS: Final = 6_371e3  # of the earth [m]
_LISTED: Final = 20  # tracks in a message


class Point(NamedTuple):
    """A point as it is in a file."""

    number: int  # line of the file, or number in its track
    x: float  # longitude [deg] or easting [m]
    y: float  # latitude [deg] or northing [m]
    height: object  # as it is written, None: not at all


class Track(NamedTuple):
    """A track, route or line of a file."""

    name: str  # empty: it has none
    points: list[Point]
    system: str | None  # of metres; None: degrees
    wording: str  # of a point in messages

    @property
    def length(self) -> float:
        """Length within some per cent [m]."""
        return sum(_distance(*pair, self.system) for pair in pairwise(self.points))


def _distance(a: Point, b: Point, system: str | None) -> float:
    if system is not None:
        return math.hypot(b.x - a.x, b.y - a.y)
    east = math.cos(math.radians(a.y)) * math.remainder(b.x - a.x, 360.0)
    return _RADIUS * math.radians(math.hypot(east, b.y - a.y))


def on_one_plane(tracks: Sequence[Track]) -> list[FloatArray]:
    """Places (n, 2) [m] of the points of each track, on the plane that touches the earth in the middle of all."""
    degrees = []
    for track in tracks:
        x, y = np.array([point[1:3] for point in track.points], dtype=np.float64).T
        degrees.append(np.stack((y, x) if track.system is None else from_metres(track.system, x, y), axis=1))
    latitude, longitude = np.concatenate(degrees).T
    places, _ = _plane(latitude, longitude, None, DEGREES)
    return np.split(places, np.cumsum([len(track.points) for track in tracks])[:-1])


def tracks_in(path: Path) -> list[Track]:
    """Tracks, routes or lines of two points or more in a GPX or GeoJSON file, in its order.

    Raises:
        ValueError: one line naming file, place and value.
    """
    tracks = _read_gpx(path) if path.suffix.lower() == ".gpx" else _read_geojson(path)
    return [track for track in tracks if len(track.points) > 1]


def _chosen(path: Path, tracks: Sequence[Track], wanted: str | None) -> Track:
    """The track of a name or number, or the only one."""
    named = [track for track in tracks if track.name == wanted]
    if wanted is not None and len(named) != 1 and wanted.isdecimal():
        named = list(tracks[int(wanted) - 1 : int(wanted)]) if 0 < int(wanted[:9]) <= len(tracks) else []
    if (wanted is None and len(tracks) == 1) or len(named) == 1:
        return named[0] if named else tracks[0]
    names = [f" '{shown(one.name, 40)}'" if one.name else "" for one in tracks[:_LISTED]]
    rows = [f"{k + 1}{name} ({tracks[k].length:.0f} m)" for k, name in enumerate(names)]
    there = f"{', '.join(rows)}{', ...' * (len(tracks) > _LISTED)}"
    if not tracks:
        raise ValueError(f"{path}: has no track or line of two points or more")
    if wanted is not None:
        raise ValueError(f"{path}: course.track = {shown(wanted, 40)} is none of its {len(tracks)} tracks: {there}")
    raise ValueError(
        f"{path}: has {len(tracks)} tracks, lines or segments far apart: choose one by course.track: {there}"
    )


def _joined(parts: Iterable[list[Point]], like: Track, gap: float) -> Iterator[Track]:
    """Parts of one track whose ends are within a ``gap`` [m] as one, others as tracks of their own."""
    whole = list(like.points)
    for part in (part for part in parts if part):
        if whole and _distance(whole[-1], part[0], like.system) > gap:
            yield like._replace(points=whole)
            whole = []
        whole.extend(part[bool(whole) and whole[-1][1:3] == part[0][1:3] :])
    yield like._replace(points=whole)


def _read_gpx(path: Path) -> Iterator[Track]:
    root = read_xml(path, "gpx")
    whole = [*root.all("trk"), *root.all("rte")]
    if not any(part.first("trkpt") or part.first("rtept") for one in whole for part in (one, *one.all("trkseg"))):
        raise ValueError(
            f"{path}: has {len(root.all('trk'))} tracks, {len(root.all('rte'))} routes and {len(root.all('wpt'))} "
            "waypoints: a path needs a track or route with points, waypoints have no order"
        )
    for one in whole:
        name = one.first("name")
        parts = one.all("trkseg") if one.name == "trk" else [one]
        points = ([_gpx_point(path, p) for p in part.children if p.name in ("trkpt", "rtept")] for part in parts)
        yield from _joined(points, Track(name.text.strip() if name else "", [], None, _DEGREES), _JOINED)


def _gpx_point(path: Path, point: Element) -> Point:
    place = f"{path}: line {point.line}"
    missing = next((name for name in ("lat", "lon") if name not in point.attributes), None)
    if missing:
        raise ValueError(f"{place}: a point has no attribute '{missing}'")
    height = point.first("ele")
    return Point(
        point.line,
        LONGITUDE.number(point.attributes["lon"], place),
        LATITUDE.number(point.attributes["lat"], place),
        height.text.strip() or None if height else None,
    )


def _read_geojson(path: Path) -> Iterator[Track]:
    geometries = list(_geometries(path, read_json(path, FileKind.ROAD, constants=True), _Above()))
    kinds = [str(geometry.get("type")) for geometry, _ in geometries]
    lines = [one for one, kind in zip(geometries, kinds, strict=True) if kind in _LINES]
    if not lines and kinds.count("Point") > 1:  # a feature each, in the order of driving
        corners = [geometry.get("coordinates") for geometry, _ in geometries if geometry.get("type") == "Point"]
        lines = [({"type": "MultiPoint", "coordinates": corners}, geometries[0][1])]
    if not lines:
        there = ", ".join(f"{kinds.count(kind)} {shown(kind, 40)}" for kind in dict.fromkeys(kinds)) or "no geometry"
        raise ValueError(f"{path}: has no line (LineString, MultiLineString or MultiPoint); it has {there}")
    for geometry, above in lines:
        system, parts = _system(path, above.crs), geometry.get("coordinates")
        parts = parts if geometry["type"] == "MultiLineString" else [parts]
        if not isinstance(parts, list) or not all(isinstance(part, list) for part in parts):
            raise ValueError(f"{path}: the line has no list of coordinates")
        number = itertools.count(1)
        points = [[_position(path, next(number), one, system) for one in part] for part in parts]
        like = Track(above.name, [], system, "point {} ([{:.2f}, {:.2f}])" if system else "point {} ([{:.7f}, {:.7f}])")
        yield from _joined(points, like, _TOUCHING)


_LINES: Final = ("LineString", "MultiLineString", "MultiPoint")


class _Above(NamedTuple):
    """What the objects around a geometry say of it."""

    name: str = ""
    crs: Any = None


def _geometries(path: Path, node: Any, above: _Above, depth: int = 0) -> Iterator[tuple[dict[str, Any], _Above]]:
    """All geometries of a GeoJSON object: itself, or those of its features and collections."""
    if not isinstance(node, dict):
        return
    if depth > MAX_NESTING:
        raise ValueError(f"{path}: tables and lists must be nested at most {MAX_NESTING} deep")
    own = node.get("properties")
    own = {str(key).lower(): value for key, value in own.items()} if isinstance(own, dict) else {}
    name = own.get("name", node.get("id", above.name))
    above = _Above("" if name is None else str(name).strip(), node.get("crs", above.crs))
    inner = [node.get(key) for key in ("features", "geometry", "geometries") if key in node]
    if not inner and "type" in node:
        yield node, above
    for child in (one for part in inner for one in (part if isinstance(part, list) else [part])):
        yield from _geometries(path, child, above, depth + 1)


def _system(path: Path, crs: Any) -> str | None:
    """Coordinate system that a GeoJSON file names; None: degrees."""
    stated = crs.get("properties") if isinstance(crs, dict) else {"name": crs} if isinstance(crs, str) else crs
    if stated is None:
        return None
    code = stated.get("code") if isinstance(stated, dict) else None
    try:
        return coordinate_system(str(stated.get("name", crs)) if code is None else f"EPSG:{code}")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _position(path: Path, number: int, position: Any, system: str | None) -> Point:
    place = f"{path}: point {number}"
    if not isinstance(position, list) or len(position) < 2:
        raise ValueError(f"{place}: {shown(repr(position), 40)} must be a list of longitude, latitude and height")
    columns = (LONGITUDE, LATITUDE) if system is None else (EAST, NORTH)
    try:
        x, y = (column.number(repr(value), place) for column, value in zip(columns, position[:2], strict=True))
    except ValueError as error:
        metres = system is None and "must be within" in str(error)
        hint = "; metres need a crs that names their system, such as EPSG:25832; or save it with EPSG:4326"
        raise ValueError(f"{error}{hint * metres}") from None
    return Point(number, x, y, position[2] if len(position) > 2 else None)


def _on_earth(path: Path, track: Track, *, heights: bool) -> PathPoints:
    """Points of a track, with heights if they are wanted and all points have one."""
    points = track.points
    x, y = (np.array([point[k] for point in points]) for k in (1, 2))
    height: FloatArray | None = None

    def where(row: int) -> str:
        number, *coordinates, _ = points[row]
        return track.wording.format(number, *(coordinates[::-1] if track.wording == _DEGREES else coordinates))

    missing = next((k for k, point in enumerate(points) if point.height is None), None)
    if heights and not all(point.height is None for point in points):
        if missing is not None:
            known = sum(point.height is not None for point in points)
            raise ValueError(
                f"{path}: {known} of {len(points)} points have a height, {where(missing)} has none: give all of them "
                "one, or drive it level by course.heights = false"
            )
        height = np.array([HEIGHT.number(str(point.height), f"{path}: {where(k)}") for k, point in enumerate(points)])
    try:
        latitude, longitude = (y, x) if track.system is None else from_metres(track.system, x, y)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    places, placement = _plane(latitude, longitude, height, track.system or DEGREES)
    rows = np.arange(float(len(points)))
    return PathPoints(places=places, heights=height, rows=rows, where=where, placement=placement)
