"""The room a combination takes along a path: how far its bodies reach to either side, and its corners swing out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from controllers.path import Path
from scenarios.results.swept_path import UnitOutline, placed
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_SPACING = 0.1  # of the stations along the path [m]
_EDGE = 0.2  # between points along a body's edge [m]: inside a 12.5 m arc they hide 0.4 mm of it
_BEYOND = 40.0  # of straight before and behind the path [m]: longer than any combination


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """How far bodies reach to the left and to the right of a path, at stations along it; NaN where none came."""

    left: FloatArray  # (m,) [m], + left
    right: FloatArray  # (m,) [m], + left too

    @property
    def width(self) -> float:
        """Largest width, square to the path [m]."""
        return float(np.nanmax(self.left - self.right))

    def outside(self, path: Path) -> FloatArray:
        """How far they reach to the outside of the path's turn, (m,) [m]."""
        return -self.right if turns_left(path) else self.left


def turns_left(path: Path) -> bool:
    """Whether the path leads to the left in all."""
    return path.knots[-1].psi >= path.start.psi


def reach(outlines: Sequence[UnitOutline], poses: Sequence[FloatArray], path: Path) -> Reach:
    """What all bodies sweep; ``poses`` (n, 3) of each unit over time."""
    swept = [placed(_edge(outline), _thinned(pose)) for outline, pose in zip(outlines, poses, strict=True)]
    return _reach(np.concatenate([points.reshape(-1, 2) for points in swept]), path)


def front_reach(outline: UnitOutline, poses: FloatArray, path: Path) -> FloatArray:
    """How far the outer front corner of one unit reaches outside at each station, (m,) [m]; NaN where it was not."""
    side = -1.0 if turns_left(path) else 1.0
    corner = placed(np.array([[outline.front_x, side * 0.5 * outline.width]]), poses)[:, 0]
    return _reach(corner, path).outside(path)


def _edge(outline: UnitOutline) -> FloatArray:
    """Points round a body, shape (m, 2) in its frame."""
    ends = zip(outline.corners, np.roll(outline.corners, -1, axis=0), strict=True)
    sides = [np.linspace(a, b, math.ceil(np.hypot(*(b - a)) / _EDGE), endpoint=False) for a, b in ends]
    return np.concatenate(sides)


def _thinned(poses: FloatArray) -> FloatArray:
    """Poses about a station's spacing apart."""
    along = arc_length(poses[:, :2])
    rows = np.searchsorted(along, np.arange(0.0, along[-1], _SPACING))
    thinned: FloatArray = poses[np.unique(np.append(rows, len(poses) - 1))]
    return thinned


def _reach(points: FloatArray, path: Path) -> Reach:
    """Extremes of where points (k, 2) lie beside the path, station by station."""
    stations = np.arange(-_BEYOND, path.length + _BEYOND, _SPACING)
    x, y, psi = np.array([path.pose(float(s)) for s in stations]).T
    _, nearest = KDTree(np.column_stack([x, y])).query(points)
    lateral = (points[:, 1] - y[nearest]) * np.cos(psi[nearest]) - (points[:, 0] - x[nearest]) * np.sin(psi[nearest])
    left, right = np.full(len(stations), -math.inf), np.full(len(stations), math.inf)
    np.maximum.at(left, nearest, lateral)
    np.minimum.at(right, nearest, lateral)
    return Reach(np.where(np.isfinite(left), left, math.nan), np.where(np.isfinite(right), right, math.nan))
