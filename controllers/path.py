"""Planar paths by arc length, made of segments whose curvature changes linearly: lines, arcs and clothoids.

Speed profiles of paths keep limits of lateral and longitudinal acceleration.
"""

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vehicle.frames import FloatArray, Pose2, quadrature

_SPACING = 0.5  # of the profile's points [m]
# Gauss-Legendre rule on [0, 1]: integrates exp(i theta(u)) to rounding for turns of up to 4 pi within a segment.
_NODES, _WEIGHTS = quadrature(32)
_MAX_TURN = 4.0 * math.pi  # [rad]
_PROJECTION_STEPS = 30  # Newton needs 2 to 4 from a good guess
_LAST_STEP = 1e-6  # [m]; what is left is in proportion to its square


class Segment(NamedTuple):
    """A part of a path whose curvature changes linearly from start to end."""

    length: float  # [m]
    start_curvature: float  # + left [1/m]
    end_curvature: float  # [1/m]

    @property
    def turn(self) -> float:
        """Change of heading over the segment [rad]."""
        return 0.5 * (self.start_curvature + self.end_curvature) * self.length

    def advance(self, start: Pose2, u: float) -> Pose2:
        """Pose after the distance u [m] from ``start``; the heading is not wrapped."""
        if self.start_curvature == self.end_curvature:  # along the chord of the arc
            half = 0.5 * self.start_curvature * u
            chord, middle = u if half == 0.0 else u * math.sin(half) / half, start.psi + half
            x, y = start.x + chord * math.cos(middle), start.y + chord * math.sin(middle)
            return Pose2(x, y, start.psi + u * self.start_curvature)
        sharpness = (self.end_curvature - self.start_curvature) / self.length
        distances = u * _NODES
        headings = start.psi + distances * (self.start_curvature + 0.5 * sharpness * distances)
        x = start.x + u * float(_WEIGHTS @ np.cos(headings))
        y = start.y + u * float(_WEIGHTS @ np.sin(headings))
        return Pose2(x, y, start.psi + u * (self.start_curvature + 0.5 * sharpness * u))


def line(length: float) -> Segment:
    """A straight line [m]."""
    return Segment(length, 0.0, 0.0)


def arc(length: float, curvature: float) -> Segment:
    """A circular arc: length [m], curvature [1/m], + left."""
    return Segment(length, curvature, curvature)


