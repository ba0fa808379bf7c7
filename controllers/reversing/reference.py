"""Reference for reversing: path of the last axle and the articulation of all units on it, without tyre slip."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from controllers.reversing.chain import RollingChain
from vehicle.frames import FloatArray, Pose2

_SPACING: Final = 0.1  # of the reference's points [m]
_SMOOTHING: Final = 0.6  # of the given points: cuts a curve of 10 m radius by 2 cm [m]
_EXTENSION: Final = 8.0  # at both ends [m]
_END: Final = 3.0  # length whose arc is continued there [m]
_LEAST: Final = 1.0  # length of the given points [m]
_PROJECTION_STEPS: Final = 4  # Newton from the previous step, a centimetre away
_NO_LEVER: Final = 0.02  # a hitch closer to its axle moves as the axle does [m]


class ReferencePoint(NamedTuple):
    """A point of the reference."""

    pose: Pose2  # of the last axle, pointing forwards; the heading counts full turns
    curvature: float  # of the last axle's path, + left [1/m]
    articulation: FloatArray  # (N,) at each hitch [rad]
    tractor_curvature: float  # of the tractor's rear axle [1/m]


@dataclass(frozen=True, slots=True, eq=False)
class ReverseReference:
    """Path of the last axle by station; stations grow forwards and fall in reverse."""

    stations: FloatArray  # (n,) [m]
    path: FloatArray  # (n, 2) [m]
    headings: FloatArray  # (n,) [rad]
    curvatures: FloatArray  # (n,) [1/m]
    articulations: FloatArray  # (n, N) [rad]
    tractor_curvatures: FloatArray  # (n,) [1/m]

    @classmethod
    def of(cls, chain: RollingChain, points: FloatArray) -> ReverseReference:
        """The reference through points (n, 2) [m] of the last axle's path, in the order of forward travel.

        Station 0 is at the first point.

        Raises:
            ValueError: if the points span less than 1 m.
        """
        path, first = _resampled(points)
        headings = _directions(path)
        stations: FloatArray = np.linspace(-first, _SPACING * (len(path) - 1) - first, len(path))
        axle, psi = path, headings
        articulations: list[FloatArray] = []
        for hitch, length in zip(reversed(chain.hitches), reversed(chain.lengths), strict=True):
            hitch_path = axle + length * _along(psi)
            towing = _towing(hitch_path, hitch)
            articulations.insert(0, towing - psi)
            axle, psi = hitch_path - hitch * _along(towing), towing
        tractor_steps = np.hypot(*np.gradient(axle, axis=0).T)
        return cls(
            stations=stations,
            path=path,
            headings=headings,
            curvatures=np.gradient(headings, _SPACING),
            articulations=np.column_stack(articulations),
            tractor_curvatures=np.gradient(psi) / tractor_steps,
        )

    def at(self, station: float) -> ReferencePoint:
        """The reference at a station [m]."""
        k = (station - self.stations[0]) / _SPACING
        i = min(max(int(k), 0), len(self.stations) - 2)
        share = k - i

        def between(values: FloatArray) -> FloatArray:
            interpolated: FloatArray = values[i] + share * (values[i + 1] - values[i])
            return interpolated

        x, y = between(self.path).tolist()
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
    """Smoothed and extended points at equal spacing, and the arc length of the first given one [m]."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    kept = np.concatenate([[True], steps > 1e-6])
    points, s = points[kept], np.concatenate([[0.0], np.cumsum(steps[kept[1:]])])
    if s[-1] < _LEAST:
        raise ValueError(f"points span {s[-1]:.2f} m: reversing needs {_LEAST:g} m at least")
    beyond = np.arange(_SPACING, _EXTENSION, _SPACING)
    before, behind = _extension(points[::-1], s[-1] - s[::-1], beyond)[::-1], _extension(points, s, beyond)
    s = np.concatenate([-beyond[::-1], s, s[-1] + beyond])
    stations = np.arange(s[0], s[-1], _SPACING)
    line = np.column_stack([np.interp(stations, s, column) for column in np.vstack([before, points, behind]).T])
    smooth = gaussian_filter1d(line, _SMOOTHING / _SPACING, axis=0, mode="nearest", truncate=3.0)
    margin = math.ceil(3.0 * _SMOOTHING / _SPACING) + 1  # within reach of the filter's ends
    return smooth[margin:-margin], -s[0] - margin * _SPACING


def _extension(points: FloatArray, s: FloatArray, beyond: FloatArray) -> FloatArray:
    """Points at distances ``beyond`` (m,) [m] after the end of a path, on the arc of its last part."""
    low = max(0.0, s[-1] - _END)
    a, b, c = (np.array([np.interp(at, s, column) for column in points.T]) for at in (low, 0.5 * (low + s[-1]), s[-1]))
    first, second = (math.atan2(*(chord[::-1])) for chord in (b - a, c - b))
    half = 0.5 * (s[-1] - low)
    curvature = math.remainder(second - first, math.tau) / half
    headings = second + curvature * (0.5 * half + beyond - 0.5 * _SPACING)
    extension: FloatArray = c + _SPACING * np.cumsum(_along(headings), axis=0)
    return extension


def _directions(path: FloatArray) -> FloatArray:
    """Direction of a path at each of its points [rad], continuous."""
    tangents = np.gradient(path, axis=0)
    directions: FloatArray = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
    return directions


def _towing(hitch_path: FloatArray, hitch: float) -> FloatArray:
    """Heading [rad] of the unit whose hitch, ``hitch`` [m] ahead of its axle, moves along the points (n, 2).

    Between two points the hitch moves straight, and the tangent of half the heading's angle to that line falls by the
    factor e every ``hitch``. With a hitch behind the axle this is stable only in the opposite direction.
    """
    directions = _directions(hitch_path)
    if abs(hitch) < _NO_LEVER:
        return directions
    decay = np.exp(-np.hypot(*np.diff(hitch_path, axis=0).T) / abs(hitch))
    order = range(1, len(hitch_path)) if hitch > 0.0 else range(len(hitch_path) - 2, -1, -1)
    headings = directions.copy()
    for k in order:
        before, factor = (k - 1, decay[k - 1]) if hitch > 0.0 else (k + 1, decay[k])
        middle = 0.5 * (directions[before] + directions[k])
        headings[k] = middle + 2.0 * math.atan(factor * math.tan(0.5 * (headings[before] - middle)))
    return headings


def _along(psi: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(psi), np.sin(psi)])
