"""Where to drive: the path of a guided point of the tractor, and the road around it.

The tractor stands at the world's origin at the start, heading along +x, and the guided point at the path's start.
Builders take the tractor's front end and width [m] as numbers; the defaults of entry and exit are long enough for the
14 m of hitch path that a long semitrailer's off-tracking needs before the turn, and for it to come out of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from controllers.path import Path, Segment, arc, line
from vehicle.frames import FloatArray, Pose2

Direction = Literal["left", "right"]
_SIDE: Final[dict[Direction, float]] = {"left": 1.0, "right": -1.0}

_QUARTER_TURN = 0.5 * math.pi  # [rad]
_ENTRY = 30.0  # 14 m of buffer, and some seconds in which the loop closes before the turn [m]
_EXIT = 35.0  # a follow point 19 m behind the tractor's front is 16 m out of the turn [m]
_RADIUS = 12.5  # outer circle of the EU roundabout, Directive 97/27/EC [m]
_LONGEST_ARC = 4.0 * math.pi  # more turns are pieced together: a path's segment holds two of them [rad]
_RAMP = 4.0  # of curvature into a circle: 16 deg/s of steer at 15 km/h, half of what a driver can do [m]
_ROAD_HALF_WIDTH = 4.5  # the roundabout's swept annulus is 7.2 m wide (12.5 m to 5.3 m), and a margin [m]
_ROAD_BEYOND = 40.0  # road behind the start and past the end: cameras look along it [m]
_SPACING = 0.5  # of the centreline's points [m]
PREVIEW: Final = 0.2  # how far ahead of the front axle a driver guides at speed [s]: it damps his steering well
_WAVE_PIECES = 32  # of a sine of curvature: straight lines between its values are off by 0.5 % of its peak
_GENTLE = 0.2  # a lane change of 1 in 5: its path is up to 0.4 rad off the road's direction and 3 % longer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """What the driver follows and where the road lies."""

    path: Path  # of the guided point, in W
    reference: tuple[float, float]  # the guided point in T [m]
    start: Pose2  # X_WT
    surface_centre: tuple[float, float] | None  # apex of a conical cross-fall [m]; None: a plane
    centreline: FloatArray  # (n, 2) of the road: way of the tractor's rear axle, beyond both ends too [m]
    road_half_width: float  # [m]

    @property
    def length(self) -> float:
        """The course is done when the guided point has gone this far along the path [m]."""
        return self.path.length


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
    """The tractor's outer front corner runs straight onto a circle, round it by ``turn`` [rad], and straight off it.

    Raises:
        ValueError: if ``direction`` is neither left nor right, a length is not positive, or the circle is too tight
            for the tractor's front end.
    """
    if direction not in _SIDE:
        raise ValueError(f"direction = {direction!r} must be 'left' or 'right'")
    side = _SIDE[direction]
    _check(front_x, width, radius, entry=entry, exit=exit, turn=turn)
    reference = (front_x, -0.5 * side * width)
    pieces = max(1, math.ceil(turn / _LONGEST_ARC - 1e-9))
    round_ = (arc(radius * turn / pieces, side / radius),) * pieces
    segments = (line(entry), *round_, line(exit))
    centre = (reference[0] + entry, reference[1] + side * radius)
    return _course(reference, segments, surface_centre=centre)


def figure_of_eight(
    *,
    front_x: float,
    width: float,
    radius: float = _RADIUS,
    entry: float = _ENTRY,
    exit: float = _EXIT,
) -> Course:
    """A full circle to the left, then one to the right, with the outer front corner on the ``radius`` [m] in both.

    The middle of the front is guided; its curvature ramps up and down over a few metres (clothoids), because
    from lock to lock no driver can jump. The ramps are part of the full circles.

    Raises:
        ValueError: if a length is not positive, or the circle is too tight for the tractor's front end.
    """
    _check(front_x, width, radius, entry=entry, exit=exit)
    guided_radius = math.hypot(math.sqrt(radius**2 - front_x**2) - 0.5 * width, front_x)
    kappa = 1.0 / guided_radius
    circle = math.tau * guided_radius - _RAMP  # each of the two ramps beside it turns by half of an equally long arc
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
    """A turn of the guided point, and the straight behind it."""

    direction: Direction
    radius: float  # [m]
    angle: float  # [rad]
    straight: float  # [m]


def turns(*, front_x: float, width: float, sequence: Sequence[Turn], entry: float = _ENTRY) -> Course:
    """The middle of the front goes round one turn after the other, with straights between them.

    Curvature ramps up and down as in a figure of eight; the ramps are part of the turns.

    Raises:
        ValueError: if there is no turn, a length is not positive, a direction is none, or a turn is too tight or short.
    """
    if not sequence:
        raise ValueError("turns is empty: a course needs at least one")
    segments = [line(entry)]
    for turn in sequence:
        if turn.direction not in _SIDE:
            raise ValueError(f"direction = {turn.direction!r} must be 'left' or 'right'")
        _check(front_x, width, turn.radius, entry=entry, straight=turn.straight)
        round_ = turn.radius * turn.angle - _RAMP  # each of the two ramps beside it turns by half of such an arc
        if not round_ > 0.0:
            raise ValueError(f"turn of {turn.radius * turn.angle:.2f} m: must be longer than {_RAMP:g} m of its ramps")
        kappa = _SIDE[turn.direction] / turn.radius
        segments += [Segment(_RAMP, 0.0, kappa), arc(round_, kappa), Segment(_RAMP, kappa, 0.0), line(turn.straight)]
    return _course((front_x, 0.0), tuple(segments))


def corner(
    *,
    wheel_x: float,
    wheel_y: float,
    direction: Direction = "left",
    radius: float = _RADIUS,
    turn: float = _QUARTER_TURN,
    entry: float = _ENTRY,
    exit: float = _EXIT,
) -> Course:
    """The outer wall of the outer steered tyre runs straight onto an arc, round it by ``turn`` [rad], and straight off.

    This is the low-speed turn of performance-based standards; ``wheel_x`` is the steered axle's place and ``wheel_y``
    how far out that wall stands [m].

    Raises:
        ValueError: if ``direction`` is neither left nor right, a length is not positive, or the arc is too tight.
    """
    if direction not in _SIDE:
        raise ValueError(f"direction = {direction!r} must be 'left' or 'right'")
    side = _SIDE[direction]
    _check(wheel_x, wheel_y, radius, entry=entry, exit=exit, turn=turn)
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

    The offset that comes of it is the acceleration over 2 pi times the frequency squared, 1.464 m with the defaults. At
    speed nobody steers by his front axle, which is at ``axle_x`` [m]: the guided point lies some travel ahead of it.

    Raises:
        ValueError: if ``direction`` is neither left nor right, a number is not positive, or the change is too sharp.
    """
    if direction not in _SIDE:
        raise ValueError(f"direction = {direction!r} must be 'left' or 'right'")
    _check_positive(axle_x=axle_x, speed=speed, frequency=frequency, peak_acceleration=peak_acceleration)
    _check_positive(entry=entry, exit=exit)
    length = speed / frequency
    offset = peak_acceleration / (2.0 * math.pi * frequency**2)
    if offset > _GENTLE * length:
        raise ValueError(f"lane change of {offset:.2f} m over {length:.2f} m: must be at most {_GENTLE:g} m a metre")
    peak = _SIDE[direction] * peak_acceleration / speed**2
    wave = [peak * math.sin(math.tau * k / _WAVE_PIECES) for k in range(_WAVE_PIECES + 1)]
    change = (Segment(length / _WAVE_PIECES, *ends) for ends in pairwise(wave))
    return _course((axle_x + PREVIEW * speed, 0.0), (line(entry), *change, line(exit)))


