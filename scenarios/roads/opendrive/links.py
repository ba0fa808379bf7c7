"""Routes along lanes: which lanes follow each other, and where a vehicle may begin.

Travel along a road is in the direction of its reference line (+1) or against it (-1). What is wrong with a road or a
link matters once a route gets there.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from scenarios.roads.opendrive.network import JUNCTION, Connection, Contact, Lane, Link, Network, Road, Section, Span
from vehicle.foundation.user_file import nearest, shown
from vehicle.frames import FloatArray

Edges = Literal["lane", "road"]
TURNS: Final = ("left", "right", "straight")
_TURNING: Final = math.radians(30.0)  # least change of heading of a turn through a junction
_STRAIGHT: Final = math.radians(10.0)  # largest one of a way straight on where another turns to the other side
_AHEAD: Final = 50.0  # of the roads behind a direct junction, or of two that part slowly [m]
_APART: Final = 0.5  # least distance there of ways that are left and right of each other [m]
_NARROW: Final = 2.5  # least width of a lane to drive on, where no vehicle is known: Directive 96/53/EC is 2.55 [m]
GAP: Final = 0.5  # largest distance between the lanes of two roads [m]: beyond it the link is wrong
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The route that is asked for."""

    road: str | None = None  # to start on; None: that of the longest drive
    lane: int | None = None  # to start on, where it begins; None: the outermost one, or that of the longest drive
    words: Sequence[str] = ()  # ids of roads, turns at junctions and changes of lane, in the order of driving
    heights: bool = True  # False: they are not driven, so that steps between roads do not matter
    edges: Edges = "lane"  # the road's edges: those of the lane, or of all paved lanes beside it
    begin: float = 0.0  # of the drive along the route [m]
    length: float | None = None  # of the drive [m]; None: to the end of the route
    narrowest: float = _NARROW  # width of a lane that can be driven [m]


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


def _leg(road: Road, section: int, lane: int, direction: int) -> Leg:
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


def stretches(network: Network, narrowest: float = _NARROW, *, heights: bool = True) -> Iterator[Stretch]:
    """Stretches of all lanes of a type that may be driven, and why some of them cannot be driven by a vehicle.

    Args:
        network: roads and junctions.
        narrowest: width of the vehicle [m].
        heights: True if its heights are driven too.
    """
    for road in network.roads.values():
        joined: dict[int, list[Stretch]] = {}
        legs = (_leg(road, k, lane, 1) for k, part in enumerate(road.sections) for lane in sorted(part.lanes)[::-1])
        for leg in legs:
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
    gap: float  # between the lanes, where not one of their borders goes on as if they became wider or split [m]
    up: float  # [m]


def joint(leg: Leg, lead: Leg) -> Joint:
    """How a lane goes on from another one."""
    (x, y, z, psi), after = leg.pose(leg.end), lead.pose(lead.start)
    c, s, dx, dy = math.cos(psi), math.sin(psi), after[0] - x, after[1] - y
    half, wide = (0.5 * float(one.width(np.array([at]))[0]) for one, at in ((leg, leg.end), (lead, lead.start)))
    ahead, aside = c * dx + s * dy, c * dy - s * dx
    has_border = min(abs(aside + wide - half), abs(aside - wide + half)) <= GAP
    return Joint(ahead, aside, abs(ahead) if has_border else max(abs(ahead), abs(aside)), after[2] - z)


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
    found = [_way(network, one, lead) for one in (leg, *beside) for lead in _leads(network, one)]
    others = list({way.lead.road.id: way for way in found}.values())
    return [way._replace(word=_word(way, others)) for way in found[: len(_leads(network, leg))]]


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


def _leads(network: Network, leg: Leg) -> list[Leg]:
    """Lanes that go on from a lane: one at most, but for a junction."""
    section, link = leg.section + leg.direction, leg.road.linked(leg.direction)
    found: list[Leg | None] = []
    if 0 <= section < len(leg.road.sections):
        found = [_next(leg.road, section, leg.direction, _linked(leg), leg)]
    elif link is not None and link.is_junction:
        ways_on = (way for way in network.junctions.get(link.id, ()) if way.incoming == leg.road.id)
        found = [_through(network, way, leg) for way in ways_on]
    elif link is not None and link.contact is not None and link.id in network.roads:
        found = [_onto(network.roads[link.id], link.contact, _linked(leg), leg)]
    return [lead for lead in found if lead is not None]


