"""Lanes of roads: which follow each other, the ways through junctions, and what can be driven.

Travel along a road is in the direction of its reference line (+1) or against it (-1).
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from scenarios.roads.opendrive.network import Connection, Contact, Lane, Network, Road, Section, Span
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray

Edges = Literal["lane", "road"]
TURNS: Final = ("left", "right", "straight")
_TURNING: Final = math.radians(30.0)  # least change of heading of a turn through a junction
_STRAIGHT: Final = math.radians(10.0)  # largest one of a way straight on where another turns to the other side
_AHEAD: Final = 50.0  # of the roads behind a direct junction, or of two that part slowly [m]
_APART: Final = 0.5  # least distance there of ways that are left and right of each other [m]
NARROW: Final = 2.5  # least width of a lane to drive on, where no vehicle is known: Directive 96/53/EC is 2.55 [m]
GAP: Final = 0.5  # largest distance between the lanes of two roads to the side [m]: beyond it the link is wrong
_ALONG: Final = 1.0  # largest one along the drive [m]: a hole or overlap there is no more than that of two points
_EPS: Final = 1e-6  # [m]
DRIVABLE: Final = frozenset(  # types of lanes that vehicles drive on
    (
        *("driving", "bidirectional", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane"),
        *("mwyEntry", "mwyExit", "bus", "taxi", "HOV"),
    )
)

PAVED: Final = DRIVABLE | {  # that a vehicle can stand on
    *("stop", "shoulder", "border", "parking", "biking", "restricted", "roadWorks", "special1", "special2", "special3")
}


class Leg(NamedTuple):
    """A lane of one section of a road, or a part of it."""

    road: Road
    section: int
    lane: int
    direction: int  # +1 or -1
    start: float  # along the road [m]
    end: float  # [m]
    change: float | None = None  # length of the change into this lane from the one before [m]; None: it goes on

    @property
    def length(self) -> float:
        """Length along the reference line [m]."""
        return abs(self.end - self.start)

    @property
    def span(self) -> Span:
        """The stretch of the road."""
        return Span(min(self.start, self.end), max(self.start, self.end))

    @property
    def part(self) -> Section:
        """The section of the road."""
        return self.road.sections[self.section]

    @property
    def data(self) -> Lane:
        """The lane's data."""
        return self.part.lanes[self.lane]

    def width(self, s: FloatArray) -> FloatArray:
        """Width of the lane at s along the road (n,) [m]."""
        inner, outer = self.part.borders(s, self.lane)
        return outer - inner

    def pose(self, s: float) -> tuple[float, float, float, float]:
        """Position of the middle of the lane [m] and direction of travel [rad] at s along the road."""
        here = np.array([s])
        inner, outer = self.part.borders(here, self.lane)
        middle = self.road.lane_offset.at(here, self.part.inside) + math.copysign(0.5, self.lane) * (inner + outer)
        x, y, z, psi = self.road.places(here, middle, self.part)[0].tolist()
        return x, y, z, psi if self.direction > 0 else psi + math.pi

    def at(self, s: float) -> str:
        """A place on the lane, for messages."""
        x, y, *_ = self.pose(s)
        return f"s = {s:.1f} m, ({x:.2f}, {y:.2f})"


def whole_leg(road: Road, section: int, lane: int, direction: int) -> Leg:
    """A lane through all of a section."""
    part = road.sections[section]
    start, end = (part.s, part.end) if direction > 0 else (part.end, part.s)
    return Leg(road, section, lane, direction, start, end)


class Stretch(NamedTuple):
    """A lane of a road, as far as one thing is true of it."""

    road: str
    lane: int
    begin: float  # along the road [m]
    end: float  # [m]
    reason: str | None  # why it cannot be driven; None: it can


def stretches(network: Network, narrowest: float = NARROW, *, heights: bool = True) -> Iterator[Stretch]:
    """Stretches of all lanes of a type that may be driven, and why some of them cannot be driven by a vehicle.

    Args:
        network: roads and junctions.
        narrowest: width of the vehicle [m].
        heights: True if its heights are driven too.
    """
    for road in network.roads.values():
        joined: dict[int, list[Stretch]] = {}
        numbers = ((k, lane) for k, part in enumerate(road.sections) for lane in sorted(part.lanes)[::-1])
        for leg in (whole_leg(road, k, lane, 1) for k, lane in numbers):
            own = joined.setdefault(leg.lane, [])
            for part in _parts(leg, narrowest, heights=heights) if leg.data.kind in DRIVABLE else ():
                goes_on = own and own[-1].reason == part.reason and abs(part.begin - own[-1].end) < _EPS
                own.append(own.pop()._replace(end=part.end) if goes_on else part)
        for own in joined.values():
            yield from own


