"""Preview drivers of many tractors as one compiled function, and the courses they follow as tables."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers import preview_law as law
from controllers.driver import PERIOD
from controllers.equations import ARRAYS
from controllers.preview_law import EDGES, Gains, gains
from controllers.tractor import STATES, TractorGeometry
from scenarios.courses import Course
from vehicle.engine.kernels import Engine, kernel_for_rows
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
        self._points = self._table[:, 1] + 1j * self._table[:, 2]
        self._directions = np.exp(1j * self._headings)
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

    def offsets(
        self, course: NDArray[np.intp], stations: FloatArray, points: NDArray[np.complex128]
    ) -> tuple[FloatArray, FloatArray]:
        """Stations and lateral offsets, + left, (n, m) [m] of points x + iy near the ``stations`` (n, m) [m]."""
        rows = self._rows(self._first[course, None], self._last[course, None], stations)
        place, bend = (points - self._points[rows]) * self._directions[rows].conj(), self._bends[rows]
        along, across = place.real, place.imag
        along = along / np.fmax(1.0 - bend * across, 0.5)
        return self._stations[rows] + along, across - 0.5 * bend * along * along

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


_BOUND = ("_step", "_inputs", "state")  # made anew in a copy


class DriverState(NamedTuple, Generic[V]):
    """State and demands of a driver."""

    station: V  # of the guided point [m]
    demand: V  # last steer demand [rad]
    steer: V  # predicted steer angle now [rad]
    front_slip: V  # slip angles of the relaxed tyres [rad]
    rear_slip: V
    side: V  # unknown side force over the mass [m/s2]
    turn: V  # its moment over the mass [m2/s2]
    v_x: V  # at the last step [m/s]
    v_y: V
    yaw_rate: V  # [rad/s]
    started: V  # 1 after the first step
    integral: V  # of the speed's error [m/s2]
    offset: V  # lateral distance of the guided point from the path, + left [m]
    acceleration: V  # last demand [m/s2]


class _Inputs(NamedTuple, Generic[V]):
    """Inputs of a driver; poses and velocities as in ``BatchMotion``."""

    x: V
    y: V
    psi: V
    v_x: V
    v_y: V
    yaw_rate: V
    speed: V  # set [m/s]
    x_ref: V  # guided point in T [m]
    y_ref: V
    near: V  # expected station of the guided point [m]


_TIMES = np.array(EDGES[1:])  # of the stretches' ends [s]
_STRETCHES = len(_TIMES)
_BESIDES = STATES + 2 * _STRETCHES  # inputs besides those of `_Inputs` and the path piece: gains, headings ahead


class Drivers:
    """Drivers of equal tractors, each with its own course and speed."""

    def __init__(self, tractor: TractorGeometry, tracks: Tracks, n: int, engine: Engine) -> None:
        """All at the start of the first course until ``begin``."""
        self._tracks, self._kernel = tracks, (tractor, n, engine)
        self._course = np.zeros(n, dtype=np.intp)
        tables = [gains(replace(tractor, x_ref=x, y_ref=y), law.GAIN).table for x, y in tracks.references.tolist()]
        self._gains = Gains(np.stack(tables))
        self._u = np.zeros((n, len(_Inputs._fields) + len(PathPiece._fields) + _BESIDES))
        self._memory = np.zeros((n, len(DriverState._fields)))
        self._bind()
        for column in (self._inputs.speed, self._inputs.x_ref):
            column[:] = 1.0

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in _BOUND}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._bind()

    def _bind(self) -> None:
        """Open the kernel and the views of inputs and memory."""
        tractor, n, engine = self._kernel
        self._step = kernel_for_rows(_function(tractor), n, engine)
        self._inputs = _Inputs(*(self._u[:, k] for k in range(len(_Inputs._fields))))
        self.state = DriverState(*self._memory.T)  # state and demands of all drivers, (n,) each

    @property
    def course(self) -> NDArray[np.intp]:
        """Indices of the courses, (n,)."""
        return self._course

    def begin(self, lanes: NDArray[np.intp], course: NDArray[np.intp], speed: FloatArray) -> None:
        """Start these drivers on courses at set speeds [m/s]."""
        inputs = self._inputs
        self._course[lanes], inputs.speed[lanes] = course, speed
        inputs.x_ref[lanes], inputs.y_ref[lanes] = self._tracks.references[course].T
        self._memory[lanes] = 0.0

    def step(self, poses: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Demanded steer [rad] and acceleration [m/s2] of tractors.

        Poses (n, 3) are x, y, psi; velocities (n, 3) are v_x, v_y and yaw rate. Calls are one control period apart.
        """
        self._u[:, :3], self._u[:, 3:6] = poses, velocities
        # The guided point is expected one period of travel further on; a driver who begins is at the start.
        near, memory = self._inputs.near, self.state
        travel = law.travel(ARRAYS, (self._inputs.x_ref, self._inputs.y_ref), law.Motion(*velocities.T))
        np.multiply(travel, PERIOD * memory.started, out=near)
        near += memory.station
        first, second = len(_Inputs._fields), len(_Inputs._fields) + len(PathPiece._fields)
        self._u[:, first:second] = self._tracks.pieces(self._course, near)
        self._u[:, second:-_STRETCHES] = self._gains.at(velocities[:, 0], self._course)
        ahead = near[:, None] + travel[:, None] * _TIMES
        self._u[:, -_STRETCHES:] = self._tracks.headings(self._course, ahead)
        self._memory = self._step(self._memory, self._u)
        self.state = DriverState(*self._memory.T)
        return self.state.demand, self.state.acceleration