def _through(network: Network, way: Connection, leg: Leg) -> Leg | None:
    """The lane of a junction's connecting road that goes on from a lane."""
    road = network.roads.get(way.connecting)
    if road is None or (way.lanes and leg.lane not in way.lanes):
        return None
    contact = way.contact
    if contact is None:
        comes_back = (one is not None and one.id == leg.road.id for one in (road.predecessor, road.successor))
        contact = "end" if tuple(comes_back) == (False, True) else "start"
    return _onto(road, contact, way.lanes.get(leg.lane), leg)


def _onto(road: Road, contact: Contact, lane: int | None, leg: Leg) -> Leg | None:
    """The lane at one end of a road that goes on from a lane; where no link says which, it is one that touches it."""
    direction = 1 if contact == "start" else -1
    return _next(road, 0 if direction > 0 else len(road.sections) - 1, direction, lane, leg)


def _next(road: Road, section: int, direction: int, linked: int | None, leg: Leg) -> Leg | None:
    """The lane of a section that goes on from a lane; None if there is none of a type that may be driven."""
    lanes = road.sections[section].lanes
    same = leg.lane * leg.direction * direction
    numbers = [linked] if linked is not None else sorted(lanes, key=lambda lane: (lane != same, abs(lane)))
    leads = [_leg(road, section, lane, direction) for lane in numbers if lane in lanes]
    leads = [lead for lead in leads if _goes_on(leg, lead)]
    if linked is None:
        touching = (lead for lead in leads if joint(leg, lead).gap <= GAP and lead.lane * same > 0)
        return next(touching, next((lead for lead in leads if lead.lane == same), None))
    return leads[0] if leads else None


def _goes_on(leg: Leg, lead: Leg) -> bool:
    """True for a lane of a type that may be driven, in its direction."""
    lane = lead.data
    may = lane.both_ways or lane.travel == lead.direction or not (lane.stated or leg.data.stated)
    return may and (lane.kind in DRIVABLE or lane.kind == leg.data.kind)


class NotReachedError(ValueError):
    """A word of a route names what the lanes do not lead to."""


class Change(NamedTuple):
    """A change of lane, as one of the words of a route."""

    text: str
    lane: int
    start: float | None  # along the road [m]; None: as soon as it is wide enough
    over: float | None  # its length [m]; None: by its distance to the side


_CHANGE: Final = re.compile(r"lane\s+([+-]?\d+)(?:\s+from\s+([\d.]+))?(?:\s+over\s+([\d.]+))?")


def _words(network: Network, request: Request, source: str) -> list[str | Change]:
    """Words of a route, all of which must be known."""
    words: list[str | Change] = []
    for word in request.words:
        found = _CHANGE.fullmatch(word.strip())
        if found:
            lane, *numbers = found.groups()
            try:
                start, over = (None if number is None else float(number) for number in numbers)
            except ValueError:
                raise ValueError(f"{source}: course.route = {shown(word, 40)}: a number is expected") from None
            words.append(Change(word.strip(), int(lane), start, over))
        elif word in TURNS or word in network.roads or word in network.broken:
            words.append(word)
        else:
            known = nearest(word, [*(shown(name, 40) for name in network.roads), *TURNS])
            raise ValueError(
                f"{source}: course.route = {shown(word, 40)} is not reached: the file has no such road{known}"
                " (or lane ID, lane ID from S, lane ID from S over LENGTH)"
            )
    return words


