"""FTrace: the slip angle of a rover from the trace of its left rear wheel, as published.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.

One straight line represents the visible trace. So the slip is a mean over its length, delayed by about 4 s at 8 cm/s,
and the curved trace of a turning rover is misread as slip. The slip of a steered wheel is the trace's direction
relative to the wheel's mean steer angle while it made the trace: eq. 2 with means over one distance. Roll and pitch of
the rover are not used.
The paper does not state when a lost trace is given up, nor a standard deviation: the one given here is the accuracy
that the paper claims.

Reina 2008 models the trace by its centre line and does not state how it is derived from edges. An edge lies half a rut
beside it. So a candidate here is the midline of two lines of the Hough transform that are about parallel on the ground
and about a rut apart.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple, Self

import numpy as np

from estimators.context import RoverContext
from estimators.estimates import Health, SlipAngle, lost_slip
from estimators.slip.wheel_trace.lines import (
    Breakpoints,
    GroundLines,
    TraceEdges,
    confidence,
    strongest_lines,
    turn_between,
)
from sensors.messages import GreyImage, RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray, wrap

_SPAN: Final = 4.0  # of headings for the yaw rate: noise of 0.35 deg then gives 0.07 deg/s [s]; assumed
_SHORTEST: Final = 2.0  # with a shorter span the compass noise is worse than no rate [s]
_STATIONS: Final = 25  # samples of the steer angle along a trace: every 0.02 m of a view
_STANDING: Final = 0.01  # below it a trace says nothing about the current slip [m/s]


class Heading(NamedTuple):
    """Compass reading, unwrapped."""

    time: float  # [s]
    psi: float  # [rad]


def with_heading(headings: tuple[Heading, ...], view: RoverView) -> tuple[Heading, ...]:
    """Headings of the last seconds, including that of the view."""
    time = view.tick * TICK
    psi = headings[-1].psi + wrap(view.heading - headings[-1].psi) if headings else view.heading
    return (*(heading for heading in headings if heading.time > time - _SPAN), Heading(time, psi))


class Pointing(NamedTuple):
    """Steer angle of a wheel after a rolled distance."""

    distance: float  # [m]
    tick: int
    steer: float  # relative to the body, + left [rad]


def with_pointing(pointings: tuple[Pointing, ...], view: RoverView, rig: TraceRig, kept: float) -> tuple[Pointing, ...]:
    """Steer angles of the watched wheel over the last ``kept`` [m], including that of the view, by its encoders."""
    distance = 0.0
    if pointings:
        last = pointings[-1]
        rim_speed = rig.wheel_radius * abs(float(view.wheel_speeds[rig.watched]))
        distance = last.distance + rim_speed * (view.tick - last.tick) * TICK
    new = Pointing(distance, view.tick, float(view.steer[rig.watched]))
    return (*(one for one in pointings if one.distance > distance - kept), new)


def mean_steer(pointings: Sequence[Pointing], nearest: float, farthest: float) -> float:
    """Mean steer angle [rad] of a wheel while it made the trace ``nearest`` to ``farthest`` behind it [m].

    Before the first known angle, that angle is used.
    """
    behind = np.linspace(nearest, farthest, _STATIONS)
    distance, _, steer = np.array(pointings).T
    return float(np.interp(distance[-1] - behind, distance, steer).mean())


def rate_of_turn(headings: Sequence[Heading]) -> float:
    """Yaw rate [rad/s] by regression of the compass headings; 0 before there are enough."""
    time, psi = np.array(headings).T
    if time[-1] - time[0] < _SHORTEST:
        return 0.0
    away = time - time.mean()
    return float(away @ psi / (away @ away))


def forward_speed(view: RoverView, wheel_radius: float) -> float:
    """Speed of the body along its x axis by the encoders, without slip [m/s]."""
    return wheel_radius * float(np.mean(view.wheel_speeds * np.cos(view.steer)))


def body_slip(wheel_slip: float, steer: float, speed: float, rate: float, behind: float) -> float:
    """Slip angle beta [rad] of a body whose rear axle lies ``behind`` its centre of mass [m] (Reina 2008, eq. 2).

    ``wheel_slip`` alpha_r is the direction of the rear wheel's travel relative to its heading, ``steer`` delta_r that
    heading relative to the body, both + left; their sum is the direction of travel in the body. (The paper writes
    alpha_r - delta_r: one of the two has the opposite sign there.) ``rate`` is r [rad/s], ``speed`` V_x [m/s]. At very
    low speed R = V_x / r is undefined, and b / R is left out.
    """
    turning = behind * rate / speed if abs(speed) > _STANDING else 0.0
    return math.atan(math.tan(wheel_slip + steer) + turning)


_PARALLEL: Final = math.radians(5.0)  # largest angle between the walls of one rut: it widens along the view by 0.05 m
_NARROWER: Final = 0.02  # than the wheel, for edges on the inner side of a rut's walls [m]
_WIDER: Final = 0.07  # than the wheel: a wheel that slips sideways sweeps more, and berms of 0.03 m have edges too [m]
CANDIDATES: Final = 10  # (Reina 2008, section II-A.2)
BREAKPOINTS: Final = Breakpoints(rho=130.0, phi=math.radians(16.0), d=0.08, theta=math.radians(16.0), Y=0.03)
_LINES: Final = 60  # edges that are paired: on pebbles 30 often do not include both walls
# Edge pixels on a line: a sixth of the image's height. Walls of a rut have about 100 each, chance lines among pebbles
# seldom more than 80. Heavy shadows raise the thresholds of eqs 3 and 4, so a higher limit would miss the trace.
_LEAST_VOTES: Final = 80
_LEAST_CONFIDENCE: Final = 0.5  # below "medium" the line is not a trace
_PATIENCE: Final = 15  # images without a trace after which its last pose is dropped: 3 s; assumed
_STD: Final = math.radians(1.4)  # "an accuracy of 1.4 deg" (Reina 2008, section IV)


class _Candidates(NamedTuple):
    """Midlines, sorted by votes."""

    image: FloatArray  # (m, 2) rho [px], phi [rad]
    ground: FloatArray  # (m, 3) d [m], theta [rad], Y [m]
    votes: FloatArray  # (m,) edge pixels on both edges
    edges: FloatArray  # (m, 2, 2) rho [px], phi [rad] of either edge


class TraceReference(NamedTuple):
    """Pose of the trace in the image before."""

    image: tuple[float, float]  # rho [px], phi [rad]
    ground: tuple[float, float]  # d [m], theta [rad]


class FTraceMemory(NamedTuple):
    """State of the detector after a view."""

    reference: TraceReference | None  # None: travel without slip is expected
    missed: int  # consecutive images without a trace
    headings: tuple[Heading, ...]
    pointings: tuple[Pointing, ...]  # of the wheel while it made the trace in view


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explanation:
    """Intermediate results for one image (Reina 2008, Fig. 6), strongest candidate first."""

    image: GreyImage  # without distortion
    edges: GreyImage
    lines: FloatArray  # (m, 3) rho [px], phi [rad], votes
    candidates: _Candidates
    confidences: FloatArray  # (n,)
    best: int | None  # index of the candidate; None: no trace


class FTrace:
    """Detector of the left rear wheel's trace; ``init`` and ``step`` are pure."""

    sensor: ClassVar[str] = "trace_camera"

    def __init__(self, rig: TraceRig, breakpoints: Breakpoints = BREAKPOINTS) -> None:
        """A detector for a calibrated camera; ``breakpoints`` of the membership functions."""
        self._rig = rig
        self._breakpoints = breakpoints
        self._edges = TraceEdges(rig)
        self._view = GroundLines(rig)
        self._visible = self._view.visible()

    @classmethod
    def of(cls, context: RoverContext) -> Self:
        """Estimator for the context's camera."""
        return cls(context.rig)

    def init(self) -> FTraceMemory:
        """Before the first view."""
        return FTraceMemory(None, 0, (), ())

    def step(self, memory: FTraceMemory, view: RoverView) -> tuple[FTraceMemory, SlipAngle]:
        """Memory and slip angle; LOST if no trace is found."""
        headings = with_heading(memory.headings, view)
        pointings = with_pointing(memory.pointings, view, self._rig, self._visible)
        memory = memory._replace(headings=headings, pointings=pointings)
        result = self.explain(memory, view)
        if result.best is None:
            missed = memory.missed + 1
            reference = memory.reference if missed < _PATIENCE else None
            return memory._replace(reference=reference, missed=missed), lost_slip(view.tick)
        rho, phi = result.candidates.image[result.best].tolist()
        d, theta, offset = result.candidates.ground[result.best].tolist()
        reference = TraceReference((rho, phi), (d, theta))
        steer = self._mean_steer(memory)
        speed = forward_speed(view, self._rig.wheel_radius)
        estimate = SlipAngle(
            tick=view.tick,
            value=body_slip(theta - steer, steer, speed, rate_of_turn(headings), -self._rig.wheel[0]),
            std=_STD,
            health=Health.OK,
            wheel_slip=theta - steer,
            trace_offset=offset,
            confidence=float(result.confidences[result.best]),
            averaged_over=self._visible,
        )
        return memory._replace(reference=reference, missed=0), estimate

    def explain(self, memory: FTraceMemory, view: RoverView) -> Explanation:
        """Intermediate results for the image of a view."""
        image = self._edges.image(view.image)
        steer = float(view.steer[self._rig.watched])
        edges = self._edges.find(image, steer)
        lines = strongest_lines(edges, _LINES, _LEAST_VOTES)
        candidates = _midlines(lines, self._view, self._rig, CANDIDATES)
        reference = memory.reference or self._without_slip(self._mean_steer(memory) if memory.pointings else steer)
        confidences = confidence(_differences(candidates, reference), self._breakpoints)
        best = int(np.argmax(confidences)) if len(confidences) else None
        if best is not None and confidences[best] < _LEAST_CONFIDENCE:
            best = None
        return Explanation(
            image=image, edges=edges, lines=lines, candidates=candidates, confidences=confidences, best=best
        )

    def _mean_steer(self, memory: FTraceMemory) -> float:
        """Mean steer angle of the wheel while it made the visible trace [rad]."""
        return mean_steer(memory.pointings, self._rig.wheel_radius, self._visible)

    def _without_slip(self, steer: float) -> TraceReference:
        """Pose of the trace of a wheel without slip."""
        image = self._view.image(np.array([steer]), np.zeros(1))
        d, theta, _ = self._view.ground(image)[0].tolist()
        return TraceReference((float(image[0, 0]), float(image[0, 1])), (d, theta))


