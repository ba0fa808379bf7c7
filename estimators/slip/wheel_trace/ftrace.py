"""FTrace: the slip angle of a rover from the trace of its left rear wheel, as published.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.

One straight line represents the visible trace. So the slip is a mean over its length, delayed by about 4 s at 8 cm/s,
and the curved trace of a turning rover is misread as slip. The slip of a steered wheel is the trace's direction
relative to the wheel's mean steer angle while it made the trace: eq. 2 with means over one distance. Roll and pitch of
the rover are not used. The paper does not state when a lost trace is given up, nor a standard deviation: the one given
here is the accuracy that the paper claims, and in a bend half of the turn along the view, by which a line misreads it.

Reina 2008 models the trace by its centre line and does not state how it is derived from edges. An edge lies half a rut
beside it. So a candidate here is the midline of two lines of the Hough transform that are about parallel on the ground
and about a rut apart.

A line in the image is P = (rho, phi). On the ground it is R = (d, theta): its distance from the centre of mass G,
assumed at R's origin, + left, and the wheel's direction of travel along it relative to R's x axis, + left. Y is its
lateral offset from the wheel's centre B on the axle's line, + left.

The confidence that a line is the trace comes from fuzzy rules. Every input is an absolute difference with a degree of
membership in "small" and "large". The membership functions are triangles (Fig. 5); the paper gives no numbers for their
breakpoints. They are chosen here by the meaning of the inputs, see ``Breakpoints``. The rules are of Mamdani type: the
strength of a rule is the minimum of its conditions, and rules with the same conclusion combine by the maximum.
Defuzzification is by the height method (mean of the peaks, weighted with the strengths): with centroids of triangles no
confidence could be as low as the 1.1 % of Table II. If no rule applies the confidence is 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple, Self

import cv2
import numpy as np

from estimators.context import RoverContext
from estimators.estimates import Health, SlipAngle, lost_slip
from sensors.camera.rig import UNDISTORTED
from sensors.messages import GreyImage, RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse, wrap

_LOW: Final = 1.0 / 3.0  # of the range of grey levels (eq. 3)
_HIGH: Final = 2.5  # of the low threshold (eq. 4)
_MARGIN: Final = 9  # around the wheel's image, which is blurred and shakes with the rover [px]; assumed
STEEPEST: Final = math.radians(30.0)  # largest angle of a trace; with more slip a rover hardly moves
_ANGLE: Final = math.radians(1.0)  # bin width; half of it gives no better lines
_DISTANCE: Final = 1.0  # [px]
_MOST: Final = 400  # strongest lines that are searched for distinct ones
_APART: Final = 20.0  # least distance of distinct lines: two bins that wide edges spread over [px]
_LEVER: Final = 300.0  # distance equivalent to one radian of direction: half of an image's size [px/rad]


class TraceEdges:
    """Canny edges of an undistorted image, without those of the wheel."""

    def __init__(self, rig: TraceRig) -> None:
        camera = rig.camera
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = (np.stack([u, v], axis=-1) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        pixels = camera.pixels(rays).astype(np.float32)
        self._rig = rig
        self._maps = None
        if camera.distortion != UNDISTORTED:
            self._maps = cv2.convertMaps(pixels[..., 0], pixels[..., 1], cv2.CV_16SC2)

    def image(self, image: GreyImage) -> GreyImage:
        """Image without lens distortion, so that lines are straight."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def find(self, image: GreyImage, steer: float) -> GreyImage:
        """Edges of an undistorted image: 255, elsewhere 0; the wheel is steered by ``steer`` [rad], + left."""
        low, high = canny_thresholds(image)
        edges = cv2.Canny(image, low, high, apertureSize=3)
        return np.asarray(cv2.bitwise_and(edges, ground_mask(self._rig, steer)))


def strongest_lines(edges: GreyImage, n: int, least_votes: int) -> FloatArray:
    """Rows of rho [px], phi [rad] and votes of the n strongest distinct lines, strongest first; (m, 3), m <= n.

    A line is u cos(phi) + v sin(phi) = rho with phi in (-pi/2, pi/2]; phi = 0 is vertical. Only lines within
    ``STEEPEST`` of vertical are returned. One edge is a cluster of cells in the accumulator; the strongest is used.
    """
    # in the transposed image these directions are one interval, as OpenCV requires
    low, high = 0.5 * math.pi - STEEPEST, 0.5 * math.pi + STEEPEST
    turned = np.ascontiguousarray(edges.T)
    result: Any = cv2.HoughLinesWithAccumulator(turned, _DISTANCE, _ANGLE, least_votes, min_theta=low, max_theta=high)
    if result is None:  # no line found; missing in OpenCV's type stubs
        return np.empty((0, 3))
    rho, theta, votes = result.reshape(-1, 3)[:_MOST].astype(np.float64).T
    return _different(np.column_stack([rho, 0.5 * math.pi - theta, votes]), n)


