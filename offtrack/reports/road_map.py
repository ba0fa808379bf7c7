"""What a map, track or measured road holds, what of it can be driven and how; and its plan with the ids."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from offtrack.reports.plots import ESTIMATED, GREY, INK, LIMIT, STYLE, TRUE, legend_below
from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.options.course import OpenDriveOptions
from scenarios.options.scenario import load_scenario
from scenarios.roads.opendrive.file import read_opendrive
from scenarios.roads.opendrive.links import DRIVABLE, Leg, Stretch, stretches, turn_word, ways
from scenarios.roads.opendrive.network import Network, Road
from scenarios.roads.opendrive.route import lane_points
from scenarios.roads.opendrive.route_search import Request
from scenarios.roads.path_file import READABLE, PathPoints, on_one_plane, read_path, tracks_in
from vehicle.combination.unit import Unit
from vehicle.foundation.user_file import full_path
from vehicle.frames import FloatArray, arc_length

_SCENARIO: Final = "roundabout"  # whose vehicle and laws are taken
_STEP: Final = 1.0  # along a road, of what is drawn and measured [m]
_STRAIGHT: Final = 1e5  # radius of what counts as straight [m]
_LADDER: Final = ((15.0, 0.5), (30.0, 1.0), (60.0, 3.0))  # smoothing and tolerance for ever coarser points [m]
_LEVELS: Final = 10.0  # distance over which grades are measured [m]
_SIZE: Final = (9.6, 7.2)  # of the plan [in], up to
_ROADS, _MOST_SHEETS = 60, 12  # so many roads; of more it has the area of up to so many plans
_PAPER: Final[Any] = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
_MOST_LABELS: Final = 150
_MOST_TRIED: Final = 2000  # stretches of lanes on which a drive is tried, some 10 ms each
_SHORTEST: Final = 20.0  # drive that is tried [m]

Rows = list[tuple[str, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadMap:
    """What a file holds."""

    summary: str
    tables: dict[str, Rows]  # by title; the first row is the head
    drive: list[str]  # settings of a drive; empty: nothing can be driven
    remarks: list[str]
    numbers: dict[str, Any]  # ready for JSON
    roads: int  # in the plan
    draw: Callable[[Axes], None]


class Drive(NamedTuple):
    """A drive that was tried."""

    settings: list[str]
    length: float | None = None  # [m]; None: it is refused
    radius: float | None = None  # smallest one of the path [m]; None: straight
    remarks: tuple[str, ...] = ()
    reason: str | None = None  # why it is refused


def road_map(path: Path, vehicle: str | None) -> RoadMap:
    """What a file of a road or path holds; ``vehicle`` is the one that drives, None: that of the scenario.

    Raises:
        ValueError: one line, if the file cannot be read, or there is no such vehicle.
    """
    path, chosen = Path(full_path(path)), [] if vehicle is None else [f"vehicle={vehicle}"]
    tractor = vehicle_of(load_scenario(_SCENARIO, ["off_tracking=truth", *chosen])).units[0]
    if path.suffix.lower() == ".xodr":
        return _of_opendrive(path, chosen, tractor)
    if path.suffix.lower() not in READABLE.replace(",", "").split():
        raise ValueError(f"{path}: the name of a file of a road or path must end with .xodr, {READABLE}")
    return _of_tracks(path, chosen)


def write_map(shown: RoadMap, folder: Path) -> None:
    """Write plan.svg and plan.png."""
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": "road", "text.parse_math": False}):
        scale = math.sqrt(min(max(shown.roads / _ROADS, 1.0), _MOST_SHEETS))
        figure = Figure(figsize=(scale * _SIZE[0], scale * _SIZE[1]), layout="constrained", facecolor="white")
        ax = figure.subplots()
        shown.draw(ax)
        ax.set(xlabel="x [m]", ylabel="y [m]", title=shown.summary)
        ax.autoscale_view()
        ax.set_aspect("equal", adjustable="datalim")
        legend_below(figure, ax)
        figure.savefig(folder / "plan.svg", metadata={"Date": None})
        figure.savefig(folder / "plan.png", dpi=110)


def _tried(settings: list[str]) -> Drive:
    """The drive of the scenario with these settings."""
    try:
        scenario = load_scenario(_SCENARIO, ["off_tracking=truth", *settings])
        course = course_of(scenario, vehicle_of(scenario))
    except ValueError as error:
        file = next(one.partition("=")[2] for one in settings if one.startswith("course.file="))
        return Drive(settings, reason=str(error).removeprefix("course.file = ").removeprefix(f"{file}: "))
    bend = max(abs(segment.start_curvature) for segment in course.path.segments)
    return Drive(settings, course.length, _radius(bend), course.remarks)


def _radius(bend: float) -> float | None:
    return 1.0 / bend if bend * _STRAIGHT > 1.0 else None


def _number(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


# Tracks, tables and measured roads


def _of_tracks(path: Path, chosen: list[str]) -> RoadMap:
    several = tracks_in(path) if path.suffix.lower() in (".gpx", ".geojson", ".json") else []
    names = [str(k) for k in range(1, len(several) + 1)] if len(several) > 1 else [None]
    read = [_points(path, name) for name in names]
    drives = [_drive_of(path, name, chosen) for name in names]
    titles = [track.name for track in several] or [""]
    numbers = [_facts(*one, k) for k, one in enumerate(zip(read, drives, titles, strict=True), start=1)]
    best = max(drives, key=lambda drive: drive.length or 0.0)
    lines = on_one_plane(several) if len(several) > 1 else [read[0].places]
    return RoadMap(
        summary=f"{path.name}: {len(names)} track{'s' * (len(names) > 1)}",
        tables={"Tracks": [_TRACK_HEAD, *map(_track_row, numbers)]},
        drive=best.settings if best.length is not None else [],
        remarks=[_remark(one, drive, len(chosen)) for one, drive in zip(numbers, drives, strict=True)],
        numbers={"file": str(path), "tracks": numbers},
        roads=len(names),
        draw=lambda ax: _draw_tracks(ax, lines, [drive.length is not None for drive in drives]),
    )


_TRACK_HEAD: Final = ("track", "points", "length [m]", "radius [m]", "grade [%]", "jump [m]", "heights [m]")


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _track_row(one: dict[str, Any]) -> tuple[str, ...]:
    grade, heights = one["steepest_grade"], one["heights_m"]
    sizes = (one["length_m"], one["smallest_radius_m"], None if grade is None else 100.0 * grade, one["largest_jump_m"])
    range_of_heights = "-" if heights is None else f"{heights[0]:.1f} to {heights[1]:.1f}"
    return (f"{one['track']} {one['name']}", str(one["points"]), *map(_number, sizes), range_of_heights)


def _remark(one: dict[str, Any], drive: Drive, chosen: int) -> str:
    """Where a track begins, and whether it can be driven."""
    needs = [setting for setting in drive.settings[chosen + 2 :] if not setting.startswith("course.track=")]
    can = f"can be driven{' with ' * bool(needs)}{', '.join(needs)}"
    can = can if drive.reason is None else f"cannot be driven: {drive.reason}"
    place = f"begins at {one['begin']}, largest jump after {one['largest_jump_after']}"
    return f"track {one['track']} {place}; {can}"


def _points(path: Path, track: str | None) -> PathPoints:
    """Points with heights if all have one."""
    try:
        return read_path(path, track)
    except ValueError:
        return read_path(path, track, heights=False)


def _drive_of(path: Path, track: str | None, chosen: list[str]) -> Drive:
    """The drive along a track as it is, or else level, or over coarser points; or the first refusal."""
    base = [*chosen, "course.kind=path", f"course.file={path}", *([f"course.track={track}"] if track else [])]
    rungs: list[list[str]] = [[], *([f"course.smoothing={one:g}", f"course.tolerance={two:g}"] for one, two in _LADDER)]
    refused: list[Drive] = []
    for rung in rungs:
        for level in ([], ["course.heights=false"]):
            drive = _tried([*base, *rung, *level])
            if drive.length is not None:
                return drive
            refused.append(drive)
            if "course.heights" not in (drive.reason or ""):
                break
    return refused[0]


def _facts(points: PathPoints, drive: Drive, name: str, number: int) -> dict[str, Any]:
    along = arc_length(points.places)
    jumps = np.diff(along)
    heights, grade = points.heights, None
    if heights is not None and along[-1] > _LEVELS:
        grade = float(np.abs(np.diff(np.interp(np.arange(0.0, along[-1], _LEVELS), along, heights))).max()) / _LEVELS
    return {
        "track": number,
        "name": name,
        "points": len(points.places),
        "length_m": float(along[-1]),
        "smallest_radius_m": drive.radius,
        "steepest_grade": grade,
        "largest_jump_m": float(jumps.max()),
        "largest_jump_after": points.named(int(np.argmax(jumps))),
        "begin": points.named(0),
        "heights_m": None if heights is None else [float(heights.min()), float(heights.max())],
        "drivable": drive.length is not None,
        "reason": drive.reason,
        "settings": drive.settings,
    }


def _draw_tracks(ax: Axes, lines: Sequence[FloatArray], can: Sequence[bool]) -> None:
    for k, (places, drivable) in enumerate(zip(lines, can, strict=True)):
        colour, name = (TRUE, "can be driven") if drivable else (LIMIT, "cannot be driven")
        label = name if drivable not in can[:k] else None
        ax.plot(*places.T, color=colour, linewidth=1.2, marker=".", markersize=3.0, label=label)
        ax.plot(*places[0], color=colour, marker="o", markersize=7.0)
        _label(ax, places[0], f"{k + 1}: begin", colour)
        _label(ax, places[-1], f"{k + 1}: end", colour)


def _label(ax: Axes, place: FloatArray, text: str, colour: str) -> None:
    place_of_text: Any = {"xytext": (4, 4), "textcoords": "offset points"}
    ax.annotate(text, (place[0], place[1]), color=colour, fontsize=8.0, bbox=_PAPER, **place_of_text)


# OpenDRIVE


def _of_opendrive(path: Path, chosen: list[str], tractor: Unit) -> RoadMap:
    network = read_opendrive(path)
    drive = _tried([*chosen, "course.kind=opendrive", f"course.file={path}"])
    options = OpenDriveOptions(kind="opendrive", file=str(path))
    lanes = list(stretches(network, tractor.width))
    tried = len(lanes) <= _MOST_TRIED
    if tried:
        lanes = [_driven(network, lane, options, tractor) for lane in lanes]
    driven = options.points(tractor).places if drive.length is not None else None
    roads = {road.id: _road_facts(road) for road in network.roads.values()}
    through = list(_ways(network))
    remarks = [
        f"nothing can be driven as it is: {drive.reason}"
        if drive.length is None
        else f"the longest drive that needs no choice is {drive.length:.1f} m long",
        *drive.remarks,
        *(f"not read: {reason}" for reason in network.broken.values()),
        *(
            f"road {lane.road}, lane {lane.lane}, {lane.begin:.1f} to {lane.end:.1f} m: {lane.reason}"
            for lane in lanes
            if lane.reason is not None
        ),
    ]
    if not tried:
        remarks.append("too many lanes to try a drive on each: only their widths and the file's faults were judged")
    return RoadMap(
        summary=f"{path.name}: {_counted(len(roads), 'road')}, {_counted(len(network.junctions), 'junction')}",
        tables={
            "Lanes": [_LANE_HEAD, *(_lane_row(lane, roads[lane.road]) for lane in lanes)],
            "Ways through junctions": [_WAY_HEAD, *(tuple(map(str, way.values())) for way in through)],
        },
        drive=drive.settings if drive.length is not None else [],
        remarks=remarks,
        numbers={
            "file": str(path),
            "lanes": [_lane_numbers(lane) for lane in lanes],
            "roads": list(roads.values()),
            "ways": through,
            "not_read": dict(network.broken),
            "drive": {"length_m": drive.length, "reason": drive.reason, "settings": drive.settings},
        },
        roads=len(roads),
        draw=lambda ax: _draw_roads(ax, network, lanes, driven),
    )


def _driven(network: Network, lane: Stretch, options: OpenDriveOptions, tractor: Unit) -> Stretch:
    """The stretch, with the reason if a drive that begins on its lane is refused before it ends."""
    if lane.reason is not None:
        return lane
    length = max(lane.end - lane.begin, _SHORTEST)
    wanted = Request(road=lane.road, lane=lane.lane, length=length, narrowest=tractor.width)
    try:
        options.course_along(lane_points(network, wanted, ""), tractor)
    except ValueError as error:
        return lane._replace(reason=str(error).removeprefix(f"{options.source}: ").removeprefix(": "))
    return lane


_LANE_HEAD: Final = ("road", "lane", "from [m]", "to [m]", "radius [m]", "grade [%]", "drive")
_WAY_HEAD: Final = ("junction", "from road", "lane", "by road", "to road", "turn [deg]", "course.route")


def _lane_row(lane: Stretch, road: dict[str, Any]) -> tuple[str, ...]:
    place = (lane.road, str(lane.lane), _number(lane.begin), _number(lane.end))
    shape = _number(road["smallest_radius_m"]), _number(100.0 * road["steepest_grade"])
    return (*place, *shape, "yes" if lane.reason is None else "no")


def _lane_numbers(lane: Stretch) -> dict[str, Any]:
    place = {"road": lane.road, "lane": lane.lane, "from_m": lane.begin, "to_m": lane.end}
    return {**place, "drivable": lane.reason is None, "reason": lane.reason}


def _road_facts(road: Road) -> dict[str, Any]:
    s = np.linspace(0.0, road.reference.length, max(2, math.ceil(road.reference.length / _STEP) + 1))
    bends = np.abs(np.diff(np.unwrap(road.reference.poses(s)[:, 2])) / np.diff(s))
    return {
        "road": road.id,
        "junction": road.junction,
        "length_m": road.reference.length,
        "smallest_radius_m": _radius(float(bends.max())),
        "steepest_grade": float(np.abs(np.diff(road.elevation.at(s)) / np.diff(s)).max()),
        "faults": [fault.text for fault in road.faults],
    }


def _ways(network: Network) -> Iterator[dict[str, Any]]:
    """Ways through junctions, with the word of ``course.route`` that chooses each."""
    for road in (road for road in network.roads.values() if road.junction is None):
        for direction, k in ((1, len(road.sections) - 1), (-1, 0)):
            part = road.sections[k]
            ends = (part.s, part.end)[::direction]
            for lane in part.lanes.values():
                if lane.kind not in DRIVABLE or not (lane.both_ways or lane.travel == direction):
                    continue
                found, link = ways(network, Leg(road, k, lane.id, direction, *ends)), road.linked(direction)
                for way in found:
                    yield {
                        "junction": link.id if link else "",
                        "from_road": road.id,
                        "from_lane": lane.id,
                        "by_road": way.lead.road.id,
                        "to_road": way.exit or "",
                        "turn_deg": round(math.degrees(way.turn)),
                        "word": turn_word(found, way),
                    }


def _middle(road: Road, lane: int, begin: float, end: float) -> FloatArray:
    """Middle of a lane (n, 2) [m] over a stretch of its road."""
    parts = [np.empty((0, 2))]
    for part in road.sections:
        low, high = max(begin, part.s), min(end, part.end)
        if high <= low or lane not in part.lanes:
            continue
        s = np.linspace(low, high, max(2, math.ceil((high - low) / _STEP) + 1))
        inner, outer = part.borders(s, lane)
        t = road.lane_offset.at(s, part.inside) + math.copysign(0.5, lane) * (inner + outer)
        parts.append(road.places(s, t, part)[:, :2])
    return np.concatenate(parts)


def _draw_roads(ax: Axes, network: Network, lanes: Sequence[Stretch], driven: FloatArray | None) -> None:
    """Reference lines in grey, lanes in blue, red where they cannot be driven, the longest drive in orange; things."""
    roads = list(network.roads.values())
    places = [road.reference.poses(np.linspace(0.0, road.reference.length, 65))[:, :2] for road in roads]
    ax.add_collection(LineCollection(places, colors=GREY, linewidths=0.6, label="reference line"))
    for can, colour, name in ((True, TRUE, "lane to drive on"), (False, LIMIT, "lane that cannot be driven")):
        own = [lane for lane in lanes if (lane.reason is None) == can]
        lines = [_middle(network.roads[lane.road], lane.lane, lane.begin, lane.end) for lane in own]
        drawn = [(lane, line) for lane, line in zip(own, lines, strict=True) if len(line)]
        if drawn:
            ax.add_collection(LineCollection([line for _, line in drawn], colors=colour, linewidths=1.2, label=name))
        for lane, line in drawn if len(lanes) <= _MOST_LABELS else ():
            _label(ax, line[len(line) * (abs(lane.lane) % 5 + 3 * (lane.lane > 0) + 1) // 10], str(lane.lane), colour)
    things = [thing for road in roads for thing in road.things()]
    outlines = [one.outline for one in things if len(one.outline) > 1]
    points = np.array([one.outline[0] for one in things if len(one.outline) == 1]).reshape(-1, 2)
    if outlines:
        ax.add_collection(LineCollection(outlines, colors=INK, linewidths=0.8, label="object: kerb, island, building"))
    if len(points):
        ax.plot(
            *points.T, color=INK, marker="^", markersize=3.0, linestyle="none", label="signal, or object of no size"
        )
    if driven is not None:
        ax.plot(*driven.T, color=ESTIMATED, linewidth=3.0, alpha=0.5, label="longest drive that needs no choice")
        ax.plot(*driven[0], color=ESTIMATED, marker="o")
    for road, line in zip(roads, places, strict=True):
        if road.junction is None or len(roads) <= _MOST_LABELS:
            _label(ax, line[len(line) // 2], road.id if len(roads) > _ROADS else f"road {road.id}", INK)