def straight(*, front_x: float, length: float) -> Course:
    """Straight ahead for ``length`` [m].

    Raises:
        ValueError: if a length is not positive.
    """
    _check_positive(front_x=front_x, length=length)
    return _course((front_x, 0.0), (line(length),))


def _course(
    reference: tuple[float, float],
    segments: tuple[Segment, ...],
    *,
    surface_centre: tuple[float, float] | None = None,
) -> Course:
    path = Path(Pose2(reference[0], reference[1], 0.0), segments)
    return Course(
        path=path,
        reference=reference,
        start=Pose2(0.0, 0.0, 0.0),
        surface_centre=surface_centre,
        centreline=_rear_axle_way(path, reference),
        road_half_width=_ROAD_HALF_WIDTH,
    )


def _rear_axle_way(path: Path, reference: tuple[float, float]) -> FloatArray:
    """Way of the rolling tractor's rear axle, shape (n, 2), from behind the start to past the end."""
    x_ref, y_ref = reference
    stations = np.arange(-_ROAD_BEYOND, path.length + _ROAD_BEYOND + _SPACING, _SPACING)
    headings = _headings(path, stations, reference)
    points = np.array([path.pose(float(s))[:2] for s in stations])
    c, s = np.cos(headings), np.sin(headings)
    return points - np.stack([c * x_ref - s * y_ref, s * x_ref + c * y_ref], axis=1)


def _headings(path: Path, stations: FloatArray, reference: tuple[float, float]) -> FloatArray:
    """Heading of T [rad] while the guided point goes along the path and the rear axle does not slide sideways."""
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


def _check(front_x: float, width: float, radius: float, **lengths: float) -> None:
    _check_positive(front_x=front_x, width=width, radius=radius, **lengths)
    tightest = math.hypot(front_x, width)
    if radius <= tightest:
        raise ValueError(f"radius = {radius} m must exceed {tightest:.2f} m: no tractor turns about its own wheel")


def _check_positive(**lengths: float) -> None:
    for name, value in lengths.items():
        if not value > 0.0:
            raise ValueError(f"{name} = {value} must be positive")