@dataclass(frozen=True, slots=True)
class Path:
    """A path with continuous heading, extended by straight lines before its start and after its end.

    Raises:
        ValueError: if there is no segment, one has no length, or one turns by more than 4 pi.
    """

    start: Pose2
    segments: tuple[Segment, ...]
    # Of each segment's start, and of the end [m]
    stations: tuple[float, ...] = field(init=False, repr=False, compare=False)
    knots: tuple[Pose2, ...] = field(init=False, repr=False, compare=False)  # the poses there

    def __post_init__(self) -> None:
        if not self.segments:
            raise ValueError("segments is empty: a path needs at least one")
        stations, knots = [0.0], [self.start]
        for segment in self.segments:
            _check(segment)
            stations.append(stations[-1] + segment.length)
            knots.append(segment.advance(knots[-1], segment.length))
        object.__setattr__(self, "stations", tuple(stations))
        object.__setattr__(self, "knots", tuple(knots))

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return self.stations[-1]

    def pose(self, s: float) -> Pose2:
        """Position [m] and heading [rad] at the arc length s [m]; the heading counts full turns."""
        if s <= 0.0:
            return _ahead(self.knots[0], s)
        if s >= self.length:
            return _ahead(self.knots[-1], s - self.length)
        i = bisect.bisect_right(self.stations, s) - 1
        return self.segments[i].advance(self.knots[i], s - self.stations[i])

    def headings(self, stations: Sequence[float]) -> list[float]:
        """Headings at arc lengths [m], counting full turns [rad]."""
        headings, begins, last = [], self.stations, len(self.segments)
        for s in stations:
            i = bisect.bisect_right(begins, s, 1, last) - 1
            (length, start, end), u = self.segments[i], min(max(s, 0.0), begins[-1]) - begins[i]
            headings.append(self.knots[i].psi + u * (start + 0.5 * ((end - start) / length) * u))
        return headings

    def poses(self, stations: FloatArray) -> FloatArray:
        """Positions [m] and headings [rad] at arc lengths (n,) [m], as from ``pose``, shape (n, 3)."""
        knots, begins = np.array(self.knots[:-1]), np.array(self.stations)
        length, start, end = np.array(self.segments).T
        k = np.clip(np.searchsorted(begins, stations, side="right") - 1, 0, len(length) - 1)
        inside = np.clip(stations, 0.0, self.length)
        beyond, u, sharpness = stations - inside, inside - begins[k], ((end - start) / length)[k]
        distances = u[:, None] * _NODES
        headings = knots[k, 2, None] + distances * (start[k, None] + 0.5 * sharpness[:, None] * distances)
        psi = knots[k, 2] + u * (start[k] + 0.5 * sharpness * u)
        x = knots[k, 0] + u * (np.cos(headings) @ _WEIGHTS) + beyond * np.cos(psi)
        y = knots[k, 1] + u * (np.sin(headings) @ _WEIGHTS) + beyond * np.sin(psi)
        return np.stack([x, y, psi], axis=1)

    def curvature(self, s: float) -> float:
        """Curvature at the arc length s [m], + left [1/m]; at a jump, the value ahead."""
        if not 0.0 <= s < self.length:
            return 0.0
        i = bisect.bisect_right(self.stations, s) - 1
        segment = self.segments[i]
        fraction = (s - self.stations[i]) / segment.length
        return segment.start_curvature + fraction * (segment.end_curvature - segment.start_curvature)

    def project(self, x: float, y: float, near: float) -> float:
        """Arc length [m] of the path's point nearest to x, y [m], on the branch around the arc length ``near`` [m]."""
        s = near
        for _ in range(_PROJECTION_STEPS):
            at_x, at_y, psi = self.pose(s)
            c, sin = math.cos(psi), math.sin(psi)
            along = c * (x - at_x) + sin * (y - at_y)
            across = c * (y - at_y) - sin * (x - at_x)
            # Newton on along(s) = 0; the slope is limited beyond half the distance to the centre of curvature.
            step = along / max(1.0 - self.curvature(s) * across, 0.5)
            s += step
            if abs(step) < _LAST_STEP:
                break
        return s

    def points(self, spacing: float) -> FloatArray:
        """Points along the whole path, shape (n, 2), about ``spacing`` [m] apart."""
        count = max(2, math.ceil(self.length / spacing) + 1)
        return np.array([self.pose(float(s))[:2] for s in np.linspace(0.0, self.length, count)])


def _check(segment: Segment) -> None:
    if segment.length <= 0.0:
        raise ValueError(f"length = {segment.length} m of a path segment must be positive")
    if abs(segment.turn) > _MAX_TURN:
        raise ValueError(f"turn = {segment.turn:.3f} rad of a path segment must be within {_MAX_TURN:.3f} rad")


def _ahead(pose: Pose2, distance: float) -> Pose2:
    """The pose moved along its own heading by ``distance`` [m]."""
    return Pose2(pose.x + distance * math.cos(pose.psi), pose.y + distance * math.sin(pose.psi), pose.psi)


@dataclass(frozen=True, slots=True, eq=False)
class SpeedProfile:
    """Speed over the arc length of a path."""

    stations: FloatArray  # (n,) [m]
    speeds: FloatArray  # (n,) [m/s]

    @classmethod
    def of(cls, path: Path, speed: float, max_lateral_acceleration: float, max_acceleration: float) -> "SpeedProfile":
        """The fastest profile within ``speed`` [m/s] and both accelerations [m/s2]."""
        stations = np.linspace(0.0, path.length, max(2, math.ceil(path.length / _SPACING) + 1))
        curvatures = np.array([abs(path.curvature(float(s))) for s in stations])
        # A limit between two points applies to both.
        curvatures[:-1] = np.maximum(curvatures[:-1], curvatures[1:])
        squares = np.minimum(speed**2, max_lateral_acceleration / np.maximum(curvatures, 1e-9))
        gain = 2.0 * max_acceleration * float(stations[1])
        for k in range(len(squares) - 2, -1, -1):
            squares[k] = min(squares[k], squares[k + 1] + gain)
        for k in range(1, len(squares)):
            squares[k] = min(squares[k], squares[k - 1] + gain)
        return cls(stations, np.sqrt(squares))

    @property
    def duration(self) -> float:
        """Duration of the drive along the path [s]."""
        middles = 0.5 * (self.speeds[1:] + self.speeds[:-1])
        return float(np.sum(np.diff(self.stations) / middles))

    def at(self, station: float) -> float:
        """Speed at an arc length [m/s]."""
        return float(np.interp(station, self.stations, self.speeds))
