"""Preview drivers of many tractors: `controllers.preview_law` as one compiled function (a test compares)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers import preview_law as law
from controllers.driver import PERIOD
from controllers.functions import ARRAYS
from controllers.tractor import TractorGeometry
from scenarios.environments.tracks import PathPiece, Tracks, point_at
from vehicle.engine.kernels import Engine, kernel_for_rows
from vehicle.frames import FloatArray

V = TypeVar("V")  # an array (n,), or SX
_BOUND = ("_step", "_inputs", "state")  # made anew in a copy


class DriverState(NamedTuple, Generic[V]):
    """State and demands of a driver."""

    station: V  # of the guided point [m]
    demand: V  # last steer demand [rad]
    steer: V  # predicted steer angle now [rad]
    front_slip: V  # [rad]
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
    gain: V  # [rad/m]
    x_ref: V  # guided point in T [m]
    y_ref: V
    near: V  # expected station of the guided point [m]


class Drivers:
    """Drivers of equal tractors, each with its own course and speed."""

    def __init__(self, tractor: TractorGeometry, tracks: Tracks, n: int, engine: Engine) -> None:
        """All at the start of the first course until ``begin``."""
        self._tracks, self._kernel = tracks, (tractor, n, engine)
        self._course = np.zeros(n, dtype=np.intp)
        self._u = np.zeros((n, len(_Inputs._fields) + len(PathPiece._fields)))
        self._memory = np.zeros((n, len(DriverState._fields)))
        self._bind()
        for column in (self._inputs.speed, self._inputs.gain, self._inputs.x_ref):
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
        inputs.gain[lanes] = law.gain_at(ARRAYS, law.GAIN, speed)
        inputs.x_ref[lanes], inputs.y_ref[lanes] = self._tracks.references[course].T
        self._memory[lanes] = 0.0

    def step(self, poses: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Demanded steer [rad] and acceleration [m/s2] of tractors.

        Poses (n, 3) are x, y, psi; velocities (n, 3) are v_x, v_y and yaw rate. Calls are one control period apart.
        """
        self._u[:, :3], self._u[:, 3:6] = poses, velocities
        # The guided point is expected one period of travel further on.
        near = self._inputs.near
        np.multiply(velocities[:, 0], PERIOD, out=near)
        near += self._memory[:, 0]
        self._u[:, len(_Inputs._fields) :] = self._tracks.pieces(self._course, near)
        self._memory = self._step(self._memory, self._u)
        self.state = DriverState(*self._memory.T)
        return self.state.demand, self.state.acceleration


@lru_cache(maxsize=16)
def _function(t: TractorGeometry) -> ca.Function:
    """Function (state, inputs and path piece, nothing) -> state."""
    n, m = len(DriverState._fields), len(_Inputs._fields)
    memory, u = ca.SX.sym("m", n), ca.SX.sym("u", m + len(PathPiece._fields))
    values = ca.vertsplit(u)
    old: DriverState[ca.SX] = DriverState(*ca.vertsplit(memory))
    now = _stepped(t, old, _Inputs(*values[:m]), PathPiece(*values[m:]))
    return ca.Function("drive", [memory, u, ca.SX(0, 1)], [ca.cse(ca.vertcat(*now))])


def _stepped(
    t: TractorGeometry, old: DriverState[ca.SX], on: _Inputs[ca.SX], piece: PathPiece[ca.SX]
) -> DriverState[ca.SX]:
    """State one period later."""
    steer = law.steer_after(ca, t, old.steer, old.demand, PERIOD)
    front_slip = law.filtered_front_slip(ca, t, old.front_slip, steer, on.v_x, on.v_y, on.yaw_rate, PERIOD)
    station, demand, offset = _steering(t, old._replace(steer=steer, front_slip=front_slip), on, piece)
    integral, acceleration = law.speed_control(ca, old.integral, on.speed - on.v_x, PERIOD)
    return DriverState(station, demand, steer, front_slip, integral, offset, acceleration)


def _steering(
    t: TractorGeometry, now: DriverState[ca.SX], on: _Inputs[ca.SX], piece: PathPiece[ca.SX]
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Station [m] of the guided point, steer demand [rad] and lateral offset from the path [m]."""
    x, y, psi = _predicted(t, now, on)
    c, s = ca.cos(psi), ca.sin(psi)
    x, y = x + c * on.x_ref - s * on.y_ref, y + s * on.x_ref + c * on.y_ref
    guess = point_at(piece, on.near)
    c, s = ca.cos(guess.psi), ca.sin(guess.psi)
    across = c * (y - guess.y) - s * (x - guess.x)
    along = c * (x - guess.x) + s * (y - guess.y)
    station = on.near + along / ca.fmax(1.0 - guess.curvature * across, 0.5)
    path = point_at(piece, station)
    to_path = ca.cos(path.psi) * (path.y - y) - ca.sin(path.psi) * (path.x - x)
    turn = path.psi - psi
    demand = law.steer_demand(
        ca,
        t,
        guided_point=(on.x_ref, on.y_ref),
        heading_error=turn - math.tau * ca.floor(turn / math.tau + 0.5),
        to_path=to_path,
        v_x=on.v_x,
        v_y=on.v_y,
        front_slip=now.front_slip,
        gain=on.gain,
    )
    return station, demand, -to_path


def _predicted(t: TractorGeometry, now: DriverState[ca.SX], on: _Inputs[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Pose of the tractor when the steering has answered this demand."""
    horizon = law.horizon(t)
    yaw_rate = law.mean_yaw_rate(ca, t, now.steer, now.demand, on.v_x, on.yaw_rate)
    middle = on.psi + 0.5 * horizon * yaw_rate
    c, s = ca.cos(middle), ca.sin(middle)
    x, y = on.x + horizon * (c * on.v_x - s * on.v_y), on.y + horizon * (s * on.v_x + c * on.v_y)
    return x, y, on.psi + horizon * yaw_rate
