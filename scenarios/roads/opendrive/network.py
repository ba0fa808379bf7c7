"""Roads with their lanes and links as data, and where a lane lies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenarios.roads.opendrive.cross_section import CrossSections
from scenarios.roads.opendrive.cubics import Cubics
from scenarios.roads.opendrive.reference_line import ReferenceLine
from vehicle.frames import FloatArray

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