def _parts(leg: Leg, narrowest: float, *, heights: bool) -> Iterator[Stretch]:
    """Parts of a lane in one section: those that are wide enough, and those that are too narrow or faulty."""
    fault = leg.road.fault(leg.span, leg.lane, heights=heights)
    if fault:
        yield Stretch(leg.road.id, leg.lane, *leg.span, fault.text)
        return
    s = np.linspace(*leg.span, max(2, math.ceil(leg.length) + 1))
    width = leg.width(s)
    fits = width >= narrowest
    cuts = [0, *(np.flatnonzero(np.diff(fits)) + 1).tolist(), len(s) - 1]
    for first, last in pairwise(cuts):
        if last > first or leg.length == 0.0:
            least = float(width[first : last + 1].min())
            reason = None if fits[first] else f"the lane is {least:.2f} m wide: must be at least {narrowest:g} m"
            yield Stretch(leg.road.id, leg.lane, float(s[first]), float(s[last]), reason)


class Joint(NamedTuple):
    """Where the begin of a lane lies, seen from the end of the lane before."""

    ahead: float  # [m]
    aside: float  # of its middle, + left [m]
    up: float  # [m]
    goes_on: bool  # the lanes meet, or one of their borders does, as where a lane becomes wider or splits


def joint(leg: Leg, lead: Leg) -> Joint:
    """How a lane goes on from another one."""
    (x, y, z, psi), after = leg.pose(leg.end), lead.pose(lead.start)
    c, s, dx, dy = math.cos(psi), math.sin(psi), after[0] - x, after[1] - y
    half, wide = (0.5 * float(one.width(np.array([at]))[0]) for one, at in ((leg, leg.end), (lead, lead.start)))
    ahead, aside = c * dx + s * dy, c * dy - s * dx
    nearest_border = min(abs(aside), abs(aside + wide - half), abs(aside - wide + half))
    return Joint(ahead, aside, after[2] - z, abs(ahead) <= _ALONG and nearest_border <= GAP)


class Way(NamedTuple):
    """A way through a junction."""

    lead: Leg  # the first lane of the way
    turn: float  # change of heading, + left [rad]
    aside: float  # where it leads to, to the left of straight on [m]
    exit: str | None  # road behind the connecting road
    word: str  # left, right or straight, among the ways from all lanes of the road that comes in


def ways(network: Network, leg: Leg) -> list[Way]:
    """Ways through the junction at the end of a lane; none if there is no junction."""
    link = leg.road.linked(leg.direction)
    at_end = not 0 <= leg.section + leg.direction < len(leg.road.sections)
    if link is None or not link.is_junction or not at_end:
        return []
    beside = [leg._replace(lane=lane.id) for lane in leg.part.lanes.values() if lane.kind in DRIVABLE]
    found = [_way(network, one, lead) for one in (leg, *beside) for lead in leads(network, one)]
    others = list({way.lead.road.id: way for way in found}.values())
    return [way._replace(word=_word(way, others)) for way in found[: len(leads(network, leg))]]


def _way(network: Network, leg: Leg, lead: Leg) -> Way:
    """Turn of the way: of all of a connecting road, or of the first metres behind a direct junction."""
    road, is_direct = lead.road, lead.road.junction is None
    reach = min(_AHEAD, road.reference.length) if is_direct else road.reference.length
    x, y, psi = road.reference.poses(lead.start + lead.direction * np.linspace(0.0, reach, 65)).T
    psi = np.unwrap(psi)
    begin, (x_end, y_end, _, travel) = lead.pose(lead.start), leg.pose(leg.end)
    t = (begin[1] - y[0]) * math.cos(psi[0]) - (begin[0] - x[0]) * math.sin(psi[0])  # of the lane from the line
    dx, dy = x[-1] - t * math.sin(psi[-1]) - x_end, y[-1] + t * math.cos(psi[-1]) - y_end
    link = road.linked(lead.direction)
    is_road = link is not None and not link.is_junction and link.id in network.roads and not is_direct
    aside = dy * math.cos(travel) - dx * math.sin(travel)
    return Way(lead, float(psi[-1] - psi[0]), float(aside), link.id if link and is_road else None, "")


def _word(way: Way, ways_on: list[Way]) -> str:
    """The turn of a way: by its angle; of those that hardly turn the one that turns least is straight on."""
    ahead = [one for one in ways_on if abs(one.turn) <= _TURNING]
    if abs(way.turn) > _TURNING:
        return "left" if way.turn > 0.0 else "right"
    straightest = min(ahead, key=lambda one: abs(one.turn))
    apart = way.aside - straightest.aside
    if abs(apart) > _APART:
        return "left" if apart > 0.0 else "right"
    forks = any(one.turn * way.turn < 0.0 for one in ahead)
    return "straight" if abs(way.turn) <= _STRAIGHT or not forks else "left" if way.turn > 0.0 else "right"


