"""A playback: everything that a page, a figure or a film shows of one run or several over time; those of runs.

Lengths in m, angles in rad, times in s; in the ground's plane x points along the first heading, y to the left.
Signals are named as in the run's log.
A colour is a name of the palette (``web/theme.js`` for pages, ``PALETTE`` for figures and films).
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.estimates import Health
from scenarios.results.log import HEALTH, HEALTH_WORDS, LOST, OK, Log, Signal
from scenarios.results.rover_result import RoverResult, trace_lines
from scenarios.results.swept_path import UnitOutline, placed
from scenarios.results.trailer_result import CameraFrame, FrictionPicture, RunResult, clearances
from vehicle.clock import TICK
from vehicle.frames import FloatArray, sides

Colour = Literal["true", "estimated", "grey", "ink", "third", "fourth", "fifth", "sixth", "ok", "degraded", "lost"]
PALETTE: Final[Mapping[Colour, str]] = {  # apart for colour-blind readers too
    "true": "#1f5fa8",
    "estimated": "#e0761a",
    "grey": "#8b95a1",
    "ink": "#27313b",
    "third": "#2a9d8f",
    "fourth": "#8e5ea2",
    "fifth": "#b3261e",
    "sixth": "#6b7a2a",
    "ok": "#2a9d8f",
    "degraded": "#e9b949",
    "lost": "#d64a3f",
}
SERIES: tuple[Colour, ...] = ("true", "estimated", "third", "fourth", "fifth", "sixth")  # of axles, wheels and units


class Wheel(NamedTuple):
    """A wheel from above, in its body's frame."""

    x: float  # its middle [m]
    y: float
    length: float  # [m]
    width: float  # [m]
    steer: str = ""  # signal of its steer angle; empty: it is not steered


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A rigid body that moves over the ground."""

    name: str
    outline: FloatArray  # (m, 2) corners in its frame [m]
    wheels: tuple[Wheel, ...]
    pose: tuple[str, str, str]  # signals x, y, psi
    tilt: tuple[str, str] | None = None  # signals of roll and pitch
    heights: tuple[float, float]  # of its underside and its top in the 3-D view [m]

    def poses(self, log: Log) -> FloatArray:
        """x [m], y [m], psi [rad] over time, (n, 3)."""
        return np.column_stack([log[name] for name in self.pose])

    def wheel_corners(self, log: Log, rows: NDArray[np.intp]) -> FloatArray:
        """Corners of all wheels in the world at these rows, (n_rows * n_wheels, 4, 2) [m]."""
        poses, corners = self.poses(log)[rows], [np.empty((0, 4, 2))]
        for wheel in self.wheels:
            steer = np.nan_to_num(log[wheel.steer][rows]) if wheel.steer else 0.0
            middle = placed(np.array([[wheel.x, wheel.y]]), poses)[:, 0]
            size = 0.5 * np.array([wheel.length, wheel.width])
            tyre = size * [[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]
            corners.append(placed(tyre, np.column_stack([middle, poses[:, 2] + steer])))
        return np.concatenate(corners)


class Trail(NamedTuple):
    """A path that is drawn as it is driven: of a point of a body, or of two signals."""

    label: str
    colour: Colour
    body: int = -1  # index of the body that carries the point
    point: tuple[float, float] = (0.0, 0.0)  # in the body's frame [m]
    signals: tuple[str, str] = ("", "")  # x, y without a body


class EstimatedPath(NamedTuple):
    """Path that an estimator states: points beside a point of a body, with their standard deviation."""

    label: str
    body: int
    point: tuple[float, float]  # in the body's frame [m]
    offset: str  # signal of the lateral distance, + left [m]
    std: str  # signal of its standard deviation [m]
    health: str  # signal; estimates that are lost are not drawn


class Span(NamedTuple):
    """A band along the time axis."""

    label: str
    colour: Colour
    start: float  # [s]
    end: float  # [s]


class Peak(NamedTuple):
    """The moment that a page opens at: where a deviation is largest."""

    time: float = 0.0  # [s]
    size: float = 0.0  # in the unit of the deviation


def peak_of(log: Log, signal: str) -> Peak:
    """Where a signal is largest, to either side; the start if it has no value."""
    if signal not in log or not np.isfinite(log[signal]).any():
        return _START
    row = int(np.nanargmax(np.abs(log[signal])))
    return Peak(float(log["time"][row]), float(abs(log[signal][row])))


_START: Final = Peak()


class Line(NamedTuple):
    """A line on the ground that does not change."""

    label: str
    colour: Colour
    points: FloatArray  # (n, 2) [m]
    width: float = 0.0  # [m]; 0: a thin line


class Road(NamedTuple):
    """A road's surface between two edges."""

    left: FloatArray  # (n, 2) [m]
    right: FloatArray  # (n, 2) [m]


