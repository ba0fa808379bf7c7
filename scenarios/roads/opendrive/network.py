"""Roads as data: reference lines, cross sections, lanes and links, and where a lane lies."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.path import Path, Segment
from scenarios.roads.placement import UNPLACED, Placement
from vehicle.frames import FloatArray, Pose2, quadrature

_INTERVALS: Final = 64  # of a cubic polynomial, whose length is summed up
_NODES, _WEIGHTS = quadrature(8)  # in each of them: to rounding for curves of roads
_NEWTON: Final = 3  # steps from the linear guess within an interval


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Geometry:
    """A piece of the reference line."""

    s: float  # its begin along the road [m]
    start: Pose2  # in the coordinates of the file
    length: float  # [m]
    local: Callable[[FloatArray], FloatArray]  # poses (n, 3) from its start, at distances (n,) from it [m]
    line: int  # in the file

    def poses(self, along: FloatArray) -> FloatArray:
        """Positions [m] and headings [rad] (n, 3) at distances from its begin (n,) [m]."""
        u, v, turn = self.local(along).T
        c, s = np.cos(self.start.psi), np.sin(self.start.psi)
        return np.stack([self.start.x + c * u - s * v, self.start.y + s * u + c * v, self.start.psi + turn], axis=1)


def clothoid(length: float, start: float, end: float) -> Callable[[FloatArray], FloatArray]:
    """A line, an arc or a spiral, by its length [m] and the curvature at both ends [1/m]."""
    return Path(Pose2(0.0, 0.0, 0.0), (Segment(length, start, end),)).poses


def parametric(u: FloatArray, v: FloatArray, end: float) -> Callable[[FloatArray], FloatArray]:
    """The curve u(p), v(p) of cubic polynomials (4,) in the parameter p = ``end`` * share of the length [m]."""

    def poses(p: FloatArray) -> FloatArray:
        powers = np.stack([np.ones_like(p), p, p**2, p**3], axis=1)
        slopes = np.stack([np.zeros_like(p), np.ones_like(p), 2.0 * p, 3.0 * p**2], axis=1)
        return np.stack([powers @ u, powers @ v, np.arctan2(slopes @ v, slopes @ u)], axis=1)

    return lambda along: poses(end * along)


def polynomial(v: FloatArray, length: float) -> Callable[[FloatArray], FloatArray]:
    """The curve v(u) of a cubic polynomial (4,), by the distance along it."""

    def slope(u: FloatArray) -> FloatArray:
        return np.asarray(v[1] + u * (2.0 * v[2] + 3.0 * v[3] * u), dtype=np.float64)

    knots = np.linspace(0.0, length, _INTERVALS + 1)  # u is never longer than the curve
    step = knots[1]
    pieces = step * (np.hypot(1.0, slope(knots[:-1, None] + step * _NODES)) @ _WEIGHTS)
    lengths = np.concatenate([[0.0], np.cumsum(pieces)])

    def poses(along: FloatArray) -> FloatArray:
        k = np.clip(np.searchsorted(lengths, along, side="right") - 1, 0, _INTERVALS - 1)
        u = knots[k] + step * (along - lengths[k]) / pieces[k]
        for _ in range(_NEWTON):
            inside = u - knots[k]
            length_of_u = lengths[k] + inside * (
                np.hypot(1.0, slope(knots[k][:, None] + inside[:, None] * _NODES)) @ _WEIGHTS
            )
            u = u + (along - length_of_u) / np.hypot(1.0, slope(u))
        height = v[0] + u * (v[1] + u * (v[2] + u * v[3]))
        return np.stack([u, height, np.arctan(slope(u))], axis=1)

    return poses


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceLine:
    """Pieces one after the other."""

    pieces: tuple[Geometry, ...]
    length: float  # of the road [m]

    def poses(self, s: FloatArray) -> FloatArray:
        """Positions [m] and headings [rad] (n, 3) at distances along the road (n,) [m]."""
        which = np.clip(np.searchsorted([piece.s for piece in self.pieces], s, side="right") - 1, 0, None)
        poses = np.empty((len(s), 3))
        for k in np.unique(which).tolist():
            rows = which == k
            poses[rows] = self.pieces[k].poses(s[rows] - self.pieces[k].s)
        return poses

    def gaps(self) -> FloatArray:
        """Distances between the end of each piece and the begin of the next (n - 1,) [m]."""
        ends = [piece.poses(np.array([piece.length]))[0, :2] for piece in self.pieces[:-1]]
        begins = [piece.start[:2] for piece in self.pieces[1:]]
        away = (np.array(begins) - np.array(ends)).reshape(-1, 2)
        return np.asarray(np.hypot(away[:, 0], away[:, 1]), dtype=np.float64)


class Span(NamedTuple):
    """A stretch of a road or of one of its sections."""

    begin: float  # [m]
    end: float  # [m]


_EVERYWHERE: Final = Span(-math.inf, math.inf)
_ROUNDED: Final = 0.01  # a record that begins so near to a section's begin belongs to that section [m]


@dataclass(frozen=True, slots=True, eq=False)
class Cubics:
    """a + b d + c d^2 + d d^3 with the distance d from the begin of each piece; zero without pieces."""

    begins: FloatArray  # (n,) ascending [m]
    coefficients: FloatArray  # (n, 4) a, b, c, d

    def at(self, s: FloatArray, within: Span = _EVERYWHERE) -> FloatArray:
        """Values at the distances s (m,) [m] of pieces that begin ``within`` a span.

        Before the first piece they are that piece's.
        """
        if not len(self.begins):
            return np.zeros(len(s))
        k = np.searchsorted(self.begins, np.clip(s, *within), side="right") - 1
        k = np.clip(k, 0, len(self.begins) - 1)
        a, b, c, d = self.coefficients[k].T
        along = s - self.begins[k]
        return np.asarray(a + along * (b + along * (c + along * d)), dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CrossSections:
    """Heights of a road above the straight line across it that superelevation turns."""

    stations: FloatArray  # (n,) ascending, of the shapes [m]
    shapes: Sequence[Cubics]  # height by t at each station [m]
    left: Cubics  # crossfall by s, + falls away from the reference line [rad]
    right: Cubics

    def height(self, s: FloatArray, t: FloatArray, within: Span = _EVERYWHERE) -> FloatArray:
        """Height [m] at s along the road and t to the left (n,) [m]: linear between shapes, constant beyond them."""
        fall = np.where(t > 0.0, self.left.at(s, within), self.right.at(s, within))
        height: FloatArray = -np.abs(t) * np.tan(fall)
        if not self.shapes:
            return height
        last = len(self.shapes) - 1
        before = np.clip(np.searchsorted(self.stations, s, side="right") - 1, 0, last)
        for k in np.unique(before).tolist():
            rows = before == k
            after = min(k + 1, last)
            span = self.stations[after] - self.stations[k]
            share = np.clip((s[rows] - self.stations[k]) / span, 0.0, 1.0) if span else 0.0
            first, second = (self.shapes[i].at(t[rows]) for i in (k, after))
            height[rows] += first + share * (second - first)
        return height


Contact = Literal["start", "end"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lane:
    """A lane of one section; ids are positive on the left of the reference line."""

    id: int
    kind: str  # driving, shoulder, sidewalk, …
    width: Cubics  # by the distance from the begin of the section [m]
    is_border: bool  # True: ``width`` is the distance of its outer border from lane 0
    travel: int  # +1 along the reference line, -1 against it
    both_ways: bool  # may be driven against ``travel`` too
    stated: bool  # True: the file says so for this lane; False: by the side that it is on
    predecessors: tuple[int, ...]  # several where lanes merge
    successors: tuple[int, ...]  # several where it splits

    def linked(self, direction: int) -> tuple[int, ...]:
        """Lanes that follow in a direction along the road; empty: the file does not say."""
        return self.successors if direction > 0 else self.predecessors


class LineKind(IntEnum):
    """What is painted on the border of a lane."""

    NONE = 0
    BROKEN = 1
    SOLID = 2


@dataclass(frozen=True, slots=True, eq=False)
class RoadMarks:
    """Lines on the outer border of a lane, of lane 0 on itself."""

    begins: FloatArray  # (n,) ascending, from the begin of the section [m]
    kinds: NDArray[np.int_]  # (n,) LineKind

    def at(self, along: FloatArray) -> NDArray[np.int_]:
        """LineKind (m,) at distances from the begin of the section (m,) [m]."""
        if not len(self.begins):
            return np.full(len(along), LineKind.NONE)
        k = np.searchsorted(self.begins, along, side="right") - 1
        return np.where(k < 0, LineKind.NONE, self.kinds[k])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Section:
    """Lanes from one place along the road to the next section."""

    s: float  # its begin [m]
    end: float  # [m]
    lanes: Mapping[int, Lane]  # without lane 0
    marks: Mapping[int, RoadMarks]  # by the lane's id, with lane 0; empty: the file states none in this section

    @property
    def inside(self) -> Span:
        """Where the records along the road begin that hold on its side of its ends."""
        room = min(_ROUNDED, 0.5 * (self.end - self.s))
        return Span(self.s + room, self.end - room)

    def line_kinds(self, s: FloatArray, lane: int, between: tuple[int, int]) -> NDArray[np.int_]:
        """LineKind (n,) on a lane's outer border at s (n,) [m], which is ``between`` two lanes.

        Where the file states no lines they are broken between lanes of one type, and solid beside others.
        """
        if self.marks:
            return self.marks[lane].at(s - self.s) if lane in self.marks else np.full(len(s), LineKind.NONE)
        right, left = (self.lanes[one].kind for one in between)
        return np.full(len(s), LineKind.BROKEN if right == left else LineKind.SOLID)

    def borders(self, s: FloatArray, lane: int) -> tuple[FloatArray, FloatArray]:
        """Distance of a lane's inner and outer border from lane 0 at s (n,) [m], without a sign."""
        inner = outer = np.zeros(len(s))
        within = Span(*(place - self.s for place in self.inside))
        for k in range(1, abs(lane) + 1):
            one = self.lanes.get(k if lane > 0 else -k)
            inner = outer
            if one is not None:
                value = one.width.at(s - self.s, within)
                outer = np.maximum(value, inner) if one.is_border else inner + np.maximum(value, 0.0)
        return inner, outer


