"""Routes along lanes: from lane to lane over the links of roads and junctions.

Travel along a road is in the direction of its reference line (+1) or against it (-1).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from scenarios.roads.opendrive.network import Connection, Contact, Lane, Link, Network, Road
from vehicle.parameter_file import nearest
from vehicle.user_file import shown

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
