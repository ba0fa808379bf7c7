"""Routes along lanes, as they are asked for, and where a vehicle may begin.

What is wrong with a road or a link matters once a route gets there.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from scenarios.roads.opendrive.links import (
    DRIVABLE,
    NARROW,
    PAVED,
    TURNS,
    Edges,
    Leg,
    goes_on,
    joint,
    lanes_of,
    leads,
    onto,
    turning,
    ways,
    whole_leg,
)
from scenarios.roads.opendrive.network import JUNCTION, Contact, Link, Network, Road, Section
from vehicle.foundation.user_file import nearest, shown

_EPS: Final = 1e-6  # [m]


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
    narrowest: float = NARROW  # width of a lane that can be driven [m]


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
            aside = self._aside(leg)
            yield leg if aside is None else aside[0]
            leg = self._after(leg) if aside is None else self._enter(aside[1])
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

    def _aside(self, leg: Leg) -> tuple[Leg, Leg] | None:
        """The lane up to where a virtual junction leads aside to the road that comes next, and that road's lane."""
        road = self._network.roads.get(str(self._words[0])) if self._words else None
        if road is None:
            return None
        ends: tuple[tuple[Contact, Link | None], ...] = (("start", road.predecessor), ("end", road.successor))
        for contact, link in ends:
            if link is None or link.s is None or link.id != leg.road.id:
                continue
            ahead, along = leg._replace(end=link.s), (link.s - leg.start) * leg.direction
            lead = onto(road, contact, (), ahead) if 0.0 <= along <= leg.length else None
            if lead is not None and joint(ahead, lead).goes_on:
                return ahead, lead
        return None

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
        if not goes_on(leg, to) or leg.lane * to.lane < 0 or any(lanes[lane].kind not in PAVED for lane in between):
            raise self._error(
                f"course.route = {change.text}: lane {change.lane} of road {shown(leg.road.id, 40)} cannot be changed "
                f"to from lane {leg.lane} at {leg.at(start)}: it is a lane of the type {lanes[change.lane].kind}, goes "
                "the other way, or no vehicle may drive between the two"
            )
        self._words.pop(0)
        return to._replace(start=start)

    def _after(self, leg: Leg) -> Leg | None:
        """The lane that follows; None: the route ends."""
        word = self._words[0] if self._words else None
        split = word.lane if isinstance(word, Change) and word.start in (None, leg.end) else None
        following, section = leads(self._network, leg, split), leg.section + leg.direction
        if split is not None and [lead.lane for lead in following] == [split]:
            self._words.pop(0)  # the lane splits, or it becomes this one
            return self._enter(following[0])
        if 0 <= section < len(leg.road.sections):
            if not following:
                raise self._error(self._lane_ends(leg, leg.road.sections[section]))
            return following[0]
        if isinstance(word, Change) and self._named == leg.road.id:
            raise self._error(f"course.route = {word.text}: {lanes_of(leg.road)}")
        if word is None and not self._to_the_end:
            self.end = f"road {shown(leg.road.id, 40)} is the last of course.route"
            return None
        link = leg.road.linked(leg.direction)
        if following and link is not None and link.is_junction:
            return self._enter(self._chosen(leg, following, f"junction {shown(link.id, 40)}"))
        if not following:
            self._stop(leg, link)
        return self._enter(following[0] if following else None)

    def _lane_ends(self, leg: Leg, section: Section) -> str:
        lane = section.lanes.get(next(iter(leg.data.linked(leg.direction)), leg.lane))
        reason = (
            f"lane {lane.id} there is a lane of the type {shown(lane.kind, 40)}" if lane else "no lane goes on there"
        )
        if lane and lane.kind in DRIVABLE:
            reason = (
                f"lane {lane.id} there {'does not touch it' if lane.travel == leg.direction else 'goes the other way'}"
            )
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
        elif link.contact is None and link.s is None:
            there = f"line {link.line}: the link of {here} to road {shown(link.id, 40)} does not say "
            raise self._error(there + 'contactPoint="start" or "end"')
        else:
            lanes = lanes_of(self._network.roads[link.id])
            there += f"has no lane that goes on from lane {leg.lane} at {leg.at(leg.end)}: {lanes}"
        if broken is not None or (link.id in known and not link.is_junction):
            raise self._error(there)
        self.end, self.is_cut = there, True

    def _chosen(self, leg: Leg, following: list[Leg], place: str) -> Leg | None:
        """The way through a junction that the next word names, or the only one."""
        word = self._words[0] if self._words else None
        if len(following) == 1 and word not in TURNS:
            return following[0]  # what the word names comes later
        found = ways(self._network, leg)
        named = [way for way in found if word in (way.lead.road.id, way.exit)]
        if word in TURNS:
            named = turning(found, str(word))
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
    beyond, following = 0.0, [first]
    while len(following) == 1:
        leg = following[0]
        place = (leg.road.id, leg.section, leg.lane)
        if place in known or place in chain:
            beyond = known.get(place, 0.0)
            break
        chain[place] = leg.length
        is_narrow = float(leg.width(np.array([leg.end]))[0]) < narrowest
        following = [] if is_narrow else leads(network, leg)
    for place, length in reversed(chain.items()):
        known[place] = beyond = beyond + length
    return beyond


def _begins(road: Road, wanted: int | None) -> Iterator[Leg]:
    """Lanes where they begin: those that may be driven, or the one that is wanted."""
    for direction in (1, -1):
        numbers = range(len(road.sections))[::direction]
        legs = [
            whole_leg(road, k, lane.id, direction)
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
            others = road.sections[before].lanes if before in numbers else {}
            come = (others[lane] for lane in leg.data.linked(-direction) or (leg.lane,) if lane in others)
            if all(lane.kind not in DRIVABLE for lane in come):
                yield leg
