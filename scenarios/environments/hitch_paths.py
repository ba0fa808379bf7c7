"""The past paths of many hitches, and how far each lies beside its follow point.

Points of a path are equally far apart along it. Each trailer remembers between which two of them its follow point is,
and looks from there: where a path crosses itself, it stays on the branch that it came on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.trailer_steering.policy import AHEAD
from vehicle.frames import FloatArray

_SPACING = 0.1  # [m]; the parabola through such points on a circle of 10 m is a micrometre off
_LONGEST = 3.0  # path kept, in follow distances: half a circle that just reaches the follow point has pi / 2
_FOUR = np.arange(-1, 3)[:, None]  # points around the follow point, from the one behind it
_SQUARE = 1e-6  # a path that runs square to the trailer has no single point beside the follow point [m]
_MOST_MOVES = 8  # points that a follow point passes in a control step: 40 m/s


class Beside(NamedTuple):
    """The paths beside n follow points, in the trailers' frames."""

    offset: FloatArray  # (n,) off-tracking: + where the path lies left of the follow point [m]
    direction: FloatArray  # (n,) of the path as it was travelled, + left of the trailer's axis [rad]
    ahead: FloatArray  # (n, 3) lateral position of the path ``AHEAD`` of the follow point, along its arc [m]


class Mark(NamedTuple):
    """One moment of n paths, to look back at them from."""

    poses: FloatArray  # (n, 3) of the trailers, x y [m], psi [rad]
    n_points: NDArray[np.intp]  # (n,) until then


class HitchPaths:
    """Paths of n hitches."""

    def __init__(self, n: int, longest_follow_distance: float) -> None:
        """For follow distances up to this one [m]."""
        needed = _LONGEST * longest_follow_distance / _SPACING
        self._size = 1 << math.ceil(math.log2(needed))
        self._points = np.zeros((n, self._size), dtype=np.complex128)
        self._flat = self._points.reshape(-1)
        self._row = np.arange(n) * self._size
        self._count = np.zeros(n, dtype=np.intp)  # of points so far; the newest is the last
        self._at = np.zeros(n, dtype=np.intp)  # the last point behind the follow point
        self._last = np.zeros(n, dtype=np.complex128)  # where the hitch was last
        self._way = np.zeros(n)  # since the newest point [m]
        self._follow = np.ones(n)
        self._ahead = np.zeros((n, len(AHEAD)), dtype=np.intp)
        self._poses = np.zeros((n, 3))

    def begin(self, lanes: NDArray[np.intp], poses: FloatArray, follow_distance: FloatArray) -> None:
        """These trailers, x y psi (k, 3), have come straight to where they are, all the way."""
        here, heading = poses[:, 0] + 1j * poses[:, 1], np.exp(1j * poses[:, 2])
        back = _SPACING * np.arange(self._size - 1, -1, -1)
        self._points[lanes] = here[:, None] - heading[:, None] * back
        self._count[lanes] = self._size
        self._at[lanes] = self._size - 1 - np.ceil(follow_distance / _SPACING).astype(np.intp)
        self._last[lanes], self._way[lanes] = here, 0.0
        self._follow[lanes] = follow_distance
        self._ahead[lanes] = np.rint(follow_distance[:, None] * AHEAD / _SPACING)

    def step(self, poses: FloatArray) -> Beside:
        """The paths with all trailers now at x y psi (n, 3)."""
        here = poses[:, 0] + 1j * poses[:, 1]
        self._poses = poses
        self._extend(here)
        turned = np.exp(-1j * poses[:, 2])
        around = self._around_follow_point(here, turned)
        return self._beside(around, here, turned)

    def mark(self) -> Mark:
        """This moment."""
        return Mark(self._poses.copy(), self._count.copy())

    def behind(self, lane: int, mark: Mark, reach: float) -> FloatArray:
        """The path of one hitch as it was at a moment not long ago, (k, 2), newest first, in the trailer's frame [m].

        It begins at the hitch and ends ``reach`` [m] behind it along the trailer's axis, or where the points end.
        """
        x, y, psi = mark.poses[lane].tolist()
        numbers = np.arange(mark.n_points[lane] - 1, self._count[lane] - self._size, -1)
        points = (self._points[lane, numbers & (self._size - 1)] - complex(x, y)) * np.exp(-1j * psi)
        beyond = np.flatnonzero(points.real < -reach)
        points = points[: beyond[0] if len(beyond) else len(points)]
        return np.concatenate([np.zeros((1, 2)), np.column_stack([points.real, points.imag])])

    def _extend(self, here: NDArray[np.complex128]) -> None:
        step = here - self._last
        way = np.abs(step)
        before = self._way.copy()
        self._way = before + way
        while True:
            full = np.flatnonzero(self._way >= _SPACING)
            if not len(full):
                break
            part = (_SPACING - before[full]) / way[full]
            self._flat[self._row[full] + (self._count[full] & (self._size - 1))] = self._last[full] + part * step[full]
            self._count[full] += 1
            self._way[full] -= _SPACING
            before[full] -= _SPACING
        self._last = here

    def _around_follow_point(
        self, here: NDArray[np.complex128], turned: NDArray[np.complex128]
    ) -> NDArray[np.complex128]:
        """Four points in the trailers' frames, (4, n); the follow point is beside the piece between the middle two."""
        newest, oldest = self._count - 3, self._count - (self._size - 1)
        for _ in range(_MOST_MOVES):
            four = (self._flat[self._row + ((self._at + _FOUR) & (self._size - 1))] - here) * turned
            move = (four[2].real <= -self._follow).astype(np.intp) - (four[1].real > -self._follow)
            moved = np.minimum(np.maximum(self._at + move, oldest), newest)
            if (moved == self._at).all():
                break
            self._at = moved
        return four

    def _beside(
        self, four: NDArray[np.complex128], here: NDArray[np.complex128], turned: NDArray[np.complex128]
    ) -> Beside:
        a, b = four[1], four[2]
        along = b.real - a.real
        along = np.where(np.abs(along) < _SQUARE, _SQUARE, along)
        t = (-self._follow - a.real) / along
        t = np.minimum(np.maximum(t, 0.0), 1.0)
        # The parabola between a and b falls short of their chord by t (1 - t) of the bend, along and across.
        bend = 0.25 * (four[0] - a - b + four[3])
        t = t + t * (1.0 - t) * bend.real / along
        offset = a.imag + t * (b.imag - a.imag) - t * (1.0 - t) * bend.imag
        onward = b - a - (1.0 - 2.0 * t) * bend
        further = self._row[:, None] + ((self._at[:, None] + self._ahead) & (self._size - 1))
        ahead = ((self._flat[further] - here[:, None]) * turned[:, None]).imag
        return Beside(offset, np.arctan2(onward.imag, onward.real), ahead)
