"""Points along the lanes of a route, with the painted lines along them.

Each place along the lane has a row of ``LINES`` lines, from right to left. The line on the lane's right is number
``LINES // 2 - 1``, the one on its left comes next, wherever the road gets or loses lanes beside them.
"""

import bisect
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from scenarios.roads.opendrive.links import GAP, PAVED, Leg, joint
from scenarios.roads.opendrive.network import LineKind, Network, Section, Span
from scenarios.roads.opendrive.route_search import NotReachedError, Request, Route, starts
from scenarios.roads.path_file import PathPoints
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray

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
_STEP: Final = 0.1  # largest difference of the heights of two lanes [m]: it becomes a ramp as long as the smoothing
_LONGEST: Final = 50e3  # route [m], as of any course
_ASIDE: Final = 0.02  # step to the side that is left to the smoothing [m]
_CHANGE: Final = (
    50.0  # length of a change by a lane of 3.5 m [m]: 1.3 m/s2 at 50 km/h; others by the root of the distance
)
_LANE: Final = 3.5  # [m]
_SHORTEST: Final = 10.0  # drive of a combination [m]
_SHORT: Final = 1.0  # a drive is so much shorter than it is asked for before that is said [m]
_SEEN: Final = 40.0  # ahead and behind [m]
_INSTANT: Final = 1e-6  # on either side of a jump [m]
_MARK: Final = np.array([[0.0, 0.4], [-0.35, -0.2], [0.35, -0.2], [0.0, 0.4]])  # of what has no size [m]
_TRIED: Final = 25  # lanes to start on, until one can be driven

# columns of a table of points
_U, _S, _X, _Y, _Z, _PSI, _BANK, _LEFT, _RIGHT, _ROAD_LEFT, _ROAD_RIGHT = range(11)


def lane_points(network: Network, request: Request, source: str) -> PathPoints:
    """Points along the middle of the lanes of a route, with heights, banks, edges, and what a user should know of it.

    Where no lane to start on is asked for, it is that of the longest drive that is possible.

    Raises:
        ValueError: one line with the roads' ids, if there is no such route.
    """
    faulty: list[ValueError] = []
    refused: list[ValueError] = []
    found = starts(network, request, source)
    named = request.lane is not None and (request.road is not None or bool(request.words))
    for first in found[: 1 if named else _TRIED]:
        try:
            drive = _Drive(network, request, first, source)
            return drive.points(
                [f"another lane was chosen than that of the longest drive: {one}" for one in faulty[:1]]
            )
        except NotReachedError as error:
            refused.append(error)
        except ValueError as error:
            faulty.append(error)
    raise (faulty or refused)[0]


