"""A playback: everything that a page shows of one run or several over time.

Lengths in m, angles in rad, times in s; in the ground's plane x points east and y north. Signals are named as in the
run's log.
A colour is a name of the palette (``web/theme.js`` for pages, ``PALETTE`` for figures and films).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.estimates import Health
from scenarios.results.log import HEALTH, HEALTH_WORDS, LOST, OK, Log
from scenarios.results.swept_path import placed
from scenarios.results.trailer_result import FrictionPicture
from vehicle.frames import FloatArray

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
    limit: float | None = None  # drawn to both sides of zero in figures


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
    """Times at which a health is not "ok", each from its capture to the next."""
    if signal not in log or not len(log):
        return
    health = log[signal]
    captures = np.flatnonzero(np.isfinite(health))
    if not captures.size:
        return
    edges = np.append(log["time"][captures], log["time"][-1])
    values = np.where(health[captures] >= LOST, LOST, np.where(health[captures] > OK, _DEGRADED, OK))
    first = 0
    for k in range(1, len(values) + 1):
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