class Route:
    """Lanes in the order of driving, found as far as they are asked for."""

    def __init__(self, network: Network, request: Request, first: Leg, source: str) -> None:
        self.end = ""  # why it ended
        self.is_cut = False  # True if that is since the file lacks something
        self._network, self._first, self._source = network, first, source
        self._narrowest = request.narrowest
        self._words = _words(network, request, source)
        last = self._words[-1] if self._words else None
        self._to_the_end = last is None or last in TURNS or isinstance(last, Change)
        self._named: str | None = None  # road of a word that is driven

    def __iter__(self) -> Iterator[Leg]:
        """Yields lane after lane.

        Raises:
            ValueError: one line, where the route cannot go on as it is asked to.
        """
        leg = self._enter(self._first)
        seen: set[tuple[str, int, int, int]] = set()
        while leg is not None:
            place = (leg.road.id, leg.section, leg.lane, len(self._words))
            if place in seen:
                self.end = "it comes round to its begin"
                break
            seen.add(place)
            while (changed := self._changed(leg)) is not None:
                yield leg._replace(end=changed.start)
                leg = changed
            yield leg
            leg = self._after(leg)
        if self._words:
            raise NotReachedError(
                f"{self._source}: course.route = {self._text(self._words[0])} is not reached: {self.end}"
            )

    def _enter(self, leg: Leg | None) -> Leg | None:
        """The lane, as the begin of a road that the next word may name."""
        self._named = None
        if leg is not None and self._words and self._words[0] == leg.road.id:
            self._words.pop(0)
            self._named = leg.road.id
        return leg

    def _changed(self, leg: Leg) -> Leg | None:
        """The lane that is changed to on this one; None: none on this one."""
        change = self._words[0] if self._words else None
        if not isinstance(change, Change):
            return None
        lanes = leg.part.lanes
        here = change.start is not None and leg.span.begin <= change.start < leg.span.end
        if change.lane not in lanes:
            if here:
                raise self._error(f"course.route = {change.text}: {lanes_of(leg.road)}")
            return None
        to = leg._replace(lane=change.lane, change=change.over or 0.0)
        start = change.start if here else None
        if change.start is None:
            start = _wide_from(to, self._narrowest)
        if start is None:
            return None
        between = [lane for lane in lanes if min(leg.lane, to.lane) <= lane <= max(leg.lane, to.lane)]
        if not _goes_on(leg, to) or leg.lane * to.lane < 0 or any(lanes[lane].kind not in PAVED for lane in between):
            raise self._error(
                f"course.route = {change.text}: lane {change.lane} of road {shown(leg.road.id, 40)} cannot be changed "
                f"to from lane {leg.lane} at {leg.at(start)}: it is a lane of the type {lanes[change.lane].kind}, goes "
                "the other way, or no vehicle may drive between the two"
            )
        self._words.pop(0)
        return to._replace(start=start)

    def _after(self, leg: Leg) -> Leg | None:
        """The lane that follows; None: the route ends."""
        leads, section = _leads(self._network, leg), leg.section + leg.direction
        word = self._words[0] if self._words else None
        if 0 <= section < len(leg.road.sections):
            part = leg.road.sections[section]
            split = part.lanes.get(word.lane) if isinstance(word, Change) and word.start in (None, leg.end) else None
            if split is not None and leg.lane == (split.predecessor if leg.direction > 0 else split.successor):
                self._words.pop(0)  # the lane splits: it becomes this one
                return _leg(leg.road, section, split.id, leg.direction)
            if not leads:
                raise self._error(self._lane_ends(leg, part))
            return leads[0]
        if isinstance(word, Change) and self._named == leg.road.id:
            raise self._error(f"course.route = {word.text}: {lanes_of(leg.road)}")
        if word is None and not self._to_the_end:
            self.end = f"road {shown(leg.road.id, 40)} is the last of course.route"
            return None
        link = leg.road.linked(leg.direction)
        if leads and link is not None and link.is_junction:
            return self._enter(self._chosen(leg, leads, f"junction {shown(link.id, 40)}"))
        if not leads:
            self._stop(leg, link)
        return self._enter(leads[0] if leads else None)

    def _lane_ends(self, leg: Leg, section: Section) -> str:
        linked = _linked(leg)
        lane = section.lanes.get(leg.lane if linked is None else linked)
        reason = (
            f"lane {lane.id} there is a lane of the type {shown(lane.kind, 40)}" if lane else "no lane goes on there"
        )
        if lane and lane.kind in DRIVABLE:
            reason = f"lane {lane.id} there goes the other way"
        others = [one for one in leg.part.lanes.values() if one.kind in DRIVABLE and one.id * leg.lane > 0]
        other = min((one.id for one in others if one.id != leg.lane), key=lambda one: abs(one - leg.lane), default=None)
        remedy = "" if other is None else f", or change lane (course.route = {shown(leg.road.id, 40)},lane {other})"
        return (
            f"lane {leg.lane} of road {shown(leg.road.id, 40)} ends at {leg.at(leg.end)}: {reason}; choose a "
            f"course.length that ends before{remedy}"
        )

    def _stop(self, leg: Leg, link: Link | None) -> None:
        """Note why nothing goes on at the end of a road, or refuse it."""
        here = f"road {shown(leg.road.id, 40)}"
        if link is None:
            self.end = f"{here} ends there"
            return
        known = self._network.junctions if link.is_junction else self._network.roads
        broken = self._network.broken.get((JUNCTION if link.is_junction else "") + link.id)
        there = f"{here} is linked to {'junction' if link.is_junction else 'road'} {shown(link.id, 40)}, which "
        if broken is not None:
            there += f"cannot be read: {broken}"
        elif link.id not in known:
            there += "is not in the file"
        elif link.is_junction:
            ways_on = [way.connecting for way in self._network.junctions[link.id] if way.incoming == leg.road.id]
            unread = [self._network.broken[road] for road in ways_on if road in self._network.broken]
            there += f"has no way on from lane {leg.lane}{f' that can be read: {unread[0]}' if unread else ''}"
        elif link.contact is None:
            there = f"line {link.line}: the link of {here} to road {shown(link.id, 40)} does not say "
            raise self._error(there + 'contactPoint="start" or "end"')
        else:
            lanes = lanes_of(self._network.roads[link.id])
            there += f"has no lane that goes on from lane {leg.lane} at {leg.at(leg.end)}: {lanes}"
        if broken is not None or (link.id in known and not link.is_junction):
            raise self._error(there)
        self.end, self.is_cut = there, True

    def _chosen(self, leg: Leg, leads: list[Leg], place: str) -> Leg | None:
        """The way through a junction that the next word names, or the only one."""
        word = self._words[0] if self._words else None
        if len(leads) == 1 and word not in TURNS:
            return leads[0]  # what the word names comes later
        found = ways(self._network, leg)
        named = [way for way in found if word in (way.lead.road.id, way.exit)]
        if word in TURNS:
            named = _turning(found, str(word))
        listed = ", ".join(
            f"{way.lead.road.id} ({way.word}, {math.degrees(way.turn):+.0f} deg"
            f"{f' to road {way.exit}' if way.exit else ''})"
            for way in found
        )
        if named and word in TURNS:
            self._words.pop(0)
        elif not named and word is not None:
            raise self._error(
                f"{place}: course.route = {self._text(word)} fits no way; there are: {shown(listed, 300)}"
            )
        elif not named:
            self.end = f"{place} leaves a choice: {shown(listed)}"
        return named[0].lead if named else None

    def _text(self, word: str | Change) -> str:
        return word.text if isinstance(word, Change) else shown(word, 40)

    def _error(self, message: str) -> ValueError:
        return ValueError(f"{self._source}: {message}")


