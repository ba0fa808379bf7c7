"""Courses: the path of a guided point of the tractor, and the road around it.

At the start the tractor is at the world's origin, heading along +x, and the guided point is at the start of the path.
Builders take the tractor's front end and width [m]. The default entry holds the 14 m of hitch path that the
off-tracking of a long semitrailer needs; on the default exit the trailer leaves the turn completely.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from controllers.path import Path, Segment, arc, line
from scenarios.results.swept_path import TurnArc
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import FrictionMap, RoadRelief

Direction = Literal["left", "right"]
_SIDE: Final[dict[Direction, float]] = {"left": 1.0, "right": -1.0}

_QUARTER_TURN = 0.5 * math.pi  # [rad]
_ENTRY = 30.0  # 14 m of hitch path, and some seconds for the loop to settle before the turn [m]
_EXIT = 35.0  # a follow point 19 m behind the tractor's front is 16 m out of the turn [m]
_RADIUS = 12.5  # outer circle of the EU roundabout, Directive 97/27/EC [m]
_LONGEST_ARC = 4.0 * math.pi  # largest angle of one path segment; longer turns take several [rad]
_RAMP = 4.0  # length of a curvature ramp: 16 deg/s of steer at 15 km/h, half of a driver's limit [m]
_ROAD_HALF_WIDTH = 4.5  # the roundabout's swept annulus of 7.2 m (5.3 m to 12.5 m) with a margin [m]
_ROAD_BEYOND = 40.0  # road behind the start and past the end: cameras look along it [m]
_SPACING = 0.5  # distance between points of the centreline [m]
_SAME: Final = 1e-6  # distance of centres that are one [m]
_STRAIGHT: Final = 1e-3  # turn of a piece of path fitted to points that is a straight but for rounding [rad]
_LONGEST = 20e3  # course of turns: two hours at 10 km/h, and a second to build [m]
_WAVE_PIECES = 32  # linear pieces of a sine of curvature; their error is 0.5 % of the peak
_GENTLE = 0.2  # largest offset over length of a lane change: heading up to 0.4 rad, path 3 % longer


@runtime_checkable  # a course stands in options of environments, which pydantic checks
class Placed(Protocol):
    """Place of the world in the coordinates of a course's file."""

    def record(self) -> dict[str, str | float]:
        """Origin and first heading of W there, and what the coordinates are."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """The path that the driver follows, and the road."""

    path: Path  # of the guided point, in W
    reference: tuple[float, float]  # the guided point in T [m]
    start: Pose2  # X_WT
    surface_centre: tuple[float, float] | None  # apex of a conical cross-fall [m]; None: a plane
    # (n, 2) of the road, extended at both ends [m]: path of the tractor's rear axle, or the file's
    centreline: FloatArray
    road_half_width: float | FloatArray  # everywhere, or (n, 2) to the left and right at the centre line's points [m]
    relief: RoadRelief | None = None  # heights and banks of the road; None: level
    friction: FrictionMap | None = None  # of the road, in place of the scenario's
    lane_lines: FloatArray | None = None  # (n, k, 2) painted at the centre line's points: to the left [m], 1 if broken
    lanes: FloatArray | None = None  # (n, 2) from the centre line to the lane's left and right border [m]
    paved: FloatArray | None = None  # (n, 2) to the edges of the road that cameras see, where it is wider [m]
    things: tuple[FloatArray, ...] = ()  # outlines (m, 2) of kerbs, islands and signals of a map, for plans [m]
    deviation: float | None = None  # largest distance of the points of a file from the path [m]
    placement: Placed | None = None  # None: the course is in no file
    remarks: tuple[str, ...] = ()  # what a user should know of the file, a line each

    @property
    def length(self) -> float:
        """Distance along the path at which the course is completed [m]."""
        return self.path.length

    @property
    def arcs(self) -> tuple[TurnArc, ...]:
        """The turns of constant curvature; consecutive arcs about one centre are one."""
        arcs: list[TurnArc] = []
        for knot, segment in zip(self.path.knots, self.path.segments, strict=False):
            if segment.start_curvature != segment.end_curvature or segment.start_curvature == 0.0:
                continue
            radius = 1.0 / segment.start_curvature
            centre = (knot.x - radius * math.sin(knot.psi), knot.y + radius * math.cos(knot.psi))
            last = arcs[-1] if arcs else None
            if last and math.dist(last.centre, centre) < _SAME:
                arcs[-1] = last._replace(turn=last.turn + segment.turn)
            else:
                arcs.append(TurnArc(centre, knot.psi, segment.turn))
        return tuple(turn for turn in arcs if abs(turn.turn) > _STRAIGHT)


def roundabout(
    *,
    front_x: float,
    width: float,
    direction: Direction = "left",
    radius: float = _RADIUS,
    turn: float = math.tau,
    entry: float = _ENTRY,
    exit: float = _EXIT,
) -> Course:
    """Straight, circle by ``turn`` [rad], straight; the tractor's outer front corner is guided.

    Raises:
        ValueError: if the circle is too tight for the tractor's front end.
    """
    side = _SIDE[direction]
    _check_radius(radius, front_x, width)
    reference = (front_x, -0.5 * side * width)
    pieces = max(1, math.ceil(turn / _LONGEST_ARC - 1e-9))
    circle = (arc(radius * turn / pieces, side / radius),) * pieces
    segments = (line(entry), *circle, line(exit))
    centre = (reference[0] + entry, reference[1] + side * radius)
    return _course(reference, segments, surface_centre=centre)


def figure_of_eight(
    *, front_x: float, width: float, radius: float = _RADIUS, entry: float = _ENTRY, exit: float = _EXIT
) -> Course:
    """A full circle to the left, then one to the right, with the outer front corner on the ``radius`` [m] in both.

    The middle of the front is guided. Its curvature ramps up and down over a few metres (clothoids), because a driver
    cannot jump from lock to lock. The ramps are part of the full circles.

    Raises:
        ValueError: if the circle is too tight for the tractor's front end.
    """
    _check_radius(radius, front_x, width)
    guided_radius = math.hypot(math.sqrt(radius**2 - front_x**2) - 0.5 * width, front_x)
    kappa = 1.0 / guided_radius
    circle = math.tau * guided_radius - _RAMP  # each ramp turns by half of an arc of its length
    segments = (
        line(entry),
        Segment(_RAMP, 0.0, kappa),
        arc(circle, kappa),
        Segment(2.0 * _RAMP, kappa, -kappa),
        arc(circle, -kappa),
        Segment(_RAMP, -kappa, 0.0),
        line(exit),
    )
    return _course((front_x, 0.0), segments)


class Turn(NamedTuple):
    """A turn of the guided point, and the straight after it."""

    direction: Direction
    radius: float  # [m]
    angle: float  # [rad]
    straight: float  # [m]


def turns(*, front_x: float, width: float, sequence: Sequence[Turn], entry: float = _ENTRY) -> Course:
    """A sequence of turns and straights; the middle of the front is guided.

    Curvature ramps up and down as in a figure of eight; the ramps are part of the turns.

    Raises:
        ValueError: for no turns, more than 20 km, or a turn too tight or short.
    """
    if not sequence:
        raise ValueError("turns is empty: a course needs at least one")
    segments = [line(entry)]
    for turn in sequence:
        side = _SIDE[turn.direction]
        _check_radius(turn.radius, front_x, width)
        circle = turn.radius * turn.angle - _RAMP  # each ramp turns by half of an arc of its length
        if not circle > 0.0:
            raise ValueError(f"turn of {turn.radius * turn.angle:.2f} m: must be longer than {_RAMP:g} m of its ramps")
        kappa = side / turn.radius
        segments += [Segment(_RAMP, 0.0, kappa), arc(circle, kappa), Segment(_RAMP, kappa, 0.0), line(turn.straight)]
    length = sum(segment.length for segment in segments)
    if length > _LONGEST:
        raise ValueError(f"turns: the course is {1e-3 * length:.1f} km long: must be at most {1e-3 * _LONGEST:g} km")
    return _course((front_x, 0.0), tuple(segments))


def corner(
    *,
    wheel_x: float,
    wheel_y: float = 0.0,
    direction: Direction = "left",
    radius: float = _RADIUS,
    turn: float = _QUARTER_TURN,
    entry: float = _ENTRY,
    exit: float = _EXIT,
) -> Course:
    """Straight, arc by ``turn`` [rad], straight; a point of the steered axle is guided.

    The axle is at ``wheel_x`` [m] along the tractor. Performance-based standards guide the wall of its outer tyre, at
    ``wheel_y`` [m] from the centre line, and AASHTO its centre.

    Raises:
        ValueError: if the arc is too tight.
    """
    side = _SIDE[direction]
    _check_radius(radius, wheel_x, wheel_y)
    segments = (line(entry), arc(radius * turn, side / radius), line(exit))
    return _course((wheel_x, -side * wheel_y), segments)


def lane_change(
    *,
    axle_x: float,
    speed: float,
    direction: Direction = "left",
    frequency: float = 0.4,
    peak_acceleration: float = 1.4715,
    entry: float = 60.0,
    exit: float = 150.0,
) -> Course:
    """The single lane change of ISO 14791: one period of sinusoidal lateral acceleration [Hz, m/s2] at ``speed`` [m/s].

    The resulting offset is the acceleration over 2 pi times the frequency squared, 1.464 m by default. The front axle
    is guided, which is at ``axle_x`` [m].

    Raises:
        ValueError: if the change is too sharp.
    """
    side = _SIDE[direction]
    length = speed / frequency
    offset = peak_acceleration / (2.0 * math.pi * frequency**2)
    if offset > _GENTLE * length:
        raise ValueError(f"lane change of {offset:.2f} m over {length:.2f} m: must be at most {_GENTLE:g} m a metre")
    peak = side * peak_acceleration / speed**2
    wave = [peak * math.sin(math.tau * k / _WAVE_PIECES) for k in range(_WAVE_PIECES + 1)]
    change = (Segment(length / _WAVE_PIECES, *ends) for ends in pairwise(wave))
    return _course((axle_x, 0.0), (line(entry), *change, line(exit)))


def straight(*, front_x: float, length: float) -> Course:
    """Straight ahead for ``length`` [m]; the point ``front_x`` [m] of the tractor's axis is guided."""
    return _course((front_x, 0.0), (line(length),))