class Curve(NamedTuple):
    """A curve of a chart."""

    signal: str
    label: str
    colour: Colour
    style: Literal["line", "dots", "dashed", "band"] = "line"  # a band: two standard deviations around its base
    scale: float = 1.0  # from the signal's unit to the chart's
    base: str = ""  # signal that a band surrounds; empty: zero
    less: str = ""  # signal that is subtracted


class Chart(NamedTuple):
    """Curves over time with one axis."""

    title: str
    unit: str
    curves: Sequence[Curve]
    digits: int = 3
    limit: float | None = None  # drawn to both sides of zero


class Reading(NamedTuple):
    """A number that is shown for the present time; of a sparse signal its latest value."""

    label: str
    signal: str
    unit: str
    scale: float = 1.0
    digits: int = 2
    colour: Colour = "ink"


class Picture(NamedTuple):
    """A camera's image with strokes over it."""

    time: float  # of its capture [s]
    jpeg: bytes
    strokes: NDArray[np.float32]  # (n, 4) start u, v and end u, v [px]
    caption: str = ""
    lines: tuple[int, ...] = ()  # strokes that make up the true line and the estimated one; empty: motions of features


class Camera(NamedTuple):
    """A camera's place and view, for its frustum in the 3-D view."""

    body: int
    X_BC: FloatArray  # (4, 4) pose of the camera in the body's frame, z along its axis
    half_width: float  # tangent of half the field of view
    half_height: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlayedRun:
    """One run: its signals, and what they move."""

    name: str
    log: Log
    bodies: tuple[Body, ...]
    trails: tuple[Trail, ...] = ()
    estimated: EstimatedPath | None = None
    spans: tuple[Span, ...] = ()
    pictures: Sequence[Picture] = ()
    cameras: tuple[Camera, ...] = ()
    lines: tuple[Line, ...] = ()  # that lie on its ground
    peak: Peak = _START
    link: str = ""  # address of the run's own page, relative to this one

    def trail_points(self, trail: Trail) -> FloatArray:
        """A trail over time, (n, 2) [m]."""
        if trail.body < 0:
            return np.column_stack([self.log[name] for name in trail.signals])
        return placed(np.array([trail.point]), self.bodies[trail.body].poses(self.log))[:, 0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Playback:
    """What a page plays."""

    title: str
    runs: tuple[PlayedRun, ...]
    together: bool = True  # runs are laid over each other; else one at a time is chosen
    road: Road | None = None
    things: tuple[FloatArray, ...] = ()  # outlines (m, 2) of kerbs, islands and signals [m]
    friction: FrictionPicture | None = None
    charts: tuple[Chart, ...]
    readings: tuple[Reading, ...]
    nearest: float = 60.0  # most pixels per metre of the plan


def elapsed(log: Log) -> Log:
    """The log with times since its first row."""
    rows = log.rows.copy()
    at = log.names.index("time")
    rows[:, at] -= rows[0, at]
    return Log(log.signals, rows)


_DEGRADED = HEALTH[Health.DEGRADED]
_COLOURS: dict[str, Colour] = {"ok": "ok", "degraded": "degraded", "lost": "lost"}


def health_spans(log: Log, signal: str, of: str = "estimate") -> Iterator[Span]:
    """Times at which a health is not "ok", each from its capture to the next, and that before the first estimate."""
    if signal not in log or not len(log):
        return
    health = log[signal]
    captures = np.flatnonzero(np.isfinite(health))
    if not captures.size:
        return
    edges = np.append(log["time"][captures], log["time"][-1])
    values = np.where(health[captures] >= LOST, LOST, np.where(health[captures] > OK, _DEGRADED, OK))
    first, begin = int(np.argmax(values < LOST)), float(log["time"][0])  # nought if every estimate is lost
    if values[first] < LOST and edges[first] > begin:
        yield Span(f"no {of} yet", "grey", begin, float(edges[first]))
    for k in range(first + 1, len(values) + 1):
        if k == len(values) or values[k] != values[first]:
            if values[first] != OK:
                word = HEALTH_WORDS[float(values[first])]
                yield Span(f"{of} {word}", _COLOURS[word], float(edges[first]), float(edges[k]))
            first = k


def fault_spans(scenario_toml: str, log: Log) -> Iterator[Span]:
    """The faults that the scenario names, from their start to their end."""
    try:
        faults = tomllib.loads(scenario_toml).get("faults", ())
    except tomllib.TOMLDecodeError:
        return
    end = float(log["time"][-1]) if len(log) else 0.0
    for fault in faults if isinstance(faults, list) else ():
        start = float(fault.get("start", 0.0))
        if start < end:
            stop = min(end, start + float(fault.get("duration", end)))
            yield Span(f"fault {fault.get('kind', '')}", "fourth", start, stop)


_TYRE = (1.0, 0.34)  # length and width of a 385/65 R 22.5 from above, for drawings only [m]
_FLOOR, _CAB, _BOX = 0.6, 3.1, 4.0  # heights in the 3-D view [m], for drawings only
_DEGREES = 180.0 / np.pi


_SIDES: Final = ("left", "right")
_CLEARANCE: Final = {"wheel": "wheels to the edges of the road", "lane": "bodies to the borders of the lane"}


def trailer_playback(result: RunResult, *, edges: bool = False) -> Playback:
    """Everything that a page shows of the run over time; with the clearance to the edges of the road if wanted."""
    known = clearances(result) if edges and len(result.log) > 1 else {}
    columns = [
        (Signal(f"{kind}_clearance_{side}", "m", "distance inside the edge, negative beyond it"), one.distance[:, k])
        for kind, one in known.items()
        for k, side in enumerate(_SIDES)
    ]
    clearance_charts = [
        Chart(
            f"Clearance of the {_CLEARANCE[kind]}",
            "m",
            curves({f"{kind}_clearance_{side}": side for side in _SIDES}),
            2,
        )
        for kind in known
    ]
    last, follow = len(result.units) - 1, (-result.follow_distance, 0.0)
    estimated = EstimatedPath(
        f"estimated path of the {result.leader}", last, follow, "off_tracking_estimate", "off_tracking_std", "health"
    )
    run = PlayedRun(
        name=result.scenario,
        log=result.log.with_columns(columns) if columns else result.log,
        peak=peak_of(result.log, "off_tracking_true"),
        bodies=tuple(unit_body(unit, result.log) for unit in result.units),
        trails=(
            Trail(f"path of the {result.leader}", "true", last),
            Trail("path of the follow point", "estimated", last, follow),
        ),
        estimated=estimated if np.isfinite(result.signal("health")).any() else None,
        spans=(*health_spans(result.log, "health"), *fault_spans(result.scenario_toml, result.log)),
        pictures=[_picture(frame) for frame in result.frames],
        cameras=tuple(
            Camera(unit, c.X_SC, 0.5 * c.width / c.focal_length, 0.5 * c.height / c.focal_length)
            for unit, c in result.cameras
        ),
    )
    return Playback(
        title=result.scenario,
        runs=(run,),
        road=Road(*sides(result.road, result.road_half_width)) if len(result.road) > 1 else None,
        things=result.things,
        friction=result.friction,
        charts=(*_trailer_charts(result), *clearance_charts),
        readings=tuple(_readings(result)),
    )


def unit_body(unit: UnitOutline, log: Log) -> Body:
    """The body of a unit."""
    tilt = (f"roll_{unit.name}", f"pitch_{unit.name}")
    steer = unit.steer_signals or (None,) * len(unit.axles)
    wheels = tuple(
        Wheel(x, side * track, *_TYRE, steer=signal if signal and signal in log else "")
        for x, track, signal in zip(unit.axles, unit.tracks, steer, strict=True)
        for side in (0.5, -0.5)
    )
    return Body(
        name=unit.name,
        outline=unit.corners,
        wheels=wheels,
        pose=unit.pose_signals,
        tilt=tilt if tilt[0] in log and tilt[1] in log else None,
        heights=(_FLOOR, _CAB if unit.name == "tractor" else _BOX),
    )


def _picture(frame: CameraFrame) -> Picture:
    caption = f"{frame.inliers} inliers of {frame.matches} matches" if frame.matches else ""
    return Picture(frame.tick * TICK, frame.jpeg, frame.tracks, caption)


def curves(labels: Mapping[str, str], scale: float = 1.0) -> tuple[Curve, ...]:
    """A curve for each signal with a label, in colours of a series."""
    named = enumerate(labels.items())
    return tuple(Curve(name, label, SERIES[k % len(SERIES)], scale=scale) for k, (name, label) in named)


def off_tracking_charts(
    leader: str, estimate: str | None, reference: Curve | None, error: str = "Error of the estimate"
) -> Iterator[Chart]:
    """Off-tracking by an estimate, with its standard deviation, and by a reference; and the error between them."""
    band = Curve("off_tracking_std", "±2 σ", "estimated", "band", base=estimate or "")
    dots = Curve(estimate or "", "estimated", "estimated", "dots")
    shown = (*((band, dots) if estimate else ()), *((reference,) if reference else ()))
    yield Chart(f"Off-tracking, + when {leader} lies left", "m", shown)
    if estimate and reference:
        of_error = Curve(estimate, "error", "estimated", "dots", 1e3, less=reference.signal)
        yield Chart(error, "mm", (band._replace(scale=1e3, base=""), of_error), 1)


def motion_charts(
    names: Sequence[str], units: Sequence[str], steer: Sequence[Curve], limit: float | None = None
) -> Iterator[Chart]:
    """Charts of the signals ``names`` that tell how units move, after the steer angles with their limit [°]."""
    if steer:
        yield Chart("Steer angles of the road wheels, + left", "°", steer, 2, limit)
    for title, unit, prefix, scale in (
        ("Articulation angle", "°", "articulation_", _DEGREES),
        ("Lateral acceleration, + left", "m/s²", "lateral_acceleration_", 1.0),
        ("Yaw rate, + left", "°/s", "yaw_rate_", _DEGREES),
        ("Roll", "°", "roll_", _DEGREES),
    ):
        ends = {name: name.removeprefix(prefix) for name in names if name.startswith(prefix)}
        labels = {name: f"joint {end}" if end.isdigit() else end for name, end in ends.items()}
        if labels:
            yield Chart(title, unit, curves(labels, scale), 2)
    yield Chart("Speed", "km/h", curves({f"v_x_{units[0]}": units[0]}, 3.6), 1)


def _trailer_charts(result: RunResult) -> Iterator[Chart]:
    """Charts of the signals that the run has."""
    estimate = "off_tracking_estimate" if np.isfinite(result.signal("health")).any() else None
    true = Curve("off_tracking_true", "true", "true")
    yield from off_tracking_charts(f"the path of the {result.leader}", estimate, true)
    limit = result.trailer_steer_limit
    units = [unit.name for unit in result.units]
    yield from motion_charts(result.log.names, units, tuple(_steer(result)), limit and _DEGREES * limit)
    if "load_transfer_" + units[0] in result.log:
        transfers = curves({f"load_transfer_{name}": name for name in units if f"load_transfer_{name}" in result.log})
        yield Chart("Load transfer: ±1 when one side is in the air", "-", transfers, 2)
    used = Curve("friction_used_max", "largest of all tyres", "fifth")
    yield Chart("Share of the friction in use", "-", (used,), 2)
    if np.isfinite(result.signal("matches")).any():
        matches = Curve("matches", "matches", "grey", "dots"), Curve("inliers", "inliers", "true", "dots")
        yield Chart("Features per frame", "-", matches, 0)


def _steer(result: RunResult) -> Iterator[Curve]:
    pairs = zip(result.steer_signals(), result.steer_signals(demands=True), strict=True)
    for k, (name, demand) in enumerate(pairs):
        colour = SERIES[k % len(SERIES)]
        yield Curve(name, f"{result.steered_name} {k + 1}", colour, scale=_DEGREES)
        yield Curve(demand, f"demand {k + 1}", colour, "dashed", _DEGREES)
    if "steer_tractor" in result.log:
        yield Curve("steer_tractor", "front axle", "grey", scale=_DEGREES)


def _readings(result: RunResult) -> Iterator[Reading]:
    yield Reading("speed", f"v_x_{result.units[0].name}", "km/h", 3.6, 1)
    yield Reading("true off-tracking", "off_tracking_true", "m", 1.0, 3, "true")
    if np.isfinite(result.signal("health")).any():
        yield Reading("estimated", "off_tracking_estimate", "m", 1.0, 3, "estimated")
        yield Reading("its σ", "off_tracking_std", "mm", 1e3, 1, "estimated")
    if names := result.steer_signals():
        yield Reading("rear axle steer", names[-1], "°", _DEGREES, 1)
    if "articulation_1" in result.log:
        yield Reading("articulation", "articulation_1", "°", _DEGREES, 1)
    if "lateral_acceleration_tractor" in result.log:
        yield Reading("lateral acceleration", "lateral_acceleration_tractor", "m/s²", 1.0, 2)
    yield Reading("friction in use", "friction_used_max", "%", 100.0, 0)


_BESIDE = 0.6  # the body is as wide as this share of the distance between its wheels
_HEIGHTS = 0.16, 0.42  # of the body in the 3-D view [m], for drawings only


def rover_playback(result: RoverResult) -> Playback:
    """Everything that a page shows of the run over time."""
    rig = result.rig
    x, y = (np.array([getattr(wheel, axis) for wheel in rig.wheels]) for axis in "xy")
    ends = np.array([[x.max(), 1.0], [x.max(), -1.0], [x.min(), -1.0], [x.min(), 1.0]])
    outline: FloatArray = ends * [1.0, _BESIDE * float(np.abs(y).max())]
    steer = (f"steer_{wheel.name}" for wheel in rig.wheels)
    wheels = tuple(
        Wheel(wheel.x, wheel.y, 2.0 * rig.wheel_radius, rig.wheel_width, name if name in result.log else "")
        for wheel, name in zip(rig.wheels, steer, strict=True)
    )
    log = result.log
    errors = [
        (Signal(f"position_error_{name}", "m", "distance from the true position"), np.hypot(x - log["x"], y - log["y"]))
        for name in ("wheels", "corrected")
        if np.isfinite(x := log[f"x_{name}"]).any() and np.isfinite(y := log[f"y_{name}"]).any()
    ]
    trails = (
        Trail("path driven", "true", signals=("x", "y")),
        Trail("dead reckoning by wheels and compass", "grey", signals=("x_wheels", "y_wheels")),
        Trail("corrected by the slip angle", "estimated", signals=("x_corrected", "y_corrected")),
    )
    run = PlayedRun(
        name=result.scenario,
        log=result.log.with_columns(errors) if errors else result.log,
        peak=peak_of(result.log, "cross_track_true"),
        bodies=(Body(name=result.rover, outline=outline, wheels=wheels, pose=("x", "y", "psi"), heights=_HEIGHTS),),
        trails=tuple(trail for trail in trails if np.isfinite(result.log[trail.signals[0]]).any()),
        spans=(*health_spans(result.log, "health"), *fault_spans(result.scenario_toml, result.log)),
        pictures=list(_rover_pictures(result)),
        lines=(Line("path to follow", "grey", result.path),),
    )
    charts, readings = tuple(_rover_charts(result)), tuple(_rover_readings(result))
    return Playback(title=result.scenario, runs=(run,), charts=charts, readings=readings, nearest=400.0)


def _rover_pictures(result: RoverResult) -> Iterator[Picture]:
    for frame in result.frames:
        true, estimate = trace_lines(result, frame.tick)
        lines = [true] if estimate is None else [true, estimate]
        strokes = np.concatenate([np.hstack([line[:-1], line[1:]]) for line in lines])
        yield Picture(frame.tick * TICK, frame.jpeg, strokes.astype(np.float32), lines=(len(true) - 1,) * len(lines))


def _rover_charts(result: RoverResult) -> Iterator[Chart]:
    slip = (
        Curve("slip_angle_std", "±2 σ", "estimated", "band", _DEGREES, base="slip_angle_estimate"),
        Curve("slip_angle_laser", "laser and compass", "grey", scale=_DEGREES),
        Curve("slip_angle_estimate", "estimated", "estimated", "dots", _DEGREES),
        Curve("slip_angle_lagged", "estimated 2 s later", "third", "dots", _DEGREES),
        Curve("slip_angle_true", "true", "true", scale=_DEGREES),
    )
    yield Chart("Slip angle, + left", "°", slip, 2)
    error = Curve("slip_angle_estimate", "error", "estimated", "dots", _DEGREES, less="slip_angle_true")
    yield Chart(
        "Error of the estimate", "°", (Curve("slip_angle_std", "±2 σ", "estimated", "band", _DEGREES), error), 2
    )
    yield Chart(
        "Distance from the path, + left", "mm", (Curve("cross_track_true", "of the body", "true", scale=1e3),), 0
    )
    wheels = Curve("position_error_wheels", "by wheels and compass", "grey")
    corrected = Curve("position_error_corrected", "corrected by the slip angle", "estimated")
    yield Chart("Position error of dead reckoning", "m", (wheels, corrected), 3)
    for title, unit, prefix, scale in (
        ("Slip ratio of the wheels", "-", "slip_ratio_", 1.0),
        ("Sinkage of the wheels", "mm", "sinkage_", 1e3),
        ("Steer angles of the wheels", "°", "steer_", _DEGREES),
    ):
        labels = {prefix + wheel.name: wheel.name.replace("_", " ") for wheel in result.rig.wheels}
        yield Chart(title, unit, curves(labels, scale), 2)


def _rover_readings(result: RoverResult) -> Iterator[Reading]:
    watched = result.rig.wheels[result.rig.watched].name
    yield Reading("true slip angle", "slip_angle_true", "°", _DEGREES, 2, "true")
    yield Reading("estimated", "slip_angle_estimate", "°", _DEGREES, 2, "estimated")
    yield Reading("distance from the path", "cross_track_true", "mm", 1e3, 0)
    yield Reading("speed", "v_x", "m/s", 1.0, 3)
    yield Reading(f"slip ratio, {watched.replace('_', ' ')}", f"slip_ratio_{watched}", "%", 100.0, 0)
    yield Reading(f"sinkage, {watched.replace('_', ' ')}", f"sinkage_{watched}", "mm", 1e3, 1)
