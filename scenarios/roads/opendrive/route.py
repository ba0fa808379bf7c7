"""Routes along lanes, with the points and the painted lines along them.

Travel along a road is in the direction of its reference line (+1) or against it (-1).

Each place along that lane has a row of ``LINES`` lines, from right to left. The line on the lane's right is number
``LINES // 2 - 1``, the one on its left comes next, wherever the road gets or loses lanes beside them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from scenarios.roads.opendrive.network import Connection, Contact, Lane, LineKind, Link, Network, Road, Section
from scenarios.roads.path_file import PathPoints
from vehicle.foundation.user_file import nearest, shown
from vehicle.frames import FloatArray

Edges = Literal["lane", "road"]
TURNS: Final = ("left", "right", "straight")
_TURNING: Final = math.radians(30.0)  # least change of heading of a turn through a junction


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The route that is asked for."""

    road: str | None = None  # to start on; None: the first one with a lane to drive on
    lane: int | None = None  # to start on; None: the outermost lane to drive on
    words: Sequence[str] = ()  # ids of roads, or turns at junctions, in the order of driving
    heights: bool = True  # False: they are not driven, so that steps between roads do not matter
    edges: Edges = "lane"  # the road's edges: those of the lane, or of all paved lanes beside it


class Leg(NamedTuple):
    """A lane of one section of a road."""

    road: Road
    section: int
    lane: int
    direction: int  # +1 or -1

    @property
    def length(self) -> float:
        """Length of the section along the reference line [m]."""
        return self.road.section_end(self.section) - self.road.sections[self.section].s


def legs(network: Network, request: Request, source: str) -> Iterator[Leg]:
    """Lanes of the route in the order of driving; it ends where the words do not say how to go on."""
    leg = _first(network, request, source)
    words = list(request.words)
    if words and words[0] == leg.road.id:
        words.pop(0)
    to_the_end = not words or words[-1] in TURNS  # otherwise it ends with the last road that is named
    seen: set[tuple[str, int, int, int]] = set()
    while (place := (leg.road.id, leg.section, leg.lane, len(words))) not in seen:  # it has come round otherwise
        seen.add(place)
        yield leg
        after = _in_road(leg, source)
        if after is None:
            if not words and not to_the_end:
                return
            after = _beyond(network, leg, words, source)
        if after is None:
            break
        leg = after
    if words:
        raise ValueError(
            f"{source}: the route ends with road {shown(leg.road.id, 40)}: course.route = {shown(words[0], 40)} is not "
            "reached"
        )


def _first(network: Network, request: Request, source: str) -> Leg:
    """The lane to start on, at its begin."""
    roads = network.roads
    if request.road is not None and request.road not in roads:
        raise ValueError(f"{source}: course.road = {shown(request.road, 40)}{nearest(request.road, roads)}")
    word = request.words[0] if request.words and request.words[0] in roads else None
    wanted = request.road or word
    usual = (road for road in roads.values() if road.junction is None and _drivable(road))
    road = roads[wanted] if wanted else next(usual, next(iter(roads.values())))
    lane = request.lane if request.lane is not None else _outermost(road)
    known = sorted(road.sections[0].lanes)
    if lane is None:
        raise ValueError(
            f"{source}: road {shown(road.id, 40)} has no lane of the type driving: name one in course.lane"
        )
    direction = _direction(road, lane)
    section = 0 if direction > 0 else len(road.sections) - 1
    if lane not in road.sections[section].lanes:
        lanes = ", ".join(map(str, known)) or "none"
        raise ValueError(f"{source}: course.lane = {lane}: road {shown(road.id, 40)} has the lanes {lanes}")
    return Leg(road, section, lane, direction)


def _drivable(road: Road) -> bool:
    return _outermost(road) is not None


