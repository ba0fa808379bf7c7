"""Geometry of a sampled path in the trailer frame S: crossings of a given x, tangents and curvature.

Paths are (n, 2) [m], newest point first; s is the length of the chords from the newest point back [m].
"""

import math
from typing import NamedTuple

import numpy as np

from vehicle.frames import FloatArray

_LEAST_POINTS = 5  # two more than the coefficients of a parabola, to average the noise
_SECANTS = 60  # five are usual
_CLOSE = 1e-12  # [m]
_SAME = 1e-9  # relative determinant without a parabola: rounding [-]
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
    index = int(beyond.argmax())
    if index == 0:  # no point beyond x, or the hitch itself is beyond
        return None
    if s[index] - s[index - 1] < _APART:
        return Crossing(s=float(s[index]), y=float(path[index, 1]), beyond=index)
    # The next points on both sides that are not repetitions: a repeated point leaves the cubic undetermined.
    before, after = index - 2, index + 1
    while before >= 0 and s[index - 1] - s[before] <= _APART:
        before -= 1
    while after < len(s) and s[after] - s[index] <= _APART:
        after += 1
    around = [point for point in (before, index - 1, index, after) if 0 <= point < len(s)]
    nodes, (of_x, of_y) = s[around].tolist(), path[around].T.tolist()
    there = _falls_to(nodes, of_x, x, float(s[index - 1]), float(s[index]))
    return Crossing(s=there, y=_interpolated(nodes, of_y, there), beyond=index)


def _interpolated(nodes: list[float], values: list[float], u: float) -> float:
    """Value at u of the polynomial through values at two to four nodes, by Neville's scheme on floats."""
    if len(nodes) == 4:  # the usual case; written out, it takes a third of the time
        (a, b, c, d), (p, q, r, s) = nodes, values
        u_a, u_b, u_c, u_d = u - a, u - b, u - c, u - d
        p, q, r = (u_b * p - u_a * q) / (a - b), (u_c * q - u_b * r) / (b - c), (u_d * r - u_c * s) / (c - d)
        p, q = (u_c * p - u_a * q) / (a - c), (u_d * q - u_b * r) / (b - d)
        return (u_d * p - u_a * q) / (a - d)
    for order in range(1, len(nodes)):
        pairs = zip(nodes, nodes[order:], values, values[1:], strict=False)
        values = [((u - b) * of_a - (u - a) * of_b) / (a - b) for a, b, of_a, of_b in pairs]
    return values[0]


def _falls_to(nodes: list[float], values: list[float], value: float, low: float, high: float) -> float:
    """Argument between ``low`` and ``high`` at which that polynomial falls to the value, by secants: it is smooth.

    ``scipy.optimize`` takes 0.3 s to import: without cameras it would be in the first step of a run or an environment.
    """
    above, below = (_interpolated(nodes, values, u) - value for u in (low, high))
    for _ in range(_SECANTS):
        if above <= below:  # rounding
            break
        u = (low * below - high * above) / (below - above)
        rest = _interpolated(nodes, values, u) - value
        if abs(rest) < _CLOSE:
            return u
        if rest > 0.0:
            low, above = u, rest
        else:
            high, below = u, rest
    return high


def tangent(path: FloatArray, s: FloatArray, at: float, reach: float) -> Tangent:
    """Tangent at s = ``at`` of the least-squares parabola through the points within ``reach`` of it.

    A parabola is unbiased on a circle, and one or two metres of path average the noise of single points. For a path
    that is too short, or turns back there, direction and curvature are 0.
    """
    first, end = s.searchsorted(at - reach), s.searchsorted(at + reach, side="right")
    if end - first < _LEAST_POINTS < len(s):
        distance = np.sort(np.abs(s - at))[_LEAST_POINTS - 1]
        first, end = s.searchsorted(at - distance), s.searchsorted(at + distance, side="right")
    piece = slice(first, end) if len(s) > _LEAST_POINTS else slice(None)
    u = s[piece] - at
    if len(u) < 3 or u[-1] - u[0] < _LEAST_SPAN:
        return Tangent(0.0, 0.0)
    dx, dy, ddx, ddy = _parabola(u, path[piece])
    if math.hypot(dx, dy) < _LEAST_ADVANCE:
        return Tangent(0.0, 0.0)
    # s runs backwards along the travel, so both the direction and the curvature change sign
    curvature = -2.0 * (dx * ddy - dy * ddx) / (dx * dx + dy * dy) ** 1.5
    return Tangent(math.atan2(-dy, -dx), curvature)


def _parabola(u: FloatArray, points: FloatArray) -> list[float]:
    """Linear and quadratic coefficients (dx, dy, ddx, ddy) of the least-squares parabola through points (n, 2) at u.

    By the normal equations about the mean of u: within a metre or two they are well conditioned.
    """
    mean = float(u.sum()) / len(u)
    v = u - mean
    squares = v * v - float(v @ v) / len(u)
    a, b, c = float(v @ v), float(v @ squares), float(squares @ squares)
    linear, quadratic = v @ points, squares @ points
    determinant = a * c - b * b
    bend = (a * quadratic - b * linear) / determinant if determinant > _SAME * a * c else 0.0 * linear
    return [*((linear - b * bend) / a - 2.0 * mean * bend).tolist(), *bend.tolist()]