def _differences(candidates: _Candidates, reference: TraceReference) -> FloatArray:
    """Inputs of the fuzzy rules (n, 5): differences of each candidate from the last trace, and from the wheel."""
    (rho, phi), (d, theta) = reference
    return np.column_stack(
        [
            np.abs(candidates.image[:, 0] - rho),
            turn_between(candidates.image[:, 1], phi),
            np.abs(candidates.ground[:, 0] - d),
            turn_between(candidates.ground[:, 1], theta),
            np.abs(candidates.ground[:, 2]),
        ]
    )


def _midlines(lines: FloatArray, view: GroundLines, rig: TraceRig, n: int) -> _Candidates:
    """The n midlines with the most votes, from lines (m, 3) of rho, phi and votes."""
    ground = view.ground(lines)
    first, second = np.triu_indices(len(lines), 1)
    theta = 0.5 * (ground[first, 1] + ground[second, 1])
    apart = np.abs(ground[first, 2] - ground[second, 2]) * np.cos(theta)
    width = rig.wheel_width
    fits = (np.abs(ground[first, 1] - ground[second, 1]) < _PARALLEL) & (apart > width - _NARROWER)
    fits &= apart < width + _WIDER
    votes = lines[first, 2] + lines[second, 2]
    chosen = np.flatnonzero(fits)[np.argsort(-votes[fits], kind="stable")][:n]
    first, second, theta = first[chosen], second[chosen], theta[chosen]
    image = view.image(theta, 0.5 * (ground[first, 2] + ground[second, 2]))
    edges = np.stack([lines[first, :2], lines[second, :2]], axis=1)
    return _Candidates(image, view.ground(image), votes[chosen], edges)
