"""Points along the middle of the lanes of a route."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from scenarios.roads.opendrive.lane_lines import LINES, lines_between, seen_backwards
from scenarios.roads.opendrive.network import Network
from scenarios.roads.opendrive.route import Edges, Leg, Request, legs
from scenarios.roads.path_file import PathPoints
from vehicle.frames import FloatArray
from vehicle.user_file import shown

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
