"""Reference line of a road: lines, arcs, spirals, and cubic polynomials, by the distance along the road."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from controllers.path import Path, Segment
from vehicle.frames import FloatArray, Pose2

_INTERVALS: Final = 64  # of a cubic polynomial, whose length is summed up
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)  # in each of them: to rounding for curves of roads
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_NEWTON: Final = 3  # steps from the linear guess within an interval


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Geometry:
    """A piece of the reference line."""

    s: float  # its begin along the road [m]
    start: Pose2  # in the coordinates of the file
    length: float  # [m]
    local: Callable[[FloatArray], FloatArray]  # poses (n, 3) from its start, at distances (n,) from it [m]
    line: int  # in the file

    def poses(self, along: FloatArray) -> FloatArray:
        """Positions [m] and headings [rad] (n, 3) at distances from its begin (n,) [m]."""
        u, v, turn = self.local(along).T
        c, s = np.cos(self.start.psi), np.sin(self.start.psi)
        return np.stack([self.start.x + c * u - s * v, self.start.y + s * u + c * v, self.start.psi + turn], axis=1)


def clothoid(length: float, start: float, end: float) -> Callable[[FloatArray], FloatArray]:
    """A line, an arc or a spiral, by its length [m] and the curvature at both ends [1/m]."""
    return Path(Pose2(0.0, 0.0, 0.0), (Segment(length, start, end),)).poses


def parametric(u: FloatArray, v: FloatArray, end: float) -> Callable[[FloatArray], FloatArray]:
    """The curve u(p), v(p) of cubic polynomials (4,) in the parameter p = ``end`` * share of the length [m]."""

    def poses(p: FloatArray) -> FloatArray:
        powers = np.stack([np.ones_like(p), p, p**2, p**3], axis=1)
        slopes = np.stack([np.zeros_like(p), np.ones_like(p), 2.0 * p, 3.0 * p**2], axis=1)
        return np.stack([powers @ u, powers @ v, np.arctan2(slopes @ v, slopes @ u)], axis=1)

    return lambda along: poses(end * along)


def polynomial(v: FloatArray, length: float) -> Callable[[FloatArray], FloatArray]:
    """The curve v(u) of a cubic polynomial (4,), by the distance along it."""

    def slope(u: FloatArray) -> FloatArray:
        return np.asarray(v[1] + u * (2.0 * v[2] + 3.0 * v[3] * u), dtype=np.float64)

    knots = np.linspace(0.0, length, _INTERVALS + 1)  # u is never longer than the curve
    step = knots[1]
    pieces = step * (np.hypot(1.0, slope(knots[:-1, None] + step * _NODES)) @ _WEIGHTS)
    lengths = np.concatenate([[0.0], np.cumsum(pieces)])

    def poses(along: FloatArray) -> FloatArray:
        k = np.clip(np.searchsorted(lengths, along, side="right") - 1, 0, _INTERVALS - 1)
        u = knots[k] + step * (along - lengths[k]) / pieces[k]
        for _ in range(_NEWTON):
            inside = u - knots[k]
            length_of_u = lengths[k] + inside * (
                np.hypot(1.0, slope(knots[k][:, None] + inside[:, None] * _NODES)) @ _WEIGHTS
            )
            u = u + (along - length_of_u) / np.hypot(1.0, slope(u))
        height = v[0] + u * (v[1] + u * (v[2] + u * v[3]))
        return np.stack([u, height, np.arctan(slope(u))], axis=1)

    return poses


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceLine:
    """Pieces one after the other."""

    pieces: tuple[Geometry, ...]

    @property
    def length(self) -> float:
        """Length of the road [m]."""
        return self.pieces[-1].s + self.pieces[-1].length

    def poses(self, s: FloatArray) -> FloatArray:
        """Positions [m] and headings [rad] (n, 3) at distances along the road (n,) [m]."""
        which = np.clip(np.searchsorted([piece.s for piece in self.pieces], s, side="right") - 1, 0, None)
        poses = np.empty((len(s), 3))
        for k in np.unique(which).tolist():
            rows = which == k
            poses[rows] = self.pieces[k].poses(s[rows] - self.pieces[k].s)
        return poses

    def gaps(self) -> FloatArray:
        """Distances between the end of each piece and the begin of the next (n - 1, 2) [m, rad]."""
        gaps = np.zeros((len(self.pieces) - 1, 2))
        for k, (piece, after) in enumerate(zip(self.pieces[:-1], self.pieces[1:], strict=True)):
            x, y, psi = piece.poses(np.array([piece.length]))[0].tolist()
            turn = (after.start.psi - psi + np.pi) % (2.0 * np.pi) - np.pi
            gaps[k] = np.hypot(after.start.x - x, after.start.y - y), abs(turn)
        return gaps