class _Drive:
    """The stretch of a route that is driven, as a table of points."""

    def __init__(self, network: Network, request: Request, first: Leg, source: str) -> None:
        self._request, self._source = request, source
        self._wanted = math.inf if request.length is None else request.begin + request.length
        self._legs: list[Leg] = []
        self._rows: list[FloatArray] = []  # of each leg, with the distance along the route as first column
        self._shifts: list[_Shift] = []
        self._along = 0.0  # [m]
        self._moved = 0  # changes of lane to the right
        self._seen: dict[str, None] = {}  # faults beside the drive, in the order of driving
        route = Route(network, request, first, source)
        try:
            self._follow(route)
        except ValueError:
            if self._along <= self._wanted - _SHORT:
                raise
        self._remarks, self._network = list(self._ending(route, network)), network

    def _follow(self, route: Route) -> None:
        for leg in route:
            for part in _smooth_parts(leg):
                self._append(part)
            if self._along >= self._wanted:
                break
            if self._along > _LONGEST:
                raise self._error(f"the route is longer than {1e-3 * _LONGEST:g} km")

    def _error(self, message: str) -> ValueError:
        return ValueError(f"{self._source}: {message}")

    def _append(self, leg: Leg) -> None:
        """Add a lane, if the drive there is possible."""
        table = _points(leg)
        steps = np.hypot(*np.diff(table[:, [_X, _Y]], axis=0).T)
        table[:, _U] = self._along + np.concatenate([[0.0], np.cumsum(steps)])
        if self._legs:
            last = self._legs[-1]
            table[:, _U] += self._join(last, leg)
            if leg.change is not None:
                outwards = 1 if leg.lane * leg.direction < 0 else -1  # to the right where traffic drives on the right
                self._moved += outwards * (abs(leg.lane) - abs(last.lane))
        if self._moved:  # each line keeps its number
            table[:, _ROAD_RIGHT + 1 :] = np.roll(table[:, _ROAD_RIGHT + 1 :], -2 * self._moved, axis=1)
        ends = np.interp((self._request.begin, self._wanted), table[:, _U], table[:, _S])
        span = Span(float(ends.min()), float(ends.max()))
        if span.begin < span.end:
            fault = leg.road.fault(span, leg.lane, heights=self._request.heights)
            if fault is not None:
                raise self._error(fault.text)
            near = Span(span.begin - _SEEN, span.end + _SEEN)
            self._seen |= {one.text: None for one in leg.road.faults if one.begin < near.end and one.end > near.begin}
        self._along = float(table[-1, _U])
        self._legs.append(leg)
        self._rows.append(table)

    def _join(self, leg: Leg, lead: Leg) -> float:
        """How far ahead of the end of a lane the next one begins [m]; refuses one that begins elsewhere, or higher."""
        found, place = joint(leg, lead), f"the begin of road {shown(lead.road.id, 40)}, at {lead.at(lead.start)}"
        if lead.road is leg.road:
            place = f"road {shown(lead.road.id, 40)}, at {lead.at(lead.start)}"
        if self._along > self._request.begin and lead.change is None:
            if not found.goes_on:
                gap = max(abs(found.ahead), abs(found.aside))
                raise self._error(
                    f"a gap of {gap:.3g} m between the lanes at {place}, from lane {leg.lane} to {lead.lane}: must be "
                    f"at most {GAP:g} m; choose a course.length that ends before, or another lane"
                )
            if self._request.heights and abs(found.up) > _STEP:
                raise self._error(
                    f"a step of {found.up:+.3g} m in height between the lanes at {place}: must be at most {_STEP:g} m; "
                    "course.heights = false drives it level"
                )
        if abs(found.aside) > _ASIDE:
            over = lead.change or max(_SPACING, _CHANGE * math.sqrt(abs(found.aside) / _LANE))
            half = [0.5 * float(one.width(np.array([at]))[0]) for one, at in ((leg, leg.end), (lead, lead.start))]
            before = lead.change is None and half[0] > half[1]  # a wide lane leaves room for it
            self._shifts.append(
                _Shift(self._along, found.aside, min(over, self._along) if before else over, before, half[0])
            )
        return found.ahead

    def _ending(self, route: Route, network: Network) -> Iterator[str]:
        """What a user should know of the drive."""
        length, asked = min(self._along, self._wanted) - self._request.begin, self._request.length
        first = self._legs[0]
        if 0.0 < length < _SHORTEST - _ASIDE:
            raise self._error(
                f"the drive from lane {first.lane} of road {shown(first.road.id, 40)}, {first.at(first.start)}, is "
                f"{length:.2f} m long: must be at least {_SHORTEST:g} m; {route.end}"
            )
        if route.is_cut or (asked is not None and length < asked - _SHORT):
            wanted = "" if asked is None else f", not course.length = {asked:g} m"
            yield f"course.file: the drive is {max(length, 0.0):.1f} m long{wanted}: {route.end}"
        roads = {leg.road.id: leg.road for leg in self._legs}.values()
        links = {link.id for road in roads for link in (road.predecessor, road.successor) if link is not None}
        for text in [*self._seen, *(network.broken[name] for name in sorted(links & network.broken.keys()))]:
            yield f"course.file: near the drive, but not driven: {text}"

    def points(self, remarks: Sequence[str]) -> PathPoints:
        """The points that are driven."""
        table = np.concatenate(self._rows)
        table = table[_spread(table[:, _U])]
        for shift in self._shifts:
            shift.apply(table)
        table = self._cut(table)
        lines = table[:, _ROAD_RIGHT + 1 :].reshape(-1, LINES, 2)
        jumps = np.abs(np.diff(lines[:, :, 0], axis=0)) > 0.5 * _SPACING
        lines[1:][jumps] = np.nan  # nothing is painted from one line to another
        lane, road = table[:, [_LEFT, _RIGHT]], table[:, [_ROAD_LEFT, _ROAD_RIGHT]]
        return PathPoints(
            places=table[:, [_X, _Y]],
            heights=table[:, _Z],
            banks=table[:, _BANK],
            widths=lane if self._request.edges == "lane" else road,
            lanes=lane,
            paved=road,
            lines=None if np.isnan(lines).all() else lines,
            things=tuple(self._things(table[:, [_X, _Y]])),
            remarks=(*remarks, *self._remarks),
            rows=np.arange(len(table), dtype=np.float64),
            where=lambda row: self._named(*table[row, [_U, _S, _X, _Y]].tolist()),
        )

    def _things(self, places: FloatArray) -> Iterator[FloatArray]:
        """Outlines of what stands beside the drive; a point becomes a small triangle."""
        tree = scipy.spatial.KDTree(places)
        roads = list(self._network.roads.values())
        away, _ = tree.query(np.array([road.reference.pieces[0].start[:2] for road in roads]))
        for road, to_begin in zip(roads, np.asarray(away).tolist(), strict=True):
            for thing in road.things() if to_begin < _SEEN + road.reference.length else ():
                outline = thing.outline if len(thing.outline) > 1 else thing.outline + _MARK
                if np.min(tree.query(outline)[0]) < _SEEN:
                    yield outline

    def _named(self, along: float, s: float, x: float, y: float) -> str:
        """A place on the route, for messages."""
        leg = self._legs[max(0, bisect.bisect_right(self._rows, along, key=lambda rows: float(rows[0, _U])) - 1)]
        return f"road {shown(leg.road.id, 40)}, lane {leg.lane}, s = {s:.1f} m, ({x:.2f}, {y:.2f})"

    def _cut(self, table: FloatArray) -> FloatArray:
        """The rows between the begin and the end of the drive, with a row at each of them."""
        begin, end = self._request.begin, self._wanted
        if begin >= self._along - _SPACING:
            raise self._error(f"the path is {self._along:.4g} m long: course.begin = {begin:g} m leaves nothing of it")
        u, room = table[:, _U], 0.5 * _SPACING
        first, last = (
            [[np.interp(place, u, column) for column in table.T]] if u[0] < place < u[-1] else table[:0]
            for place in (begin, end)
        )
        inside = (u > begin + room if len(first) else u >= begin) & (u < end - room if len(last) else u <= end)
        return np.concatenate([first, table[inside], last])