def _linked(leg: Leg) -> int | None:
    """The lane that a lane is linked to, in the direction of travel."""
    return leg.data.successor if leg.direction > 0 else leg.data.predecessor


def turn_word(found: list[Way], way: Way) -> str:
    """The word of a route that chooses one of the ways through a junction; the id of its road where no turn does."""
    return way.word if _turning(found, way.word)[0] is way else way.lead.road.id


def _turning(found: list[Way], word: str) -> list[Way]:
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


def _wide_from(leg: Leg, narrowest: float) -> float | None:
    """Where a lane is wide enough to begin on, along the road [m]; None if it is nowhere."""
    s = np.linspace(leg.start, leg.end, max(2, math.ceil(leg.length) + 1))
    fits = leg.width(s) >= narrowest - _EPS
    return float(s[np.argmax(fits)]) if fits.any() else None


def starts(network: Network, request: Request, source: str) -> list[Leg]:
    """Lanes to start on, the best one first: the longest drive that needs no word, along the road, outermost.

    Raises:
        ValueError: one line, if there is none.
    """
    word = request.words[0] if request.words and request.words[0] in {*network.roads, *network.broken} else None
    name, unread = word if request.road is None else request.road, next(iter(network.broken.values()), "")
    if name is not None and name in network.broken:
        raise ValueError(f"{source}: road {shown(name, 40)} cannot be read: {network.broken[name]}")
    if name is not None and name not in network.roads:
        like = nearest(name, [shown(one, 40) for one in network.roads])
        raise ValueError(f"{source}: course.road = {shown(name, 40)}{like}{f'; not read: {unread}' if unread else ''}")
    roads = list(network.roads.values()) if name is None else [network.roads[name]]
    roads = [road for road in roads if road.junction is None] or roads
    if not roads:
        raise ValueError(f"{source}: no road can be read: {unread}")
    begins = [leg for road in roads for leg in _begins(road, request.lane)]
    fitting = [leg._replace(start=s) for leg in begins if (s := _wide_from(leg, request.narrowest)) is not None]
    if not fitting:
        raise ValueError(f"{source}: {_no_start(roads, begins, request)}")
    if len(fitting) == 1:
        return fitting
    known: dict[tuple[str, int, int], float] = {}
    reach = {leg: round(_reach(network, leg, request.narrowest, known)) for leg in fitting}
    return sorted(fitting, key=lambda leg: (-reach[leg], leg.data.kind != "driving", -leg.direction, -abs(leg.lane)))


