"""Read the roads of an OpenDRIVE file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from scenarios.roads.opendrive.network import (
    Connection,
    Contact,
    CrossSections,
    Cubics,
    Geometry,
    Lane,
    LineKind,
    Link,
    Network,
    ReferenceLine,
    Road,
    RoadMarks,
    Section,
    clothoid,
    parametric,
    polynomial,
)
from scenarios.roads.path_file import Element, read_xml
from vehicle.foundation.data_file import Column
from vehicle.foundation.user_file import shown
from vehicle.frames import Pose2

_GAP: Final = 0.1  # largest distance between two pieces of a reference line [m]: files are rounded to millimetres
_KINK: Final = 0.1  # largest change of heading there [rad]
_LARGEST: Final = 1e8  # number of any kind: projected coordinates of the earth [m]
_CURVATURE: Final = Column("curvature", 10.0, "1/m")
_LENGTH: Final = Column("length", 1e6, "m")
_CUBIC: Final = ("a", "b", "c", "d")


def read_opendrive(path: Path) -> Network:
    """Roads and junctions of a file.

    Raises:
        ValueError: one line naming file, line, value and limit.
    """
    root = read_xml(path, "OpenDRIVE")
    reader = _Reader(path)
    roads: dict[str, Road] = {}
    for element in root.all("road"):
        road = reader.road(element)
        if road.id in roads:
            raise ValueError(f"{path}: line {element.line}: two roads have the id '{shown(road.id, 40)}'")
        roads[road.id] = road
    if not roads:
        raise ValueError(f"{path}: has no <road>")
    junctions = {reader.text(element, "id"): reader.connections(element) for element in root.all("junction")}
    return Network(roads, junctions)


class _Reader:
    """Reads elements, and names file and line of what is wrong."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def road(self, element: Element) -> Road:
        """A road with its lanes."""
        plan, lanes = self._child(element, "planView"), self._child(element, "lanes")
        name = shown(self.text(element, "id"), 40)
        pieces = sorted((self._geometry(piece) for piece in plan.all("geometry")), key=lambda piece: piece.s)
        if not pieces:
            raise self._error(plan, f"road {name} has no <geometry>")
        reference = ReferenceLine(tuple(pieces))
        self._check_joints(reference, name)
        sections = sorted((self._section(section) for section in lanes.all("laneSection")), key=lambda part: part.s)
        if not sections:
            raise self._error(lanes, f"road {name} has no <laneSection>")
        if not 0.0 <= sections[0].s <= sections[-1].s < reference.length:
            raise self._error(
                lanes,
                f"road {name} has lane sections from s = {sections[0].s:g} to {sections[-1].s:g} m: must be within its "
                f"length of {reference.length:g} m",
            )
        junction = element.attributes.get("junction", "-1")
        link = element.first("link")
        return Road(
            id=self.text(element, "id"),
            junction=None if junction in ("-1", "") else junction,
            drives_left=element.attributes.get("rule", "RHT") == "LHT",
            reference=reference,
            elevation=self._cubics(element.first("elevationProfile"), "elevation", "s"),
            superelevation=self._cubics(element.first("lateralProfile"), "superelevation", "s"),
            cross_sections=self._cross_sections(element.first("lateralProfile")),
            lane_offset=self._cubics(lanes, "laneOffset", "s"),
            sections=tuple(sections),
            predecessor=self._link(link, "predecessor"),
            successor=self._link(link, "successor"),
        )

    def connections(self, element: Element) -> tuple[Connection, ...]:
        """Ways through a junction."""
        connections = []
        for one in element.all("connection"):
            road = one.attributes.get("connectingRoad") or one.attributes.get("linkedRoad")
            incoming = one.attributes.get("incomingRoad")
            if road is None or incoming is None:  # of a virtual junction
                continue
            lanes = {self._whole(link, "from"): self._whole(link, "to") for link in one.all("laneLink")}
            connections.append(Connection(incoming, road, self._contact(one) or "start", lanes))
        return tuple(connections)

    def text(self, element: Element, name: str) -> str:
        """An attribute that must be there."""
        if name not in element.attributes:
            raise self._error(element, f"<{element.name}> has no attribute '{name}'")
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
            raise error if str(error).startswith(str(self._path)) else self._error(shape, str(error)) from None
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

    def _check_joints(self, reference: ReferenceLine, road: str) -> None:
        first = reference.pieces[0]
        if abs(first.s) > _GAP:
            raise ValueError(
                f"{self._path}: line {first.line}: road {road}: its first geometry is at s = {first.s:g} m: must be 0"
            )
        for piece, after, (gap, kink) in zip(
            reference.pieces[:-1], reference.pieces[1:], reference.gaps().tolist(), strict=True
        ):
            place = f"{self._path}: line {after.line}: road {road}"
            if abs(piece.s + piece.length - after.s) > _GAP:
                raise ValueError(
                    f"{place}: the geometry before ends at s = {piece.s + piece.length:.3f} m, this one begins at "
                    f"{after.s:.3f} m"
                )
            if not gap <= _GAP:
                raise ValueError(
                    f"{place}: a gap of {gap:.3g} m in the reference line at s = {after.s:.1f} m: must be at most "
                    f"{_GAP:g} m"
                )
            if not kink <= _KINK:
                raise ValueError(
                    f"{place}: a kink of {kink:.3g} rad in the reference line at s = {after.s:.1f} m: must be at most "
                    f"{_KINK:g} rad"
                )

    def _section(self, element: Element) -> Section:
        beside, middle = (
            [lane for name in names for side in element.all(name) for lane in side.all("lane")]
            for names in (("left", "right"), ("center",))
        )
        lanes = [self._lane(lane) for lane in beside]
        return Section(
            s=self._number(element, "s"),
            lanes={lane.id: lane for lane in lanes if lane.id},
            marks={self._whole(lane, "id"): self._marks(lane) for lane in beside + middle if lane.first("roadMark")},
        )

    def _marks(self, lane: Element) -> RoadMarks:
        rows = sorted(
            (
                self._number(mark, "sOffset") if "sOffset" in mark.attributes else 0.0,
                _line_kind(mark.attributes.get("type", "none")),
            )
            for mark in lane.all("roadMark")
        )
        return RoadMarks(np.array([begin for begin, _ in rows]), np.array([kind for _, kind in rows]))

    def _lane(self, element: Element) -> Lane:
        number, link = self._whole(element, "id"), element.first("link")
        if abs(number) > 100:
            raise self._error(element, f"lane id = {number} must be within -100 to 100")
        is_border = element.first("width") is None and element.first("border") is not None
        return Lane(
            id=number,
            kind=element.attributes.get("type", "none"),
            width=self._cubics(element, "border" if is_border else "width", "sOffset"),
            is_border=is_border,
            predecessor=self._lane_link(link, "predecessor"),
            successor=self._lane_link(link, "successor"),
        )

    def _lane_link(self, link: Element | None, name: str) -> int | None:
        element = link.first(name) if link is not None else None
        return None if element is None else self._whole(element, "id")

    def _link(self, link: Element | None, name: str) -> Link | None:
        element = link.first(name) if link is not None else None
        if element is None:
            return None
        is_junction = self.text(element, "elementType") == "junction"
        return Link(is_junction, self.text(element, "elementId"), self._contact(element))

    def _contact(self, element: Element) -> Contact | None:
        contact = element.attributes.get("contactPoint")
        return "start" if contact == "start" else "end" if contact == "end" else None

    def _cross_sections(self, profile: Element | None) -> CrossSections:
        """Shapes, and the crossfall of files before OpenDRIVE 1.6."""
        shapes: dict[float, list[Element]] = {}
        for one in profile.all("shape") if profile else ():
            shapes.setdefault(self._number(one, "s"), []).append(one)
        falls = profile.all("crossfall") if profile else []
        left, right = ([one for one in falls if one.attributes.get("side") != other] for other in ("right", "left"))
        return CrossSections(
            stations=np.array(sorted(shapes), dtype=np.float64),
            shapes=[self._cubics_of(shapes[s], "t") for s in sorted(shapes)],
            left=self._cubics_of(left, "s"),
            right=self._cubics_of(right, "s"),
        )

    def _cubics(self, parent: Element | None, name: str, begin: str) -> Cubics:
        return self._cubics_of(parent.all(name) if parent else (), begin)

    def _cubics_of(self, elements: Sequence[Element], begin: str) -> Cubics:
        rows = [[self._number(one, key) for key in (begin, *_CUBIC)] for one in elements]
        table = np.array(sorted(rows), dtype=np.float64).reshape(-1, 5)
        return Cubics(table[:, 0], table[:, 1:])

    def _child(self, element: Element, name: str) -> Element:
        child = element.first(name)
        if child is None:
            raise self._error(element, f"<{element.name}> has no <{name}>")
        return child

    def _number(self, element: Element, name: str, column: Column | None = None) -> float:
        place = f"{self._path}: line {element.line}: <{element.name}>"
        return (column or Column(name, _LARGEST, ""))._replace(name=name).number(self.text(element, name), place)

    def _whole(self, element: Element, name: str) -> int:
        number = self._number(element, name)
        if number != round(number):
            raise self._error(element, f"{name} = {number:g} must be a whole number")
        return round(number)

    def _error(self, element: Element, message: str) -> ValueError:
        return ValueError(f"{self._path}: line {element.line}: {message}")


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
