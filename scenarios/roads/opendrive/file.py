"""Read the roads of an OpenDRIVE file."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from scenarios.roads.opendrive.network import (
    JUNCTION,
    Connection,
    Contact,
    CrossSections,
    Cubics,
    Fault,
    Geometry,
    Lane,
    LineKind,
    Link,
    Network,
    ReferenceLine,
    Road,
    RoadMarks,
    Section,
    Span,
    Thing,
    clothoid,
    parametric,
    polynomial,
)
from scenarios.roads.path_file import Element, read_xml
from scenarios.roads.placement import UNPLACED, Placement
from vehicle.foundation.data_file import Column
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray, Pose2

_GAP: Final = 0.1  # largest distance between two pieces of a reference line [m]: files are rounded to millimetres
_LARGEST: Final = 1e8  # number of any kind: projected coordinates of the earth [m]
_CURVATURE: Final = Column("curvature", 10.0, "1/m")
_LENGTH: Final = Column("length", 1e6, "m")
T = TypeVar("T")
_CUBIC: Final = ("a", "b", "c", "d")


def read_opendrive(path: Path) -> Network:
    """Roads and junctions of a file; what is wrong with one of them matters where it is driven, and names the line.

    Raises:
        ValueError: one line naming file and line, if it is not such a file.
    """
    root = read_xml(path, "OpenDRIVE")
    elements = root.all("road")
    if not elements:
        raise ValueError(f"{path}: has no <road>")
    reader, broken = _Reader(), dict[str, str]()
    roads = _by_id(elements, reader.road, "", broken)
    junctions = _by_id(root.all("junction"), reader.connections, JUNCTION, broken)
    return Network(roads, junctions, broken, _placement(root.first("header")))


def _placement(header: Element | None) -> Placement:
    """The projection of the header, whose coordinates are those of the file moved and turned by its offset."""
    reference = header.first("geoReference") if header else None
    if header is None or reference is None or not reference.text.strip():
        return UNPLACED
    offset, reader = header.first("offset"), _Reader()
    moved = [reader.number_or(offset, name, 0.0) if offset else 0.0 for name in ("x", "y", "hdg")]
    return Placement(X_FW=Pose2(*moved), crs=reference.text.strip())


def _by_id(elements: list[Element], read: Callable[[Element], T], kind: str, broken: dict[str, str]) -> dict[str, T]:
    """What is read of elements, by their ids; those that are wrong are added to ``broken``."""
    found: dict[str, T] = {}
    for element in elements:
        name = element.attributes.get("id", "")
        if name in found or kind + name in broken:
            found.pop(name, None)
            broken[kind + name] = f"line {element.line}: two {element.name}s have the id '{shown(name, 40)}'"
            continue
        try:
            found[name] = read(element)
        except ValueError as error:
            broken[kind + name] = str(error)
    return found


class _Reader:
    """Reads elements, and names the line of what is wrong."""

    def __init__(self) -> None:
        self._faults: list[Fault] = []  # of the road that is read
        self._of = ""  # the road or junction that is read, for messages

    def road(self, element: Element) -> Road:
        """A road with its lanes."""
        self._faults = []
        self._begin(element)
        lanes, reference = self._child(element, "lanes"), self._reference(element)
        link = element.first("link")
        drives_left = element.attributes.get("rule", "RHT") == "LHT"
        level, across = (element.first(name) for name in ("elevationProfile", "lateralProfile"))
        whole = Fault(0.0, reference.length, "")
        heights = whole._replace(of_heights=True)
        junction = element.attributes.get("junction", "-1")
        return Road(
            id=self.text(element, "id"),
            junction=None if junction in ("-1", "") else junction,
            reference=reference,
            elevation=self._cubics(level.all("elevation") if level else (), "s", heights),
            superelevation=self._cubics(across.all("superelevation") if across else (), "s", heights),
            cross_sections=self._cross_sections(across, heights),
            lane_offset=self._cubics(lanes.all("laneOffset"), "s", whole),
            sections=self._sections(lanes, reference.length, drives_left=drives_left),
            predecessor=self._link(link, "predecessor"),
            successor=self._link(link, "successor"),
            faults=tuple(self._faults),
            things=partial(self._things, element, reference),
        )

    def connections(self, element: Element) -> tuple[Connection, ...]:
        """Ways through a junction."""
        self._begin(element)
        connections = []
        for one in element.all("connection"):
            road = one.attributes.get("connectingRoad") or one.attributes.get("linkedRoad")
            incoming = one.attributes.get("incomingRoad")
            if road is None or incoming is None:  # of a virtual junction, whose roads say where they join
                continue
            pairs = [tuple(self._whole(link, name) for name in ("from", "to")) for link in one.all("laneLink")]
            lanes = {lane: tuple(to for begin, to in pairs if begin == lane) for lane, _ in pairs}
            connections.append(Connection(incoming, road, self._contact(one), lanes))
        return tuple(connections)

    def _begin(self, element: Element) -> None:
        """Name a road or a junction in messages from now on."""
        self._of = ""
        self._of = f"{element.name} {shown(self.text(element, 'id'), 40)}: "

    def text(self, element: Element, name: str) -> str:
        """An attribute that must be there."""
        if name not in element.attributes:
            raise self._error(element, f"{_tag(element)} has no attribute '{name}'")
        return element.attributes[name]

    def _geometry(self, element: Element) -> Geometry:
        length = self._number(element, "length", _LENGTH)
        if not length > 0.0:
            raise self._error(element, f"length = {length:g} m of a <geometry> must be positive")
        shapes = [shape for shape in element.children if shape.name in _SHAPES]
        if len(shapes) != 1:
            raise self._error(element, f"a <geometry> has {len(shapes)} shapes: must be one of {', '.join(_SHAPES)}")
        shape = shapes[0]
        try:
            if shape.name == "poly3":
                local = polynomial(np.array([self._number(shape, name) for name in _CUBIC]), length)
            elif shape.name == "paramPoly3":
                u, v = (np.array([self._number(shape, name + axis) for name in _CUBIC]) for axis in "UV")
                local = parametric(u, v, self._range(shape, length) / length)
            else:
                start, end = (self._number(shape, name, _CURVATURE) if name else 0.0 for name in _SHAPES[shape.name])
                local = clothoid(length, start, end)
        except ValueError as error:
            raise error if str(error).startswith("line ") else self._error(shape, str(error)) from None
        return Geometry(
            s=self._number(element, "s"),
            start=Pose2(*(self._number(element, name) for name in ("x", "y", "hdg"))),
            length=length,
            local=local,
            line=element.line,
        )

    def _range(self, shape: Element, length: float) -> float:
        """Parameter at the end of a paramPoly3."""
        kind = shape.attributes.get("pRange", "normalized")
        if kind not in ("arcLength", "normalized"):
            raise self._error(shape, f"pRange = '{shown(kind, 40)}' must be arcLength or normalized")
        return length if kind == "arcLength" else 1.0

    def _reference(self, road: Element) -> ReferenceLine:
        """The pieces of a road; those of length 0 are left out."""
        plan = self._child(road, "planView")
        elements = sorted(((self._number(one, "s"), one) for one in plan.all("geometry")), key=lambda row: row[0])
        if not elements:
            raise self._error(plan, "has no <geometry>")
        pieces: list[Geometry] = []
        for (s, element), end in zip(elements, [*(s for s, _ in elements[1:]), math.inf], strict=True):
            try:
                if self._number(element, "length", _LENGTH) != 0.0:
                    pieces.append(self._geometry(element))
            except ValueError as error:
                self._faults.append(Fault(s, end, str(error)))
        if not pieces:
            raise ValueError(self._faults[0].text) if self._faults else self._error(plan, "has no length")
        length, begin = pieces[-1].s + pieces[-1].length, elements[0][0]
        if self._faults:  # the last piece may be one of those that cannot be read
            length = max(length, *(one.begin + _GAP for one in self._faults), self.number_or(road, "length", 0.0))
        reference = ReferenceLine(tuple(pieces), length)
        if abs(begin) > _GAP:
            raise self._error(elements[0][1], f"its first geometry is at s = {begin:g} m: must be 0")
        for before, after, gap in zip(pieces[:-1], pieces[1:], reference.gaps().tolist(), strict=True):
            at, place = after.s, f"line {after.line}: {self._of}"
            end = before.s + before.length
            if abs(end - at) > _GAP:
                text = f"the geometry before ends at s = {end:.3f} m, this one begins at {at:.3f} m"
                self._faults.append(Fault(min(end, at), max(end, at), place + text))
            elif not gap <= _GAP:
                text = f"a gap of {gap:.3g} m in the reference line at s = {at:.1f} m, "
                text += f"({after.start.x:.2f}, {after.start.y:.2f}): must be at most {_GAP:g} m"
                self._faults.append(Fault(at, at, place + text))
        return reference

    def _sections(self, lanes: Element, length: float, *, drives_left: bool) -> tuple[Section, ...]:
        starts = sorted(((self._number(one, "s"), one) for one in lanes.all("laneSection")), key=lambda row: row[0])
        if not starts:
            raise self._error(lanes, "has no <laneSection>")
        if not 0.0 <= starts[0][0] < length:
            raise self._error(
                lanes,
                f"has lane sections from s = {starts[0][0]:g} to {starts[-1][0]:g} m: must be within its "
                f"length of {length:g} m",
            )
        starts = [(s, one) for s, one in starts if s < length]
        if starts[0][0] > _GAP:
            text = f"has no lanes before s = {starts[0][0]:g} m"
            self._faults.append(Fault(0.0, starts[0][0], str(self._error(starts[0][1], text))))
        starts[0] = (0.0, starts[0][1])
        ends = [*(s for s, _ in starts[1:]), length]
        return tuple(
            self._section(one, Span(s, end), drives_left=drives_left)
            for (s, one), end in zip(starts, ends, strict=True)
        )

    def _section(self, element: Element, span: Span, *, drives_left: bool) -> Section:
        beside, middle = (
            [lane for name in names for side in element.all(name) for lane in side.all("lane")]
            for names in (("left", "right"), ("center",))
        )
        lanes: dict[int, Lane] = {}
        marks: dict[int, RoadMarks] = {}
        for one in beside + middle:
            number = None
            try:
                number = self._whole(one, "id")
                if number in lanes:
                    raise self._error(one, f"two lanes of a section have the id {number}")
                if one.first("roadMark"):
                    marks[number] = self._marks(one)
                if number:
                    lanes[number] = self._lane(one, number, span, drives_left=drives_left)
            except ValueError as error:
                self._faults.append(Fault(*span, str(error), number))
        return Section(s=span.begin, end=span.end, lanes=lanes, marks=marks)

    def _marks(self, lane: Element) -> RoadMarks:
        rows = sorted(
            (
                self._number(mark, "sOffset") if "sOffset" in mark.attributes else 0.0,
                _line_kind(mark.attributes.get("type", "none")),
            )
            for mark in lane.all("roadMark")
        )
        return RoadMarks(np.array([begin for begin, _ in rows]), np.array([kind for _, kind in rows]))

    def _lane(self, element: Element, number: int, span: Span, *, drives_left: bool) -> Lane:
        link, kind = element.first("link"), element.attributes.get("type", "none")
        if abs(number) > 100:
            raise self._error(element, f"lane id = {number} must be within -100 to 100")
        is_border = element.first("width") is None and element.first("border") is not None
        usual = 1 if (number < 0) != drives_left else -1
        stated = self._travel(element, usual)
        return Lane(
            id=number,
            kind=kind,
            width=self._cubics(element.all("border" if is_border else "width"), "sOffset", Fault(*span, "", number)),
            is_border=is_border,
            travel=stated or usual,
            both_ways=stated == 0 or kind == "bidirectional",
            stated=stated is not None,
            predecessors=self._lane_links(link, "predecessor"),
            successors=self._lane_links(link, "successor"),
        )

    def _travel(self, lane: Element, usual: int) -> int | None:
        """Direction of travel of a lane along the reference line, 0 for both; None: the file does not say."""
        direction = lane.attributes.get("direction")
        if direction is not None:  # OpenDRIVE 1.8
            found = {"standard": usual, "reversed": -usual, "both": 0}.get(direction)
            if found is None:
                raise self._error(lane, f"direction = '{shown(direction, 40)}' must be standard, reversed or both")
            return found
        notes = [note for data in lane.all("userData") for note in data.all("vectorLane")]  # of RoadRunner
        words = {"forward": 1, "backward": -1, "bidirectional": 0}
        return words.get(notes[0].attributes.get("travelDir", "")) if notes else None

    def _lane_links(self, link: Element | None, name: str) -> tuple[int, ...]:
        return tuple(self._whole(element, "id") for element in (link.all(name) if link else ()))

    def _link(self, link: Element | None, name: str) -> Link | None:
        element = link.first(name) if link is not None else None
        if element is None:
            return None
        is_junction = element.attributes.get("elementType") == "junction"
        name = element.attributes.get("elementId", f"without elementId in line {element.line}")
        s = self._number(element, "elementS") if "elementS" in element.attributes else None
        return Link(is_junction, name, self._contact(element), element.line, s)

    def _contact(self, element: Element) -> Contact | None:
        contact = element.attributes.get("contactPoint")
        return "start" if contact == "start" else "end" if contact == "end" else None

    def _things(self, road: Element, line: ReferenceLine) -> Iterator[Thing]:
        """Signals and objects; those that are wrong are left out, since nothing drives on them."""
        groups = [group for name in ("signals", "objects") for group in road.all(name)]
        for one in (one for group in groups for one in group.children if one.name in ("signal", "object")):
            try:
                yield Thing(
                    "signal" if one.name == "signal" else one.attributes.get("type", ""), self._outline(one, line)
                )
            except ValueError:
                continue

    def _outline(self, thing: Element, line: ReferenceLine) -> FloatArray:
        """Outline of a thing from above, see ``Thing``."""

        def at(s: FloatArray, t: FloatArray) -> FloatArray:
            x, y, psi = line.poses(s).T
            return np.column_stack([x - t * np.sin(psi), y + t * np.cos(psi)])

        repeat, outlines = thing.first("repeat"), [*thing.all("outline")]
        outlines += [outline for group in thing.all("outlines") for outline in group.all("outline")]
        if repeat is not None:
            begin, length, first, last = (self._number(repeat, name) for name in ("s", "length", "tStart", "tEnd"))
            share = np.linspace(0.0, 1.0, int(np.clip(length, 2.0, 1000.0)))
            return at(begin + share * length, first + share * (last - first))
        corners = outlines[0].children if outlines else []
        if corners and corners[0].name == "cornerRoad":
            return at(*np.array([[self._number(corner, name) for corner in [*corners, corners[0]]] for name in "st"]))
        s, t = (np.array([self._number(thing, name)]) for name in "st")
        if corners:
            local = np.array([[self._number(corner, name) for corner in [*corners, corners[0]]] for name in "uv"])
        else:
            radius = self.number_or(thing, "radius", 0.0)
            length, width = (self.number_or(thing, name, 2.0 * radius) for name in ("length", "width"))
            square = np.array([[0.5, 0.5, -0.5, -0.5, 0.5], [0.5, -0.5, -0.5, 0.5, 0.5]])
            local = square * [[length], [width]] if length and width and thing.name == "object" else np.zeros((2, 1))
        heading = line.poses(s)[0, 2] + self.number_or(thing, "hdg", 0.0)
        c, sine = math.cos(heading), math.sin(heading)
        outline: FloatArray = at(s, t) + local.T @ np.array([[c, sine], [-sine, c]])
        return outline

    def _cross_sections(self, profile: Element | None, scope: Fault) -> CrossSections:
        """Shapes, and the crossfall of files before OpenDRIVE 1.6."""
        shapes: dict[float, list[Element]] = {}
        for one in profile.all("shape") if profile else ():
            try:
                shapes.setdefault(self._number(one, "s"), []).append(one)
            except ValueError as error:
                self._faults.append(scope._replace(text=str(error)))
        falls = profile.all("crossfall") if profile else []
        left, right = ([one for one in falls if one.attributes.get("side") != other] for other in ("right", "left"))
        places = [scope.begin, *sorted(shapes), scope.end]  # a shape holds from the one before to the one after
        return CrossSections(
            stations=np.array(places[1:-1]),
            shapes=[
                self._cubics(shapes[s], "t", scope._replace(begin=before, end=after))
                for before, s, after in zip(places[:-2], places[1:-1], places[2:], strict=True)
            ],
            left=self._cubics(left, "s", scope),
            right=self._cubics(right, "s", scope),
        )

    def _cubics(self, elements: Sequence[Element], begin: str, scope: Fault) -> Cubics:
        """Records along a road, a section or across; one that is wrong is a fault up to the next, or of the scope."""
        rows: list[list[float]] = []
        wrong: list[tuple[float, str]] = []
        for one in elements:
            try:
                rows.append([self._number(one, key) for key in (begin, *_CUBIC)])
            except ValueError as error:
                wrong.append((self.number_or(one, begin, 0.0), str(error)))
        table = np.array(sorted(rows), dtype=np.float64).reshape(-1, 5)
        for s, text in wrong:
            fault = scope._replace(text=text)
            if begin != "t":
                after = min((row[0] for row in rows if row[0] > s), default=math.inf)
                fault = fault._replace(begin=scope.begin + s, end=min(scope.begin + after, scope.end))
            self._faults.append(fault)
        return Cubics(table[:, 0], table[:, 1:])

    def number_or(self, element: Element, name: str, otherwise: float) -> float:
        """The number of an attribute, or another one where it has none."""
        try:
            return self._number(element, name)
        except ValueError:
            return otherwise

    def _child(self, element: Element, name: str) -> Element:
        child = element.first(name)
        if child is None:
            raise self._error(element, f"{_tag(element)} has no <{name}>")
        return child

    def _number(self, element: Element, name: str, column: Column | None = None) -> float:
        place = f"line {element.line}: {self._of}{_tag(element)}"
        return (column or Column(name, _LARGEST, ""))._replace(name=name).number(self.text(element, name), place)

    def _whole(self, element: Element, name: str) -> int:
        number = self._number(element, name)
        if number != round(number):
            raise self._error(element, f"{name} = {number:g} must be a whole number")
        return round(number)

    def _error(self, element: Element, message: str) -> ValueError:
        return ValueError(f"line {element.line}: {self._of}{message}")


def _tag(element: Element) -> str:
    """An element with its place along the road, or its id, for messages."""
    names = ("s", "sOffset", "id") if element.name != "road" else ()
    name = next((name for name in names if name in element.attributes), None)
    return f'<{element.name} {name}="{shown(element.attributes[name], 40)}">' if name else f"<{element.name}>"


def _line_kind(mark: str) -> LineKind:
    """Kind of a road mark; of two lines side by side the solid one, and none for kerbs, grass and studs."""
    words = mark.split()
    return LineKind.SOLID if "solid" in words else LineKind.BROKEN if "broken" in words else LineKind.NONE


_SHAPES: Final[dict[str, tuple[str, ...]]] = {  # with the names of their curvatures at both ends
    "line": ("", ""),
    "arc": ("curvature", "curvature"),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": (),
    "paramPoly3": (),
}