def _outermost(road: Road) -> int | None:
    """The outermost lane to drive on of the side that goes along the road, or else of the other."""
    lanes = [lane.id for lane in road.sections[0].lanes.values() if lane.kind == "driving"]
    along = [lane for lane in lanes if _direction(road, lane) > 0]
    if along:
        return max(along, key=abs)
    lanes = [lane.id for lane in road.sections[-1].lanes.values() if lane.kind == "driving"]
    return max(lanes, key=abs, default=None)


def _direction(road: Road, lane: int) -> int:
    """Direction of travel: lanes on the right go along the road where traffic drives on the right."""
    return 1 if (lane < 0) != road.drives_left else -1


def _in_road(leg: Leg, source: str) -> Leg | None:
    """The lane that follows in the next section of the same road; None at the road's end."""
    section = leg.section + leg.direction
    if not 0 <= section < len(leg.road.sections):
        return None
    lanes = leg.road.sections[section].lanes
    lane = _linked(leg)
    lane = leg.lane if lane is None else lane
    if lane not in lanes:
        s = leg.road.section_end(leg.section) if leg.direction > 0 else leg.road.sections[leg.section].s
        raise ValueError(
            f"{source}: lane {leg.lane} of road {shown(leg.road.id, 40)} ends at s = {s:.1f} m: choose another "
            "course.lane"
        )
    return Leg(leg.road, section, lane, leg.direction)


def _linked(leg: Leg) -> int | None:
    """The lane that a lane is linked to, in the direction of travel."""
    lane: Lane = leg.road.sections[leg.section].lanes[leg.lane]
    return lane.successor if leg.direction > 0 else lane.predecessor


def _beyond(network: Network, leg: Leg, words: list[str], source: str) -> Leg | None:
    """The lane on the next road; takes what it uses from the words. None: the route ends here."""
    link = leg.road.successor if leg.direction > 0 else leg.road.predecessor
    if link is None:
        return None
    if link.is_junction:
        ways = [way for way in network.junctions.get(link.id, ()) if way.incoming == leg.road.id]
        leads = [lead for way in ways if (lead := _through(network, way, leg)) is not None]
        return _chosen(network, leads, words, f"{source}: junction {shown(link.id, 40)}")
    after = _onto(network, link.id, link.contact, _linked(leg), leg)
    if link.id not in network.roads:
        raise ValueError(
            f"{source}: road {shown(leg.road.id, 40)} is linked to road {shown(link.id, 40)}, which is not in the file"
        )
    if after is None:
        raise ValueError(
            f"{source}: road {shown(leg.road.id, 40)} is linked to road {shown(link.id, 40)}, which has no lane that "
            f"goes on from lane {leg.lane}"
        )
    if words and words[0] == after.road.id:
        words.pop(0)
    return after


def _onto(network: Network, road_id: str, contact: Contact | None, lane: int | None, leg: Leg) -> Leg | None:
    """A lane at one end of a road; without a link of the lane the one on the same side of the traffic."""
    road = network.roads.get(road_id)
    if road is None or contact is None:
        return None
    direction = 1 if contact == "start" else -1
    if lane is None:
        lane = leg.lane * leg.direction * direction
    section = 0 if direction > 0 else len(road.sections) - 1
    return Leg(road, section, lane, direction) if lane in road.sections[section].lanes else None


def _through(network: Network, way: Connection, leg: Leg) -> Leg | None:
    """The lane of a junction's connecting road that goes on from a lane."""
    if way.lanes and leg.lane not in way.lanes:
        return None
    return _onto(network, way.connecting, way.contact, way.lanes.get(leg.lane), leg)


