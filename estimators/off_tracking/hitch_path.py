"""Geometry of a sampled path in the trailer frame S: crossings of a given x, tangents and curvature.

Paths are (n, 2) [m], newest point first; s is the length of the chords from the newest point back [m].
"""

from typing import NamedTuple

import numpy as np

from vehicle.frames import FloatArray

_LEAST_POINTS = 5  # two more than the coefficients of a parabola, to average the noise
_BISECTIONS = 40  # a metre to 1e-12 m
_APART = 1e-6  # points closer together count as one: their distance is rounding [m]
_LEAST_SPAN = 0.1  # shorter pieces show the direction of the noise, not of the path [m]
_LEAST_ADVANCE = 0.01  # advance per length of path; it is 1 on a path, and less where noise or reversing folds it [-]


class Crossing(NamedTuple):
    """Crossing of the path with a given x."""

    s: float  # [m]
    y: float  # [m]
    beyond: int  # index of the first point beyond it


class Tangent(NamedTuple):
    """Direction and curvature of the path in the sense of travel."""

    direction: float  # + left of the x axis [rad]
    curvature: float  # + turning left [1/m]


def crossing(path: FloatArray, s: FloatArray, x: float) -> Crossing | None:
    """Most recent crossing of x from ahead, on the cubic through the four points around it; None without one.

    The chord between the two points, as printed in de Saxe 2018, eq. 7, would cost 2 mm RMS at R = 12 m.
    """
    beyond = path[:, 0] <= x  # de Saxe 2018, eq. 6
    index = int(np.argmax(beyond))
    if index == 0:  # no point beyond x, or the hitch itself is beyond
        return None
    if s[index] - s[index - 1] < _APART:
        return Crossing(s=float(s[index]), y=float(path[index, 1]), beyond=index)
    # The next points on both sides that are not repetitions: a repeated point leaves the cubic undetermined.
    before = int(s.searchsorted(s[index - 1] - _APART)) - 1
    after = int(s.searchsorted(s[index] + _APART, side="right"))
    around = [point for point in (before, index - 1, index, after) if 0 <= point < len(s)]
    origin = s[index - 1]
    powers = _powers(s[around] - origin, len(around))[::-1].T
    of_x, of_y = (_Cubic(*[0.0] * (4 - len(around)), *column) for column in np.linalg.solve(powers, path[around]).T)
    u = _falls_to(of_x, x, float(s[index] - origin))
    return Crossing(s=float(origin + u), y=of_y.at(u), beyond=index)


class _Cubic(NamedTuple):
    """Coefficients of a polynomial, the highest power's first."""

    a: float
    b: float
    c: float
    d: float

    def at(self, u: float) -> float:
        """Its value: Horner on floats, as np.polyval costs 20 times as much, and controllers ask often."""
        return ((self.a * u + self.b) * u + self.c) * u + self.d


def _powers(u: FloatArray, count: int) -> FloatArray:
    """Powers (count, n) of u (n,) from 0 on: the columns of np.vander, which takes longer than the solution."""
    powers = np.ones((count, len(u)))
    for k in range(1, count):
        powers[k] = powers[k - 1] * u
    return powers


def _falls_to(cubic: _Cubic, value: float, end: float) -> float:
    """Argument in (0, ``end``) at which the polynomial falls to the value, by bisection: safe against rounding."""
    low, high = 0.0, end
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if cubic.at(middle) > value else (low, middle)
    return high


def tangent(path: FloatArray, s: FloatArray, at: float, reach: float) -> Tangent:
    """Tangent at s = ``at`` of the least-squares parabola through the points within ``reach`` of it.

    A parabola is unbiased on a circle, and one or two metres of path average the noise of single points. For a path
    that is too short, or turns back there, direction and curvature are 0.
    """
    distance = np.abs(s - at)
    least = min(_LEAST_POINTS, len(distance)) - 1
    near = np.flatnonzero(distance <= max(reach, float(np.partition(distance, least)[least])))
    if len(near) < 3 or np.ptp(s[near]) < _LEAST_SPAN:
        return Tangent(0.0, 0.0)
    _, (dx, dy), (ddx, ddy) = np.linalg.lstsq(_powers(s[near] - at, 3).T, path[near], rcond=None)[0]
    if np.hypot(dx, dy) < _LEAST_ADVANCE:
        return Tangent(0.0, 0.0)
    # s runs backwards along the travel, so both the direction and the curvature change sign
    curvature = -2.0 * (dx * ddy - dy * ddx) / (dx * dx + dy * dy) ** 1.5
    return Tangent(float(np.arctan2(-dy, -dx)), float(curvature))
