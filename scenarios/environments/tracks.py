"""Courses as tables, so that many vehicles look up at once where their paths go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from scenarios.courses import Course
from vehicle.frames import FloatArray

V = TypeVar("V")  # an array (n,), or SX

_SPACING = 0.1  # of the table; a jump of curvature of 0.1/m between two rows costs half a millimetre [m]
_BEYOND = 20.0  # straight before the start and after the end [m]


class OnPath(NamedTuple, Generic[V]):
    """A point of a path."""

    x: V  # [m]
    y: V
    psi: V  # [rad], counts full turns
    curvature: V  # + left [1/m]


class Way(NamedTuple, Generic[V]):
    """A path around a station: a piece whose curvature changes linearly."""

    station: V  # where it begins [m]
    x: V  # [m]
    y: V
    psi: V  # [rad]
    curvature: V  # [1/m]
    change: V  # of it per metre [1/m2]


def on_path(way: Way[ca.SX], station: ca.SX) -> OnPath[ca.SX]:
    """The point at a station [m], which is to be on the piece or little beyond."""
    u = station - way.station
    bend = way.curvature + way.change * u
    halfway = way.psi + 0.5 * u * way.curvature
    turned = 0.5 * u * (way.curvature + bend)
    return OnPath(way.x + u * ca.cos(halfway), way.y + u * ca.sin(halfway), way.psi + turned, bend)


class Tracks:
    """The paths of some courses, row upon row of a table."""

    def __init__(self, courses: Sequence[Course]) -> None:
        """The table of these courses."""
        tables = [_table(course) for course in courses]
        sizes = np.array([len(table) for table in tables])
        self._table = np.concatenate(tables)
        self._first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        self._last = sizes - 1
        self.lengths = np.array([course.length for course in courses])  # [m]
        self.references = np.array([course.reference for course in courses])  # of the guided point in T [m]
        centres = [(np.nan, np.nan) if c.surface_centre is None else c.surface_centre for c in courses]
        self.centres = np.array(centres)  # apex of a conical cross-fall [m]
        self.bends = np.array([float(np.abs(table[:, 4]).max()) for table in tables])  # sharpest curvature [1/m]

    def ways(self, course: NDArray[np.intp], station: FloatArray) -> FloatArray:
        """``Way`` of these courses at these stations [m], both (n,), as rows (n, 6)."""
        # A station that is no number, of a state that broke, is taken as the table's first.
        row = np.fmax(np.fmin((station + _BEYOND) / _SPACING, self._last[course]), 0.0).astype(np.intp)
        found: FloatArray = self._table[self._first[course] + row]
        return found


def _table(course: Course) -> FloatArray:
    """Rows of ``Way``, from before the start to past the end."""
    stations = np.arange(-_BEYOND, course.length + _BEYOND, _SPACING)
    poses = np.array([course.path.pose(float(s)) for s in stations])
    bends = np.array([course.path.curvature(float(s)) for s in stations])
    # A piece turns as its ends say, and its curvature in between is taken to change linearly.
    bends[1:-1] = np.diff(poses[:, 2])[1:] / _SPACING
    change = np.append(2.0 * (np.diff(poses[:, 2]) / _SPACING - bends[:-1]) / _SPACING, 0.0)
    return np.column_stack([stations, poses, bends, change])
