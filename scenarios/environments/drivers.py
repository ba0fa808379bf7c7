"""Many drivers at once: the law of ``controllers.driver.PreviewDriver`` as one compiled function (a test compares)."""

from __future__ import annotations

import math
from typing import Any, Final, Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers import preview_law as law
from controllers.driver import PERIOD
from controllers.functions import ARRAYS
from controllers.tractor import TractorGeometry
from scenarios.environments.tracks import Tracks, Way, on_path
from vehicle.engine.kernels import Engine, kernel_for_rows
from vehicle.frames import FloatArray

V = TypeVar("V")  # an array (n,), or SX


class Drive(NamedTuple, Generic[V]):
    """What a driver carries from step to step, and what he demands."""

    station: V  # of the guided point [m]
    demand: V  # last steer demand [rad]
    steer: V  # where his steering should be by now [rad]
    front_slip: V  # [rad]
    integral: V  # of the speed's error [m/s2]
    beside: V  # distance of the guided point from the path, + left [m]
    acceleration: V  # last demand [m/s2]


class _Given(NamedTuple, Generic[V]):
    """What he sees and feels; poses and velocities as in ``BatchMotion``."""

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
    ahead: V  # the station to look for the guided point around [m]


class Drivers:
    """Drivers of equal tractors, each on a course of his own at a speed of his own."""

    def __init__(self, tractor: TractorGeometry, tracks: Tracks, n: int, engine: Engine) -> None:
        """All at the start of the first course until they ``begin``."""
        self._tracks, self._n = tracks, n
        self._step = kernel_for_rows(_function(tractor), n, engine)
        self._course = np.zeros(n, dtype=np.intp)
        self._u = np.zeros((n, len(_Given._fields) + len(Way._fields)))
        self._given = _Given(*(self._u[:, k] for k in range(len(_Given._fields))))
        self._memory = np.zeros((n, len(Drive._fields)))
        for column in (self._given.speed, self._given.gain, self._given.x_ref):
            column[:] = 1.0

    @property
    def course(self) -> NDArray[np.intp]:
        """Numbers of the courses, (n,)."""
        return self._course

    @property
    def drive(self) -> Drive[FloatArray]:
        """What the drivers carry."""
        return Drive(*self._memory.T)

    def begin(self, lanes: NDArray[np.intp], course: NDArray[np.intp], speed: FloatArray) -> None:
        """These drivers start afresh on these courses at these set speeds [m/s]."""
        given = self._given
        self._course[lanes], given.speed[lanes] = course, speed
        given.gain[lanes] = law.gain_at(ARRAYS, law.GAIN, speed)
        given.x_ref[lanes], given.y_ref[lanes] = self._tracks.references[course].T
        self._memory[lanes] = 0.0

    def step(self, poses: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Steer [rad] and acceleration [m/s2] demanded of tractors (n, 3) that move so, x y psi and v_x v_y yaw rate.

        Every call is a control period after the one before.
        """
        self._u[:, :3], self._u[:, 3:6] = poses, velocities
        # He looks for the point where it will be when the steering has answered, about as far on as it goes meanwhile.
        ahead = self._given.ahead
        np.multiply(velocities[:, 0], PERIOD, out=ahead)
        ahead += self._memory[:, 0]
        self._u[:, len(_Given._fields) :] = self._tracks.ways(self._course, ahead)
        self._memory = self._step(self._memory, self._u)
        return self._memory[:, _DEMAND], self._memory[:, _ACCELERATION]


_DEMAND: Final = Drive._fields.index("demand")
_ACCELERATION: Final = Drive._fields.index("acceleration")


def _function(t: TractorGeometry) -> Any:
    """Function (drive, given and way, nothing) -> drive."""
    memory, inputs = ca.SX.sym("m", len(Drive._fields)), ca.SX.sym("u", len(_Given._fields) + len(Way._fields))
    values = ca.vertsplit(inputs)
    old: Drive[ca.SX] = Drive(*ca.vertsplit(memory))
    given: _Given[ca.SX] = _Given(*values[: len(_Given._fields)])
    now = _stepped(t, old, given, Way(*values[len(_Given._fields) :]))
    return ca.Function("drive", [memory, inputs, ca.SX(0, 1)], [ca.cse(ca.vertcat(*now))])


def _stepped(t: TractorGeometry, old: Drive[ca.SX], on: _Given[ca.SX], way: Way[ca.SX]) -> Drive[ca.SX]:
    """A driver one period later."""
    steer = law.steer_after(ca, t, old.steer, old.demand, PERIOD)
    front_slip = law.filtered_front_slip(ca, t, old.front_slip, steer, on.v_x, on.v_y, on.yaw_rate, PERIOD)
    station, demand, offset = _steering(t, old._replace(steer=steer, front_slip=front_slip), on, way)
    integral, acceleration = law.speed_control(ca, old.integral, on.speed - on.v_x, PERIOD)
    return Drive(station, demand, steer, front_slip, integral, offset, acceleration)


def _steering(t: TractorGeometry, now: Drive[ca.SX], on: _Given[ca.SX], way: Way[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Station [m], steer demand [rad] and distance beside the path [m] of the guided point."""
    x, y, psi = _predicted(t, now, on)
    c, s = ca.cos(psi), ca.sin(psi)
    x, y = x + c * on.x_ref - s * on.y_ref, y + s * on.x_ref + c * on.y_ref
    guess = on_path(way, on.ahead)
    c, s = ca.cos(guess.psi), ca.sin(guess.psi)
    across = c * (y - guess.y) - s * (x - guess.x)
    along = c * (x - guess.x) + s * (y - guess.y)
    station = on.ahead + along / ca.fmax(1.0 - guess.curvature * across, 0.5)
    path = on_path(way, station)
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


def _predicted(t: TractorGeometry, now: Drive[ca.SX], on: _Given[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Pose of the tractor when the steering will have answered this demand."""
    horizon = law.horizon(t)
    yaw_rate = law.mean_yaw_rate(ca, t, now.steer, now.demand, on.v_x, on.yaw_rate)
    middle = on.psi + 0.5 * horizon * yaw_rate
    c, s = ca.cos(middle), ca.sin(middle)
    x, y = on.x + horizon * (c * on.v_x - s * on.v_y), on.y + horizon * (s * on.v_x + c * on.v_y)
    return x, y, on.psi + horizon * yaw_rate