def upright(lines: FloatArray) -> FloatArray:
    """Lines (n, 2 or more) normalised to phi in (-pi/2, pi/2], with rho of either sign."""
    turned = lines.copy()
    over = np.where(turned[:, 1] > 0.5 * math.pi, 1, 0) - np.where(turned[:, 1] <= -0.5 * math.pi, 1, 0)
    turned[:, 1] -= math.pi * over
    turned[:, 0] = np.where(over != 0, -turned[:, 0], turned[:, 0])
    return turned


def _different(lines: FloatArray, n: int) -> FloatArray:
    """First n lines that are not close to an earlier one."""
    kept: list[FloatArray] = []
    while len(lines) and len(kept) < n:
        first = lines[0]
        kept.append(first)
        apart = np.abs(lines[:, 0] - first[0]) + _LEVER * np.abs(lines[:, 1] - first[1])
        lines = lines[apart > _APART]
    return np.array(kept).reshape(-1, 3)


def canny_thresholds(image: GreyImage) -> tuple[float, float]:
    """Low and high threshold of the hysteresis, in units of the 3x3 Sobel kernel's sum (Reina 2008, eqs 3 and 4)."""
    low = _LOW * (float(image.max()) - float(image.min()))
    return low, _HIGH * low


def ground_mask(rig: TraceRig, steer: float) -> GreyImage:
    """Mask of an undistorted image: 255 for ground, 0 for the wheel."""
    turn = np.linspace(0.0, 2.0 * np.pi, 72)
    r, c, s = rig.wheel_radius, np.cos(steer), np.sin(steer)
    rim = np.stack([r * c * np.cos(turn), r * s * np.cos(turn), r + r * np.sin(turn)], axis=-1)
    across = 0.5 * rig.wheel_width * np.array([-s, c, 0.0])
    sides = np.concatenate([rim - across, rim + across]) + np.array([*rig.wheel, 0.0])
    hull = cv2.convexHull(np.round(_pinhole(rig, sides)).astype(np.int32))
    mask = np.full((rig.camera.height, rig.camera.width), 255, np.uint8)
    cv2.fillConvexPoly(mask, hull, 0)
    return np.asarray(cv2.erode(mask, np.ones((2 * _MARGIN + 1,) * 2, np.uint8)))


def _pinhole(rig: TraceRig, points: FloatArray) -> FloatArray:
    """Undistorted pixels (n, 2) of points (n, 3) in R; points behind the camera are moved in front of it."""
    X_CR = inverse(rig.X_RC)
    p_C = points @ X_CR[:3, :3].T + X_CR[:3, 3]
    depth = np.maximum(p_C[:, 2:], 0.05)
    pixels: FloatArray = p_C[:, :2] / depth * [rig.camera.fx, rig.camera.fy] + [rig.camera.cx, rig.camera.cy]
    limit = 4.0 * max(rig.camera.width, rig.camera.height)
    return np.clip(pixels, -limit, limit)


_ACROSS: Final = 1e-9  # of a unit normal: lines straight across the rover have no offset Y


class GroundLines:
    """Map lines between image and ground, for level ground and the calibrated attitude of the rover."""

    def __init__(self, rig: TraceRig) -> None:
        self._wheel = rig.wheel
        self._H = rig.image_of_ground()
        self._G = np.linalg.inv(self._H)

    def visible(self) -> float:
        """Length of visible ground straight behind the wheel's centre [m]."""
        u, _, w = self._H @ [*self._wheel, 1.0]
        x, _, size = self._G @ [u / w, 0.0, 1.0]
        return float(self._wheel[0] - x / size)

    def ground(self, lines: FloatArray) -> FloatArray:
        """Rows d [m], theta [rad], Y [m] on the ground of image lines, given as rows of rho [px], phi [rad], ..."""
        rho, phi = lines[:, 0], lines[:, 1]
        a, b, c = (np.column_stack([np.cos(phi), np.sin(phi), -rho]) @ self._H).T  # a x + b y + c = 0 in R
        size = np.hypot(a, b) * np.where(b < 0.0, -1.0, 1.0)
        a, b, c = a / size, b / size, c / size  # the normal points to the left
        theta = np.arctan2(-a, b)
        x, y = self._wheel
        offset = -(a * x + c) / np.where(b > _ACROSS, b, _ACROSS) - y
        return np.column_stack([-c, theta, offset])

    def image(self, theta: FloatArray, offset: FloatArray) -> FloatArray:
        """Rows rho [px], phi [rad] of lines on the ground with direction theta [rad] and offset Y from B [m]."""
        x, y = self._wheel
        normal = np.column_stack([-np.sin(theta), np.cos(theta)])
        c = np.sin(theta) * x - np.cos(theta) * (y + offset)
        l_u, l_v, l_w = (np.column_stack([normal, c]) @ self._G).T
        size = np.hypot(l_u, l_v)
        return upright(np.column_stack([-l_w / size, np.arctan2(l_v, l_u)]))