def _chosen(network: Network, leads: list[Leg], words: list[str], place: str) -> Leg | None:
    """The way through a junction that the next word names, or the only one."""
    turns = [_turn(lead.road) * lead.direction for lead in leads]
    exits = [_exit(network, lead) for lead in leads]
    if not words:
        return leads[0] if len(leads) == 1 else None
    word = words[0]
    named = [k for k, lead in enumerate(leads) if word in (lead.road.id, exits[k])]
    if word in TURNS:
        fits = [k for k, turn in enumerate(turns) if _word(turn) == word]
        named = sorted(fits, key=lambda k: abs(turns[k]), reverse=word != "straight")
    elif not named and len(leads) == 1:
        return leads[0]  # the road of that name comes later
    if not named:
        ways = ", ".join(
            f"{lead.road.id} ({math.degrees(turn):+.0f} deg to road {exit_})"
            for lead, turn, exit_ in zip(leads, turns, exits, strict=True)
        )
        raise ValueError(f"{place}: course.route = {shown(word, 40)} fits no way; there are: {shown(ways or 'none')}")
    chosen = leads[named[0]]
    if word in TURNS or word == chosen.road.id:
        words.pop(0)
    return chosen


def _word(turn: float) -> str:
    return "straight" if abs(turn) <= _TURNING else "left" if turn > 0.0 else "right"


def _turn(road: Road) -> float:
    """Change of heading along a road [rad], + left."""
    first, *_, last = road.reference.poses(np.linspace(0.0, road.reference.length, 65))[:, 2].tolist()
    return float(last - first)


def _exit(network: Network, lead: Leg) -> str | None:
    """The road after a connecting road."""
    link: Link | None = lead.road.successor if lead.direction > 0 else lead.road.predecessor
    return link.id if link is not None and not link.is_junction and link.id in network.roads else None


LINES: Final = 18


def lines_between(section: Section, lane: int, others: list[int], s: FloatArray, middle: FloatArray) -> FloatArray:
    """Lines between neighbouring lanes (n, LINES, 2) at s (n,) [m]; NaN where there is none.

    Args:
        section: of the road.
        lane: id of the lane that is driven.
        others: ids of the lanes that have lines between them, rising; among them ``lane``.
        s: [m].
        middle: of the lane, to the left of lane 0 (n,) [m].

    Returns:
        For each line its place to the left of ``middle`` [m], and 1 for a broken line or 0 for a solid one.
    """
    lines = np.full((len(s), LINES, 2), np.nan)
    left_of_lane = LINES // 2
    for k, (right, left) in enumerate(pairwise(others)):
        number = left_of_lane + k - others.index(lane)
        if not 0 <= number < LINES:
            continue
        inner = 0 if right < 0 < left else min(right, left, key=abs)  # the line is on this lane's outer border
        _, border = section.borders(s, inner)
        kinds = section.line_kinds(s, inner, (right, left))
        shown = kinds != LineKind.NONE
        lines[shown, number, 0] = (border if inner > 0 else -border)[shown] - middle[shown]
        lines[shown, number, 1] = kinds[shown] == LineKind.BROKEN
    return lines


def seen_backwards(lines: FloatArray) -> FloatArray:
    """Lines (n, LINES, 2) in the order and with the signs of travel against the reference line."""
    return np.asarray(lines[:, ::-1] * np.array([-1.0, 1.0]))


