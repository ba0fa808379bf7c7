"""Many drivers at once: the law of ``controllers.driver.PreviewDriver`` as one compiled function (a test compares)."""

from __future__ import annotations

import math
from typing import Any, Final, Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers.driver import PERIOD, TractorGeometry
from scenarios.environments.tracks import Tracks, Way, on_path
from vehicle.engine.kernels import Engine, kernel_for_rows
from vehicle.frames import FloatArray

V = TypeVar("V")  # an array (n,), or SX

# The numbers of that law, with its reasons there.
_GAIN, _CROSSOVER = 0.6, 7.0  # [rad/m], [rad/s]
_CREEP, _SLIP_TIME = 0.3, 0.1  # [m/s], [s]
_SPEED_GAIN, _SPEED_INTEGRAL, _MAX_ACCELERATION = 2.0, 1.0, 1.5  # [1/s], [1/s2], [m/s2]
_STEEPEST = 1.2  # [rad]


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
        given.gain[lanes] = np.minimum(_GAIN, _CROSSOVER / speed)
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
    steer = _settled(t, old.steer, old.demand, PERIOD)
    seen = ca.atan2(on.v_y + t.wheelbase * on.yaw_rate, on.v_x) - steer
    blend = ca.if_else(on.v_x < _CREEP, 0.0, 1.0 - math.exp(-PERIOD / _SLIP_TIME))
    front_slip = old.front_slip + blend * (seen - old.front_slip)
    station, demand, beside = _steering(t, old._replace(steer=steer, front_slip=front_slip), on, way)
    wanted = old.integral + _SPEED_INTEGRAL * PERIOD * (on.speed - on.v_x)
    push = _SPEED_GAIN * (on.speed - on.v_x) + wanted
    integral = ca.if_else(ca.fabs(push) <= _MAX_ACCELERATION, wanted, old.integral)
    return Drive(station, demand, steer, front_slip, integral, beside, _within(push, _MAX_ACCELERATION))


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
    chi = turn - math.tau * ca.floor(turn / math.tau + 0.5) + ca.atan(on.gain * to_path)
    tan_chi = ca.tan(_within(chi, _STEEPEST))
    drift = ca.if_else(on.v_x > _CREEP, on.v_y / ca.fmax(on.v_x, _CREEP), 0.0)
    curvature = (tan_chi - drift) / (on.x_ref + on.y_ref * tan_chi)
    demand = ca.atan(drift + t.wheelbase * curvature) - now.front_slip
    return station, _within(demand, t.max_steer), -to_path


def _predicted(t: TractorGeometry, now: Drive[ca.SX], on: _Given[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Pose of the tractor when the steering will have answered this demand."""
    horizon = t.actuator_lag + 0.5 * PERIOD
    halfway = _settled(t, now.steer, now.demand, 0.5 * horizon)
    yaw_rate = on.yaw_rate + on.v_x * (ca.tan(halfway) - ca.tan(now.steer)) / t.wheelbase
    middle = on.psi + 0.5 * horizon * yaw_rate
    c, s = ca.cos(middle), ca.sin(middle)
    x, y = on.x + horizon * (c * on.v_x - s * on.v_y), on.y + horizon * (s * on.v_x + c * on.v_y)
    return x, y, on.psi + horizon * yaw_rate


def _settled(t: TractorGeometry, angle: ca.SX, demand: ca.SX, duration: float) -> ca.SX:
    """As ``controllers.actuator.settle``."""
    gap = demand - angle
    linear = ca.fmin(ca.fmax(ca.fabs(gap) / t.max_steer_rate - t.actuator_lag, 0.0), duration)
    left = ca.fabs(gap) - t.max_steer_rate * linear
    if t.actuator_lag > 0.0:
        left = left * ca.exp((linear - duration) / t.actuator_lag)
    return demand - ca.sign(gap) * left


def _within(value: ca.SX, limit: float) -> ca.SX:
    return ca.fmax(-limit, ca.fmin(limit, value))