def turn_between(a: FloatArray, b: float) -> FloatArray:
    """Absolute angle between undirected lines [rad], 0 to pi/2."""
    turn: FloatArray = np.abs((a - b + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    return turn


# Conditions S(mall) and L(arge) on rho, phi, d, theta, Y, and the peak of the conclusion (Reina 2008, Table I).
LOW, MEDIUM, HIGH = 0.0, 0.5, 1.0
RULES: Final = (
    ("SSSSS", HIGH),
    ("SLSLS", MEDIUM),
    ("LSLSL", LOW),
    ("LLLLL", LOW),
    ("LLSSL", LOW),
    ("SSLLS", MEDIUM),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Breakpoints:
    """Differences at which the membership in "small" reaches 0, from 1 at 0; "large" is the complement.

    Image and ground describe the same line, so their breakpoints correspond. A direction may differ by the largest
    slip between two detections of the trace with a loss in between (16 deg is about the largest slip of a rover that
    still moves; from image to image it is at most 2 deg). A position may differ by the resulting offset in the middle
    of the view. At the wheel's centre a line must pass within a third of the wheel's width: the nearest line that can
    be mistaken for the trace is the front wheel's rut, 0.05 m beside that of the rear wheel at a slip of 5 deg.

    Raises:
        ValueError: if one is not positive.
    """

    rho: float  # [px]
    phi: float  # [rad]
    d: float  # [m]
    theta: float  # [rad]
    Y: float  # [m]

    def __post_init__(self) -> None:
        for name in ("rho", "phi", "d", "theta", "Y"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"breakpoint {name} = {getattr(self, name)} must be positive")

    def scaled(self, factor: float) -> Breakpoints:
        """Breakpoints times a factor."""
        return Breakpoints(
            rho=factor * self.rho,
            phi=factor * self.phi,
            d=factor * self.d,
            theta=factor * self.theta,
            Y=factor * self.Y,
        )

    def as_array(self) -> FloatArray:
        """Array (5,) in the order of the rules' conditions."""
        return np.array([self.rho, self.phi, self.d, self.theta, self.Y])


def small(differences: FloatArray, breakpoints: Breakpoints) -> FloatArray:
    """Membership (n, 5) of differences (n, 5) in "small": triangles with their peak at 0."""
    degree: FloatArray = np.clip(1.0 - differences / breakpoints.as_array(), 0.0, 1.0)
    return degree


def confidence(differences: FloatArray, breakpoints: Breakpoints) -> FloatArray:
    """Confidence (n,), 0 to 1, of candidates with differences (n, 5) in rho, phi, d, theta and Y."""
    s = small(differences, breakpoints)
    strength = {HIGH: np.zeros(len(s)), MEDIUM: np.zeros(len(s)), LOW: np.zeros(len(s))}
    for conditions, conclusion in RULES:
        chosen = np.where(np.array(list(conditions)) == "S", s, 1.0 - s)
        strength[conclusion] = np.maximum(strength[conclusion], chosen.min(axis=1))
    total = sum(strength.values())
    pulled = sum(peak * degree for peak, degree in strength.items())
    result: FloatArray = pulled / np.maximum(total, 1e-12)
    return result


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
_STD: Final = math.radians(1.4)  # on a straight: "an accuracy of 1.4 deg" (Reina 2008, section IV)


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
        speed = self._rig.wheel_radius * float(np.mean(view.wheel_speeds * np.cos(view.steer)))  # without slip [m/s]
        rate = rate_of_turn(headings)
        misread = 0.5 * rate * self._visible / max(speed, _STANDING)
        estimate = SlipAngle(
            tick=view.tick,
            value=body_slip(theta - steer, steer, speed, rate, -self._rig.wheel[0]),
            std=math.hypot(_STD, misread),
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