_SPACING: Final = 1.0  # between points along a lane [m]: a chord of a 12.5 m arc is 10 mm from it
_GAP: Final = 0.5  # largest distance between the lanes of two roads [m]: beyond it the link is wrong
_STEP: Final = 0.1  # largest difference of their heights [m]: it becomes a ramp as long as the smoothing
_LONGEST: Final = 50e3  # route [m], as of any course
_PAVED: Final = frozenset(  # types of lanes that a vehicle can stand on
    (
        *("driving", "stop", "shoulder", "border", "parking", "restricted", "bidirectional", "biking", "roadWorks"),
        *("entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "mwyEntry", "mwyExit"),
        *("bus", "taxi", "HOV", "special1", "special2", "special3"),
    )
)


def lane_points(network: Network, request: Request, source: str) -> PathPoints:
    """Points along the middle of the lanes of a route, with heights, banks and edges.

    Raises:
        ValueError: one line with the roads' ids, if there is no such route.
    """
    rows: list[FloatArray] = []  # x, y, z, bank, left and right width, and the lines
    length, end = 0.0, None
    for leg in legs(network, request, source):
        length += leg.length
        if length > _LONGEST:
            raise ValueError(f"{source}: the route is longer than {1e-3 * _LONGEST:g} km")
        points = _points(leg, request.edges)
        if end is not None:
            _check_joint(end, points[0], leg, request, source)
        end = points[-1]
        if rows:  # a road begins where the one before ends
            away = np.hypot(*(points[:, :2] - rows[-1][-1, :2]).T) >= 0.5 * _SPACING
            points = points[int(np.argmax(away)) :] if away.any() else points[:0]
        if len(points):
            rows.append(points)
    table = np.concatenate(rows)
    lines = table[:, 6:].reshape(-1, LINES, 2)
    return PathPoints(
        places=table[:, :2],
        heights=table[:, 2],
        banks=table[:, 3],
        widths=table[:, 4:6],
        lines=None if np.isnan(lines).all() else lines,
    )


def _check_joint(end: FloatArray, begin: FloatArray, leg: Leg, request: Request, source: str) -> None:
    """Refuse a lane that does not begin where the one before ends, or at another height."""
    gap = float(np.hypot(*(begin[:2] - end[:2])))
    if gap > _GAP:
        raise ValueError(
            f"{source}: a gap of {gap:.3g} m between the lanes at the begin of road {shown(leg.road.id, 40)}, at "
            f"({begin[0]:.2f}, {begin[1]:.2f}): must be at most {_GAP:g} m"
        )
    step = float(begin[2] - end[2])
    if request.heights and abs(step) > _STEP:
        raise ValueError(
            f"{source}: a step of {step:+.3g} m in height between the lanes at the begin of road "
            f"{shown(leg.road.id, 40)}, at ({begin[0]:.2f}, {begin[1]:.2f}): must be at most {_STEP:g} m; "
            "course.heights = false drives it level"
        )


def _points(leg: Leg, edges: Edges) -> FloatArray:
    """Rows (n, 6 + 2 LINES) along a lane in the direction of travel.

    x, y, z [m], bank [-], width to the left and right edge [m]; place to the left [m] and kind of each line.
    """
    road, section = leg.road, leg.road.sections[leg.section]
    s = np.linspace(section.s, section.s + leg.length, max(2, math.ceil(leg.length / _SPACING) + 1))
    side = 1.0 if leg.lane > 0 else -1.0
    inner, outer = (side * border for border in section.borders(s, leg.lane))
    offset = road.lane_offset.at(s)
    middle = offset + 0.5 * (inner + outer)
    low, high = np.minimum(inner, outer), np.maximum(inner, outer)
    paved = _paved(leg) if edges == "road" else [leg.lane]
    for lane in paved:
        borders = [(1.0 if lane > 0 else -1.0) * border for border in section.borders(s, lane)]
        low, high = np.minimum(low, np.minimum(*borders)), np.maximum(high, np.maximum(*borders))
    lines = lines_between(section, leg.lane, paved, s, middle - offset)
    ends = [road.cross_sections.height(s, offset + border) for border in (inner, outer)]
    width = np.where(np.abs(outer - inner) > 0.0, outer - inner, 1.0)
    bank = np.tan(road.superelevation.at(s) + np.arctan((ends[1] - ends[0]) / width))  # mean of the lane
    left, right = offset + high - middle, middle - offset - low
    if leg.direction < 0:
        bank, left, right, lines = -bank, right, left, seen_backwards(lines)
    table = np.column_stack([road.places(s, middle), bank, left, right, lines.reshape(len(s), -1)])
    return table[:: leg.direction]


def _paved(leg: Leg) -> list[int]:
    """Ids of the lane and of the paved lanes that join it without one between that is not paved, rising."""
    section = leg.road.sections[leg.section]
    ids = sorted(section.lanes)
    first = last = ids.index(leg.lane)
    while first > 0 and section.lanes[ids[first - 1]].kind in _PAVED:
        first -= 1
    while last + 1 < len(ids) and section.lanes[ids[last + 1]].kind in _PAVED:
        last += 1
    return ids[first : last + 1]