def _spread(along: FloatArray) -> NDArray[np.bool_]:
    """Which points are not nearer to the last one that is kept than half the spacing: a road begins where one ends."""
    kept = np.zeros(len(along), dtype=bool)
    last = -math.inf
    for k, here in enumerate(along.tolist()):
        if here >= last + 0.5 * _SPACING:
            kept[k], last = True, here
    return kept


@dataclass(frozen=True, slots=True)
class _Shift:
    """A change to the side, from the lane that ends at a place to the one that begins there."""

    place: float  # along the route [m]
    aside: float  # of the lane that begins, + left [m]
    over: float  # length of the change [m]
    before: bool  # on the lane that ends; False: on the one that begins
    half: float  # half the width of the lane that ends [m]

    def apply(self, table: FloatArray) -> None:
        """Move the points of a table, and with them what lies beside them."""
        u = (table[:, _U] - self.place) / self.over + (1.0 if self.before else 0.0)
        rows = (u >= 0.0) & (u <= 1.0) & ((table[:, _U] <= self.place) == self.before)
        t = u[rows]
        share = t**3 * (10.0 - t * (15.0 - 6.0 * t))
        shift = self.aside * (share if self.before else share - 1.0)
        sine, cosine = np.sin(table[rows, _PSI]), np.cos(table[rows, _PSI])
        if not self.before:  # the road of both lanes is there to drive on
            for side, lane, road in ((1.0, _LEFT, _ROAD_LEFT), (-1.0, _RIGHT, _ROAD_RIGHT)):
                other = np.minimum(self.half - side * self.aside, table[rows, road])
                table[rows, lane] = np.maximum(table[rows, lane], other)
        table[rows, _X] -= shift * sine
        table[rows, _Y] += shift * cosine
        table[rows, _Z] += shift * table[rows, _BANK]
        for column in (_LEFT, _ROAD_LEFT):
            table[rows, column] -= shift
        for column in (_RIGHT, _ROAD_RIGHT):
            table[rows, column] += shift
        table[np.flatnonzero(rows)[:, None], np.arange(_ROAD_RIGHT + 1, table.shape[1], 2)] -= shift[:, None]


