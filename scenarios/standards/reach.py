"""Reach of moving bodies to either side of a path, at stations along it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from controllers.path import Path
from scenarios.results.swept_path import UnitOutline, placed
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_SPACING: Final = 0.1  # of the stations along the path [m]
_EDGE: Final = 0.2  # between points along a body's edge [m]: an error of 0.4 mm inside a 12.5 m arc
_BEYOND: Final = 40.0  # straight before and after the path [m]: longer than any combination


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Reach of bodies to the left and right of a path, at stations along it; NaN at stations without a body."""

    left: FloatArray  # (m,) [m], + left
    right: FloatArray  # (m,) [m], + left too

    @property
    def width(self) -> float:
        """Largest width, square to the path [m]."""
        return float(np.nanmax(self.left - self.right))

    def outside(self, path: Path) -> FloatArray:
        """Reach to the outside of the path's turn, (m,) [m]."""
        return -self.right if _turns_left(path) else self.left


def _turns_left(path: Path) -> bool:
    """True if the path turns left in total."""
    return path.knots[-1].psi >= path.start.psi


def reach(outlines: Sequence[UnitOutline], poses: Sequence[FloatArray], path: Path) -> Reach:
    """Reach of all bodies; ``poses`` (n, 3) of each unit over time."""
    swept = [placed(_edge(outline), _thinned(pose)) for outline, pose in zip(outlines, poses, strict=True)]
    return _reach_of(np.concatenate([points.reshape(-1, 2) for points in swept]), path)


def front_reach(outline: UnitOutline, poses: FloatArray, path: Path) -> FloatArray:
    """Reach of a unit's outer front corner to the outside, (m,) [m]; NaN at stations that it does not pass."""
    side = -1.0 if _turns_left(path) else 1.0
    corner = placed(np.array([[outline.front_x, side * 0.5 * outline.width]]), poses)[:, 0]
    return _reach_of(corner, path).outside(path)


def _edge(outline: UnitOutline) -> FloatArray:
    """Points around a body, shape (m, 2) in its frame."""
    ends = zip(outline.corners, np.roll(outline.corners, -1, axis=0), strict=True)
    sides = [np.linspace(a, b, math.ceil(np.hypot(*(b - a)) / _EDGE), endpoint=False) for a, b in ends]
    return np.concatenate(sides)


def _thinned(poses: FloatArray) -> FloatArray:
    """Poses at about the spacing of stations."""
    along = arc_length(poses[:, :2])
    rows = np.searchsorted(along, np.arange(0.0, along[-1], _SPACING))
    thinned: FloatArray = poses[np.unique(np.append(rows, len(poses) - 1))]
    return thinned


def _reach_of(points: FloatArray, path: Path) -> Reach:
    """Largest and smallest lateral offsets of points (k, 2) from the path at each station."""
    stations = np.arange(-_BEYOND, path.length + _BEYOND, _SPACING)
    x, y, psi = np.array([path.pose(float(s)) for s in stations]).T
    _, nearest = KDTree(np.column_stack([x, y])).query(points)
    lateral = (points[:, 1] - y[nearest]) * np.cos(psi[nearest]) - (points[:, 0] - x[nearest]) * np.sin(psi[nearest])
    left, right = np.full(len(stations), -math.inf), np.full(len(stations), math.inf)
    np.maximum.at(left, nearest, lateral)
    np.minimum.at(right, nearest, lateral)
    return Reach(np.where(np.isfinite(left), left, math.nan), np.where(np.isfinite(right), right, math.nan))