class Link(NamedTuple):
    """What follows at an end of a road."""

    is_junction: bool
    id: str
    contact: Contact | None  # end of the next road that is touched; None: the file does not say
    line: int  # in the file
    s: float | None = None  # place on the next road where a virtual junction joins it [m]; None: at an end


class Fault(NamedTuple):
    """What is wrong in a stretch of a road; it matters to a drive through there alone."""

    begin: float  # along the road [m]
    end: float  # [m]
    text: str  # with file and line
    lane: int | None = None  # matters to this lane and those outside it; None: to the whole road
    of_heights: bool = False  # matters where heights are driven


class Thing(NamedTuple):
    """A signal or an object of a road, such as an island or a kerb, for plans."""

    kind: str  # signal, or the object's type
    outline: FloatArray  # (n, 2) [m], closed; a row of objects is an open line, one without a size a point


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Road:
    """A road."""

    id: str
    junction: str | None  # that it belongs to
    reference: ReferenceLine
    elevation: Cubics  # [m]
    superelevation: Cubics  # roll about the reference line, + falls to the right [rad]
    cross_sections: CrossSections
    lane_offset: Cubics  # of lane 0 from the reference line, + left [m]
    sections: tuple[Section, ...]
    predecessor: Link | None
    successor: Link | None
    faults: tuple[Fault, ...] = ()
    things: Callable[[], Iterable[Thing]] = tuple  # read on demand

    def places(self, s: FloatArray, t: FloatArray, section: Section) -> FloatArray:
        """Positions and the reference line's heading (n, 4) [m, rad] at s in a section, t to the left of that line."""
        x, y, psi = self.reference.poses(s).T
        within = section.inside
        roll = self.superelevation.at(s, within)
        bulge = self.cross_sections.height(s, t, within)
        across = t * np.cos(roll) - bulge * np.sin(roll)
        height = self.elevation.at(s, within) + t * np.sin(roll) + bulge * np.cos(roll)
        return np.stack([x - across * np.sin(psi), y + across * np.cos(psi), height, psi], axis=1)

    def linked(self, direction: int) -> Link | None:
        """What follows in a direction of travel."""
        return self.successor if direction > 0 else self.predecessor

    def fault(self, span: Span, lane: int, *, heights: bool) -> Fault | None:
        """The first fault that a drive on a lane meets between two places."""
        met = (
            fault
            for fault in self.faults
            if fault.begin < span.end and fault.end > span.begin and (heights or not fault.of_heights)
            if fault.lane is None or (fault.lane * lane > 0 and abs(fault.lane) <= abs(lane))
        )
        return min(met, default=None)


class Connection(NamedTuple):
    """A way through a junction."""

    incoming: str  # road
    connecting: str  # road
    contact: Contact | None  # end of the connecting road that is touched; None: the file does not say
    lanes: Mapping[int, tuple[int, ...]]  # from the incoming to the connecting road; empty: not stated


JUNCTION: Final = "junction "  # before the ids of junctions that cannot be read


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Roads and junctions of a file, by their ids."""

    roads: Mapping[str, Road]
    junctions: Mapping[str, tuple[Connection, ...]]
    broken: Mapping[str, str]  # roads and junctions that cannot be read, and why, with file and line
    placement: Placement = UNPLACED  # of the file's coordinates, by its header
