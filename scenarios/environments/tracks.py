"""Courses as tables, for many vehicles to look up their paths at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from scenarios.courses import Course
from vehicle.frames import FloatArray

V = TypeVar("V")  # an array (n,), or SX

_SPACING = 0.1  # of the table; a curvature jump of 0.1/m between two rows costs 0.5 mm [m]
_BEYOND = 20.0  # straight before the start and after the end [m]


class PathPoint(NamedTuple, Generic[V]):
    """Point of a path."""

    x: V  # [m]
    y: V
    psi: V  # [rad], counts full turns
    curvature: V  # + left [1/m]


class PathPiece(NamedTuple, Generic[V]):
    """Piece of a path around a station, whose curvature changes linearly."""

    station: V  # of its start [m]
    x: V  # [m]
    y: V
    psi: V  # [rad]
    curvature: V  # [1/m]
    change: V  # of the curvature per metre [1/m2]


def point_at(piece: PathPiece[ca.SX], station: ca.SX) -> PathPoint[ca.SX]:
    """Point at a station [m] on the piece or slightly beyond."""
    u = station - piece.station
    bend = piece.curvature + piece.change * u
    halfway = piece.psi + 0.5 * u * piece.curvature
    turned = 0.5 * u * (piece.curvature + bend)
    return PathPoint(piece.x + u * ca.cos(halfway), piece.y + u * ca.sin(halfway), piece.psi + turned, bend)


class Tracks:
    """Paths of several courses in one table."""

    def __init__(self, courses: Sequence[Course]) -> None:
        """Build the table."""
        tables = [_table(course) for course in courses]
        sizes = np.array([len(table) for table in tables])
        self._table = np.concatenate(tables)
        self._first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        self._last = sizes - 1
        self.lengths = np.array([course.length for course in courses])  # [m]
        self.references = np.array([course.reference for course in courses])  # of the guided point in T [m]
        centres = [(np.nan, np.nan) if c.surface_centre is None else c.surface_centre for c in courses]
        self.centres = np.array(centres)  # apex of a conical cross-fall [m]
        self._stations, self._headings = self._table[:, 0].copy(), self._table[:, 3].copy()
        self._bends = self._table[:, 4] + 0.5 * _SPACING * self._table[:, 5]  # mean curvature of a piece [1/m]
        self.bends = np.array([float(np.abs(table[:, 4]).max()) for table in tables])  # sharpest curvature [1/m]

    def pieces(self, course: NDArray[np.intp], station: FloatArray) -> FloatArray:
        """``PathPiece`` of these courses at these stations [m], both (n,), as rows (n, 6)."""
        pieces: FloatArray = self._table[self._rows(self._first[course], self._last[course], station)]
        return pieces

    def headings(self, course: NDArray[np.intp], stations: FloatArray) -> FloatArray:
        """Headings [rad] of the courses (n,) at stations (n, m) [m], straight beyond their tables."""
        rows = self._rows(self._first[course, None], self._last[course, None], stations)
        u = np.fmin(stations - self._stations[rows], _SPACING)
        headings: FloatArray = self._headings[rows] + u * self._bends[rows]
        return headings

    @staticmethod
    def _rows(first: NDArray[np.intp], last: NDArray[np.intp], station: FloatArray) -> NDArray[np.intp]:
        # A NaN station, of a diverged state, selects the first row.
        rows: NDArray[np.intp] = first + np.fmax(np.fmin((station + _BEYOND) / _SPACING, last), 0.0).astype(np.intp)
        return rows


def _table(course: Course) -> FloatArray:
    """Rows of ``PathPiece``, from before the start to past the end."""
    stations = np.arange(-_BEYOND, course.length + _BEYOND, _SPACING)
    poses = np.array([course.path.pose(float(s)) for s in stations])
    bends = np.array([course.path.curvature(float(s)) for s in stations])
    # A piece turns by the difference of its ends' headings; its curvature changes linearly.
    bends[1:-1] = np.diff(poses[:, 2])[1:] / _SPACING
    change = np.append(2.0 * (np.diff(poses[:, 2]) / _SPACING - bends[:-1]) / _SPACING, 0.0)
    return np.column_stack([stations, poses, bends, change])