def _smooth_parts(leg: Leg) -> list[Leg]:
    """A lane in parts between the places where a record moves it to the side at once."""
    records = [leg.road.lane_offset.begins]
    numbers = range(1, abs(leg.lane) + 1)
    inner = (leg.part.lanes.get(number if leg.lane > 0 else -number) for number in numbers)
    records += [leg.part.s + lane.width.begins for lane in inner if lane is not None]
    places = np.unique(np.concatenate(records))
    within = leg.part.inside
    places = places[(places > max(within.begin, leg.span.begin)) & (places < min(within.end, leg.span.end))]
    cuts = []
    for place in places.tolist():
        before, after = leg.pose(place - _INSTANT), leg.pose(place + _INSTANT)
        if math.dist(before[:2], after[:2]) > _ASIDE:
            cuts.append(place)
    ends = [leg.start, *cuts[:: leg.direction], leg.end]
    inset = leg.direction * _INSTANT
    return [
        leg._replace(
            start=a + (inset if k else 0.0),
            end=b - (inset if b != leg.end else 0.0),
            change=None if k else leg.change,
        )
        for k, (a, b) in enumerate(pairwise(ends))
    ]


def _points(leg: Leg) -> FloatArray:
    """Rows (n, 11 + 2 LINES) along a lane in the direction of travel.

    Distance along the route (not known here) and along the road, x, y, z [m], direction of travel [rad], bank [-],
    widths to the lane's left and right border and to the road's edges [m]; place to the left [m] and kind of each line.
    """
    road, section = leg.road, leg.part
    s = np.linspace(*leg.span, max(2, math.ceil(leg.length / _SPACING) + 1))
    side = 1.0 if leg.lane > 0 else -1.0
    inner, outer = (side * border for border in section.borders(s, leg.lane))
    offset = road.lane_offset.at(s, section.inside)
    middle = offset + 0.5 * (inner + outer)
    paved = _paved(leg)
    borders = [(1.0 if lane > 0 else -1.0) * border for lane in paved for border in section.borders(s, lane)]
    low, high = np.minimum.reduce(borders), np.maximum.reduce(borders)
    lines = lines_between(section, leg.lane, paved, s, middle - offset)
    ends = [road.cross_sections.height(s, offset + border, section.inside) for border in (inner, outer)]
    width = np.where(np.abs(outer - inner) > 0.0, outer - inner, 1.0)
    bank = np.tan(
        road.superelevation.at(s, section.inside) + np.arctan((ends[1] - ends[0]) / width)
    )  # mean of the lane
    half, left, right = 0.5 * np.abs(outer - inner), offset + high - middle, middle - offset - low
    places = road.places(s, middle, section)
    if leg.direction < 0:
        bank, left, right, lines = -bank, right, left, seen_backwards(lines)
        places[:, 3] += math.pi
    columns = (np.zeros(len(s)), s, places, bank, half, half, left, right, lines.reshape(len(s), -1))
    return np.column_stack(columns)[:: leg.direction]


def _paved(leg: Leg) -> list[int]:
    """Ids of the lane and of the paved lanes that join it without one between that is not paved, rising."""
    lanes = leg.part.lanes
    ids = sorted(lanes)
    first = last = ids.index(leg.lane)
    while first > 0 and lanes[ids[first - 1]].kind in PAVED:
        first -= 1
    while last + 1 < len(ids) and lanes[ids[last + 1]].kind in PAVED:
        last += 1
    return ids[first : last + 1]