def leads(network: Network, leg: Leg, wanted: int | None = None) -> list[Leg]:
    """Lanes that go on from a lane: one at most, but for a junction; where it splits, the one that is wanted."""
    section, link = leg.section + leg.direction, leg.road.linked(leg.direction)
    linked = leg.data.linked(leg.direction)
    found: list[Leg | None] = []
    if 0 <= section < len(leg.road.sections):
        found = [_next(leg.road, section, leg.direction, linked, leg, wanted)]
    elif link is not None and link.is_junction:
        ways_on = (way for way in network.junctions.get(link.id, ()) if way.incoming == leg.road.id)
        found = [_through(network, way, leg, wanted) for way in ways_on]
    elif link is not None and link.id in network.roads:
        road = network.roads[link.id]
        if link.s is not None:
            found = [_into(road, link.s, linked, leg)]
        elif link.contact is not None:
            found = [onto(road, link.contact, linked, leg, wanted)]
    return [lead for lead in found if lead is not None]


def _through(network: Network, way: Connection, leg: Leg, wanted: int | None) -> Leg | None:
    """The lane of a junction's connecting road that goes on from a lane."""
    road = network.roads.get(way.connecting)
    if road is None or (way.lanes and leg.lane not in way.lanes):
        return None
    contact = way.contact
    if contact is None:
        comes_back = (one is not None and one.id == leg.road.id for one in (road.predecessor, road.successor))
        contact = "end" if tuple(comes_back) == (False, True) else "start"
    return onto(road, contact, way.lanes.get(leg.lane, ()), leg, wanted)


def onto(road: Road, contact: Contact, linked: tuple[int, ...], leg: Leg, wanted: int | None = None) -> Leg | None:
    """The lane at one end of a road that goes on from a lane; where no link says which, it is one that touches it."""
    direction = 1 if contact == "start" else -1
    return _next(road, 0 if direction > 0 else len(road.sections) - 1, direction, linked, leg, wanted)


def _into(road: Road, s: float, linked: tuple[int, ...], leg: Leg) -> Leg | None:
    """The lane of a road that a virtual junction leads into in the middle."""
    section = max(k for k, part in enumerate(road.sections) if part.s <= max(s, 0.0))
    found = (_next(road, section, direction, linked, leg, at=s) for direction in (1, -1))
    return next((lead for lead in found if lead and lead.data.travel == lead.direction), None)


def _next(
    road: Road,
    section: int,
    direction: int,
    linked: tuple[int, ...],
    leg: Leg,
    wanted: int | None = None,
    at: float | None = None,
) -> Leg | None:
    """The lane of a section that goes on from a lane; None if there is none of a type that may be driven."""
    lanes = road.sections[section].lanes
    same = leg.lane * leg.direction * direction
    if wanted is not None and wanted in lanes and (wanted in linked or leg.lane in lanes[wanted].linked(-direction)):
        linked = (wanted,)
    numbers = linked or sorted(lanes, key=lambda lane: (lane != same, abs(lane)))
    found = [whole_leg(road, section, lane, direction) for lane in numbers if lane in lanes]
    found = [lead if at is None else lead._replace(start=at) for lead in found if goes_on(leg, lead)]
    if not linked:
        touching = (lead for lead in found if joint(leg, lead).goes_on and lead.lane * same > 0)
        apart = (lead for lead in found if lead.lane == same and road is not leg.road)  # that a gap is said
        return next(touching, next(apart, None))
    return found[0] if found else None


def goes_on(leg: Leg, lead: Leg) -> bool:
    """True for a lane of a type that may be driven, in its direction."""
    lane = lead.data
    may = lane.both_ways or lane.travel == lead.direction or not (lane.stated or leg.data.stated)
    return may and (lane.kind in DRIVABLE or lane.kind == leg.data.kind)


def turn_word(found: list[Way], way: Way) -> str:
    """The word of a route that chooses one of the ways through a junction; the id of its road where no turn does."""
    return way.word if turning(found, way.word)[0] is way else way.lead.road.id


def turning(found: list[Way], word: str) -> list[Way]:
    """Ways that are named by a turn, the sharpest first, the straightest of those straight on."""
    sign = 1.0 if word == "straight" else -1.0
    return sorted((way for way in found if way.word == word), key=lambda way: sign * abs(way.turn))


def lanes_of(road: Road) -> str:
    """Lanes of a road by section, for messages."""
    parts = [
        f"{', '.join(map(str, sorted(part.lanes))) or 'none'} from s = {part.s:.1f} to {part.end:.1f} m"
        for part in road.sections
    ]
    same = len({tuple(sorted(part.lanes)) for part in road.sections}) == 1
    listed = ", ".join(map(str, sorted(road.sections[0].lanes))) or "none"
    return f"road {shown(road.id, 40)} has the lanes {listed if same else shown('; '.join(parts), 300)}"