@lru_cache(maxsize=16)
def _function(t: TractorGeometry) -> ca.Function:
    """Function (state, inputs, path piece, gains and headings ahead, nothing) -> state."""
    n, m = len(DriverState._fields), len(_Inputs._fields)
    memory, u = ca.SX.sym("m", n), ca.SX.sym("u", m + len(PathPiece._fields) + _BESIDES)
    values = ca.vertsplit(u)
    old: DriverState[ca.SX] = DriverState(*ca.vertsplit(memory))
    piece, besides = values[m : m + len(PathPiece._fields)], values[m + len(PathPiece._fields) :]
    split = STATES + _STRETCHES
    now = _stepped(t, old, _Inputs(*values[:m]), PathPiece(*piece), besides[:split], besides[split:])
    return ca.Function("drive", [memory, u, ca.SX(0, 1)], [ca.cse(ca.vertcat(*now))])


def _stepped(
    t: TractorGeometry,
    old: DriverState[ca.SX],
    on: _Inputs[ca.SX],
    piece: PathPiece[ca.SX],
    rows: Sequence[ca.SX],
    headings: Sequence[ca.SX],
) -> DriverState[ca.SX]:
    """State one period later; the first step of a drive only looks."""
    steer = law.steer_after(ca, t, old.steer, old.demand, PERIOD)
    motion = law.Motion(on.v_x, on.v_y, on.yaw_rate)
    before = law.Slips(old.front_slip, old.rear_slip, old.side, old.turn)
    after = law.slips_after(ca, t, before, law.Motion(old.v_x, old.v_y, old.yaw_rate), motion, steer, PERIOD)
    slips = law.Slips(*(old.started * slip for slip in after))
    station, place = _place(on, piece, headings)
    demand = law.steer_demand(ca, t, (on.x_ref, on.y_ref), place, motion, slips, steer, rows, ca.SX(law.GAIN))
    integral, acceleration = law.speed_control(ca, old.integral, on.speed - on.v_x, PERIOD)
    return DriverState(station, demand, steer, *slips, *motion, ca.SX(1.0), integral, -place.to_path, acceleration)


def _place(on: _Inputs[ca.SX], piece: PathPiece[ca.SX], headings: Sequence[ca.SX]) -> tuple[ca.SX, law.OnPath[ca.SX]]:
    """Station [m] of the guided point, and its place on the path."""
    c, s = ca.cos(on.psi), ca.sin(on.psi)
    x, y = on.x + c * on.x_ref - s * on.y_ref, on.y + s * on.x_ref + c * on.y_ref
    guess = point_at(piece, on.near)
    c, s = ca.cos(guess.psi), ca.sin(guess.psi)
    across = c * (y - guess.y) - s * (x - guess.x)
    along = c * (x - guess.x) + s * (y - guess.y)
    station = on.near + along / ca.fmax(1.0 - guess.curvature * across, 0.5)
    path = point_at(piece, station)
    turn = path.psi - on.psi
    return station, law.OnPath(
        to_path=ca.cos(path.psi) * (path.y - y) - ca.sin(path.psi) * (path.x - x),
        heading_error=turn - math.tau * ca.floor(turn / math.tau + 0.5),
        curvature=path.curvature,
        headings=[heading - path.psi for heading in headings],
    )
