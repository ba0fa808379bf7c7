"""The way back: where the last axle is to go, and how all units ahead of it stand when it goes there without slip."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from controllers.reversing.chain import RollingChain
from vehicle.frames import FloatArray, Pose2

_SPACING: Final = 0.1  # of the reference's points [m]
_SMOOTHING: Final = 0.6  # of the points given: a curve of 10 m radius is cut by 2 cm [m]
_BEYOND: Final = 8.0  # it goes on at both ends [m]
_LAST: Final = 3.0  # ... as its last stretch went [m]
_LEAST: Final = 1.0  # to make a way of [m]
_PROJECTION_STEPS: Final = 4  # Newton from the step before, a centimetre away
_NO_LEVER: Final = 0.02  # a hitch nearer to its axle goes where the axle does [m]


class ReferencePoint(NamedTuple):
    """The reference at a station."""

    pose: Pose2  # of the last axle, pointing forwards; the heading counts full turns
    curvature: float  # of its way, + left [1/m]
    articulation: FloatArray  # (N,) at each hitch [rad]
    tractor_curvature: float  # of the tractor's rear axle [1/m]


@dataclass(frozen=True, slots=True, eq=False)
class ReverseReference:
    """A way of the last axle, by its stations: they grow forwards, so that reversing goes down in them."""

    stations: FloatArray  # (n,) [m]
    way: FloatArray  # (n, 2) [m]
    headings: FloatArray  # (n,) [rad]
    curvatures: FloatArray  # (n,) [1/m]
    articulations: FloatArray  # (n, N) [rad]
    tractor_curvatures: FloatArray  # (n,) [1/m]

    @classmethod
    def of(cls, chain: RollingChain, points: FloatArray) -> ReverseReference:
        """The reference through points (n, 2) [m] of the last axle's way, in the order of driving forwards.

        Station 0 is at the first point.

        Raises:
            ValueError: if the points span less than 1 m.
        """
        way, first = _resampled(points)
        headings = _directions(way)
        stations: FloatArray = np.linspace(-first, _SPACING * (len(way) - 1) - first, len(way))
        axle, psi = way, headings
        ahead: list[FloatArray] = []
        for hitch, length in zip(reversed(chain.hitches), reversed(chain.lengths), strict=True):
            hung = axle + length * _along(psi)
            towing = _towing(hung, hitch)
            ahead.insert(0, towing - psi)
            axle, psi = hung - hitch * _along(towing), towing
        tractor_way = np.hypot(*np.gradient(axle, axis=0).T)
        return cls(
            stations=stations,
            way=way,
            headings=headings,
            curvatures=np.gradient(headings, _SPACING),
            articulations=np.column_stack(ahead),
            tractor_curvatures=np.gradient(psi) / tractor_way,
        )

    def at(self, station: float) -> ReferencePoint:
        """The reference at a station [m]."""
        k = (station - self.stations[0]) / _SPACING
        i = min(max(int(k), 0), len(self.stations) - 2)
        share = k - i

        def between(values: FloatArray) -> FloatArray:
            mixed: FloatArray = values[i] + share * (values[i + 1] - values[i])
            return mixed

        x, y = between(self.way).tolist()
        return ReferencePoint(
            pose=Pose2(x, y, float(between(self.headings))),
            curvature=float(between(self.curvatures)),
            articulation=between(self.articulations),
            tractor_curvature=float(between(self.tractor_curvatures)),
        )

    def project(self, x: float, y: float, near: float) -> float:
        """Station [m] of the point nearest to x, y [m], around the station ``near`` [m]."""
        s = near
        for _ in range(_PROJECTION_STEPS):
            on = self.at(s)
            c, sin = math.cos(on.pose.psi), math.sin(on.pose.psi)
            across = c * (y - on.pose.y) - sin * (x - on.pose.x)
            s += (c * (x - on.pose.x) + sin * (y - on.pose.y)) / max(1.0 - on.curvature * across, 0.5)
        return s


def _resampled(points: FloatArray) -> tuple[FloatArray, float]:
    """Smoothed points at equal spacing, going on beyond both ends, and how far in the first one given is [m]."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    kept = np.concatenate([[True], steps > 1e-6])
    points, s = points[kept], np.concatenate([[0.0], np.cumsum(steps[kept[1:]])])
    if s[-1] < _LEAST:
        raise ValueError(f"points span {s[-1]:.2f} m: a way back needs {_LEAST:g} m at least")
    beyond = np.arange(_SPACING, _BEYOND, _SPACING)
    before, behind = _carried_on(points[::-1], s[-1] - s[::-1], beyond)[::-1], _carried_on(points, s, beyond)
    s = np.concatenate([-beyond[::-1], s, s[-1] + beyond])
    stations = np.arange(s[0], s[-1], _SPACING)
    line = np.column_stack([np.interp(stations, s, column) for column in np.vstack([before, points, behind]).T])
    smooth = gaussian_filter1d(line, _SMOOTHING / _SPACING, axis=0, mode="nearest", truncate=3.0)
    bent = math.ceil(3.0 * _SMOOTHING / _SPACING) + 1  # the filter reaches beyond the very ends
    return smooth[bent:-bent], -s[0] - bent * _SPACING


def _carried_on(points: FloatArray, s: FloatArray, beyond: FloatArray) -> FloatArray:
    """Points so far ``beyond`` the end (m,) [m] of a way, on the arc of its last stretch."""
    low = max(0.0, s[-1] - _LAST)
    a, b, c = (np.array([np.interp(at, s, column) for column in points.T]) for at in (low, 0.5 * (low + s[-1]), s[-1]))
    first, second = (math.atan2(*(chord[::-1])) for chord in (b - a, c - b))
    half = 0.5 * (s[-1] - low)
    curvature = math.remainder(second - first, math.tau) / half
    headings = second + curvature * (0.5 * half + beyond - 0.5 * _SPACING)
    onward: FloatArray = c + _SPACING * np.cumsum(_along(headings), axis=0)
    return onward


def _directions(way: FloatArray) -> FloatArray:
    """Direction of the way at each of its points [rad], continuous."""
    tangents = np.gradient(way, axis=0)
    directions: FloatArray = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
    return directions


def _towing(hung: FloatArray, hitch: float) -> FloatArray:
    """Heading [rad] of the unit whose hitch, ``hitch`` [m] ahead of its axle, goes along the points (n, 2).

    Between two points the hitch goes straight on, and half the angle's tangent to that falls by e every ``hitch``; a
    hitch behind the axle is steady only the other way.
    """
    directions = _directions(hung)
    if abs(hitch) < _NO_LEVER:
        return directions
    fading = np.exp(-np.hypot(*np.diff(hung, axis=0).T) / abs(hitch))
    order = range(1, len(hung)) if hitch > 0.0 else range(len(hung) - 2, -1, -1)
    headings = directions.copy()
    for k in order:
        before, faded = (k - 1, fading[k - 1]) if hitch > 0.0 else (k + 1, fading[k])
        middle = 0.5 * (directions[before] + directions[k])
        headings[k] = middle + 2.0 * math.atan(faded * math.tan(0.5 * (headings[before] - middle)))
    return headings


def _along(psi: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(psi), np.sin(psi)])