def _no_start(roads: Sequence[Road], begins: Sequence[Leg], request: Request) -> str:
    """Why no drive can begin on some roads."""
    if begins:
        leg = begins[0]
        widest = float(leg.width(np.linspace(leg.start, leg.end, 65)).max())
        return (
            f"lane {leg.lane} of road {shown(leg.road.id, 40)}: the road is {widest:.2f} m wide at most, at "
            f"{leg.at(leg.start)}: must be at least {request.narrowest:g} m"
        )
    faults = [fault.text for road in roads for fault in road.faults]
    if faults:
        return f"no lane can be driven: {faults[0]}"
    if request.lane is None:
        return f"road {shown(roads[0].id, 40)} has no lane of the type driving: name one in course.lane"
    return f"course.lane = {request.lane}: {lanes_of(roads[0]) if len(roads) == 1 else 'no road has such a lane'}"


def _reach(network: Network, first: Leg, narrowest: float, known: dict[tuple[str, int, int], float]) -> float:
    """How far a drive leads that no word guides [m]; ``known`` has that of lanes that were met before."""
    chain: dict[tuple[str, int, int], float] = {}
    beyond, leads = 0.0, [first]
    while len(leads) == 1:
        leg = leads[0]
        place = (leg.road.id, leg.section, leg.lane)
        if place in known or place in chain:
            beyond = known.get(place, 0.0)
            break
        chain[place] = leg.length
        is_narrow = float(leg.width(np.array([leg.end]))[0]) < narrowest
        leads = [] if is_narrow else _leads(network, leg)
    for place, length in reversed(chain.items()):
        known[place] = beyond = beyond + length
    return beyond


def _begins(road: Road, wanted: int | None) -> Iterator[Leg]:
    """Lanes where they begin: those that may be driven, or the one that is wanted."""
    for direction in (1, -1):
        numbers = range(len(road.sections))[::direction]
        legs = [
            _leg(road, k, lane.id, direction)
            for k in numbers
            for lane in road.sections[k].lanes.values()
            if (lane.both_ways or lane.travel == direction)
            and (lane.kind in DRIVABLE if wanted is None else lane.id == wanted)
        ]
        if wanted is not None:
            yield from sorted(legs, key=lambda leg: leg.data.kind not in DRIVABLE)[:1]
            continue
        for leg in legs:
            before = leg.section - direction
            back = leg.data.predecessor if direction > 0 else leg.data.successor
            others = road.sections[before].lanes if before in numbers else {}
            come = others.get(leg.lane if back is None else back)
            if come is None or come.kind not in DRIVABLE:
                yield leg