def _course(
    reference: tuple[float, float], segments: tuple[Segment, ...], *, surface_centre: tuple[float, float] | None = None
) -> Course:
    if not reference[0] > 0.0:
        raise ValueError(f"the guided point, at x = {reference[0]:g} m of the tractor, must be ahead of its origin")
    path = Path(Pose2(reference[0], reference[1], 0.0), segments)
    return Course(
        path=path,
        reference=reference,
        start=Pose2(0.0, 0.0, 0.0),
        surface_centre=surface_centre,
        centreline=_rear_axle_path(path, reference),
        road_half_width=_ROAD_HALF_WIDTH,
    )


def _rear_axle_path(path: Path, reference: tuple[float, float]) -> FloatArray:
    """Path of the rolling tractor's rear axle, shape (n, 2), from behind the start to past the end."""
    x_ref, y_ref = reference
    stations = np.arange(-_ROAD_BEYOND, path.length + _ROAD_BEYOND + _SPACING, _SPACING)
    headings = _headings(path, stations, reference)
    points = np.array([path.pose(float(s))[:2] for s in stations])
    c, s = np.cos(headings), np.sin(headings)
    return points - np.stack([c * x_ref - s * y_ref, s * x_ref + c * y_ref], axis=1)


def _headings(path: Path, stations: FloatArray, reference: tuple[float, float]) -> FloatArray:
    """Heading of T [rad] with the guided point on the path and no lateral slip at the rear axle."""
    x_ref = reference[0]

    def rate(s: float, psi: float) -> float:
        chi = path.pose(s).psi - psi
        # v_y = r x_ref = u sin(chi) of the guided point, at the speed u = 1 along the path
        return math.sin(chi) / x_ref

    headings = [path.start.psi]
    for s in stations[:-1].tolist():
        psi = headings[-1]
        midway = psi + 0.5 * _SPACING * rate(s, psi)
        headings.append(psi + _SPACING * rate(s + 0.5 * _SPACING, midway))
    return np.array(headings)


def _check_radius(radius: float, front_x: float, width: float) -> None:
    tightest = math.hypot(front_x, width)
    if radius <= tightest:
        raise ValueError(f"radius = {radius} m must exceed {tightest:.2f} m: no tractor turns about its own wheel")
