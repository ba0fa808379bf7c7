"""Roads as data: reference lines, cross sections, lanes and links, and where a lane lies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.path import Path, Segment
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

    @property
    def length(self) -> float:
        """Length of the road [m]."""
        return self.pieces[-1].s + self.pieces[-1].length

    def poses(self, s: FloatArray) -> FloatArray:
        """Positions [m] and headings [rad] (n, 3) at distances along the road (n,) [m]."""
        which = np.clip(np.searchsorted([piece.s for piece in self.pieces], s, side="right") - 1, 0, None)
        poses = np.empty((len(s), 3))
        for k in np.unique(which).tolist():
            rows = which == k
            poses[rows] = self.pieces[k].poses(s[rows] - self.pieces[k].s)
        return poses

    def gaps(self) -> FloatArray:
        """Distances between the end of each piece and the begin of the next (n - 1, 2) [m, rad]."""
        gaps = np.zeros((len(self.pieces) - 1, 2))
        for k, (piece, after) in enumerate(zip(self.pieces[:-1], self.pieces[1:], strict=True)):
            x, y, psi = piece.poses(np.array([piece.length]))[0].tolist()
            turn = (after.start.psi - psi + np.pi) % (2.0 * np.pi) - np.pi
            gaps[k] = np.hypot(after.start.x - x, after.start.y - y), abs(turn)
        return gaps


@dataclass(frozen=True, slots=True, eq=False)
class Cubics:
    """a + b d + c d^2 + d d^3 with the distance d from the begin of each piece; zero without pieces."""

    begins: FloatArray  # (n,) ascending [m]
    coefficients: FloatArray  # (n, 4) a, b, c, d

    def at(self, s: FloatArray) -> FloatArray:
        """Values at the distances s (m,) [m]; before the first piece that piece's."""
        if not len(self.begins):
            return np.zeros(len(s))
        k = np.clip(np.searchsorted(self.begins, s, side="right") - 1, 0, len(self.begins) - 1)
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

    def height(self, s: FloatArray, t: FloatArray) -> FloatArray:
        """Height [m] at s along the road and t to the left (n,) [m]: linear between shapes, constant beyond them."""
        fall = np.where(t > 0.0, self.left.at(s), self.right.at(s))
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
    predecessor: int | None
    successor: int | None


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
    lanes: Mapping[int, Lane]  # without lane 0
    marks: Mapping[int, RoadMarks]  # by the lane's id, with lane 0; empty: the file states none in this section

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
        for k in range(1, abs(lane) + 1):
            one = self.lanes.get(k if lane > 0 else -k)
            inner = outer
            if one is not None:
                value = one.width.at(s - self.s)
                outer = np.maximum(value, inner) if one.is_border else inner + np.maximum(value, 0.0)
        return inner, outer


class Link(NamedTuple):
    """What follows at an end of a road."""

    is_junction: bool
    id: str
    contact: Contact | None  # end of the next road that is touched


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Road:
    """A road."""

    id: str
    junction: str | None  # that it belongs to
    drives_left: bool  # rule of traffic
    reference: ReferenceLine
    elevation: Cubics  # [m]
    superelevation: Cubics  # roll about the reference line, + falls to the right [rad]
    cross_sections: CrossSections
    lane_offset: Cubics  # of lane 0 from the reference line, + left [m]
    sections: tuple[Section, ...]
    predecessor: Link | None
    successor: Link | None

    def section_end(self, k: int) -> float:
        """End of section k along the road [m]."""
        return self.sections[k + 1].s if k + 1 < len(self.sections) else self.reference.length

    def places(self, s: FloatArray, t: FloatArray) -> FloatArray:
        """Positions (n, 3) [m] at s along the road and t to the left of its reference line (n,) [m]."""
        x, y, psi = self.reference.poses(s).T
        roll = self.superelevation.at(s)
        bulge = self.cross_sections.height(s, t)
        across = t * np.cos(roll) - bulge * np.sin(roll)
        height = self.elevation.at(s) + t * np.sin(roll) + bulge * np.cos(roll)
        return np.stack([x - across * np.sin(psi), y + across * np.cos(psi), height], axis=1)


class Connection(NamedTuple):
    """A way through a junction."""

    incoming: str  # road
    connecting: str  # road
    contact: Contact  # end of the connecting road that is touched
    lanes: Mapping[int, int]  # from the incoming to the connecting road; empty: not stated


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Roads and junctions of a file, by their ids."""

    roads: Mapping[str, Road]
    junctions: Mapping[str, tuple[Connection, ...]]
