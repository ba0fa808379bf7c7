"""What moves combinations that a policy drives: the full slip model forwards, and rolling without slip both ways.

The plant's driveline has no reverse gear. At walking pace on firm ground tyres slip by tenths of a degree, so that
wheels that roll where they point are a fair model of reversing; jackknifing is in it, sliding is not.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from controllers.actuator import settle
from controllers.driver import PERIOD
from scenarios.environments.domain import Circumstances
from scenarios.environments.fleet import Fleet, Ground, Lanes
from scenarios.environments.variation import Variation
from vehicle.clock import to_ticks
from vehicle.description import Unit, Vehicle
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray

_STEP = to_ticks(PERIOD, "control period")
_STAGES = 4  # of a step's way, halfway rule each: 5 mm at 1 m/s, beside a wheelbase of metres


class Moved(NamedTuple):
    """Where n combinations are."""

    poses: FloatArray  # (n, N, 3) x [m], y [m], psi [rad]
    speed: FloatArray  # (n,) of the tractor, backwards below 0 [m/s]
    steer: FloatArray  # (n,) of its foremost steered axle [rad]
    load_transfer: FloatArray  # (n, N) [-]


class Mover(Protocol):
    """Moves n combinations whose trailer axles point straight."""

    def place(self, lanes: Lanes, drawn: Circumstances) -> Moved:
        """Puts these at W's origin, standing."""

    def step(self, steer: FloatArray, acceleration: FloatArray) -> Moved:
        """A control period under held demands, (n,) [rad] and (n,) [m/s2]."""


class Slipping:
    """The full slip model; forwards only."""

    def __init__(self, vehicle: Vehicle, n: int, engine: Engine) -> None:
        """All like ``vehicle``."""
        self._fleet, self._variation = Fleet(vehicle, n, engine), Variation(vehicle)
        self._straight = np.zeros((n, sum(len(unit.steered_axles) for unit in vehicle.units[1:])))

    def place(self, lanes: Lanes, drawn: Circumstances) -> Moved:
        """Rolling at a tenth of a metre a second, and so soon at what is asked for."""
        nowhere = np.full((len(lanes), 2), np.nan)
        ground = Ground(drawn.friction, drawn.cross_fall, nowhere)
        self._fleet.place(lanes, self._variation.numbers(drawn), ground, np.full(len(lanes), 0.1))
        return self._moved()

    def step(self, steer: FloatArray, acceleration: FloatArray) -> Moved:
        """A control period."""
        self._fleet.step(steer, acceleration, self._straight, _STEP)
        return self._moved()

    def _moved(self) -> Moved:
        seen = self._fleet.see()
        return Moved(seen.poses, seen.velocities[:, 0, 0], seen.steer[:, 0], seen.load_transfer)


class Rolling:
    """Wheels that roll where they point; both ways."""

    def __init__(self, vehicle: Vehicle, n: int) -> None:
        """All like ``vehicle``; trailers roll about the middle of their axles."""
        tractor = vehicle.units[0]
        self._wheelbase, self._steering = tractor.steered_axles[0].x, tractor.steering
        self._hitches = [unit.rear_hitch[0] for unit in vehicle.units]
        self._lengths = np.array([[-_middle(unit) for unit in vehicle.units[1:]]] * n)
        self._nominal = self._lengths[0].copy()
        self._x, self._y = np.zeros(n), np.zeros(n)
        self._psi = np.zeros((n, len(vehicle.units)))
        self._speed, self._steer = np.zeros(n), np.zeros(n)
        self._level = np.zeros((n, len(vehicle.units)))

    def place(self, lanes: Lanes, drawn: Circumstances) -> Moved:
        """Only the length is of use here."""
        self._lengths[lanes] = self._nominal
        self._lengths[lanes, -1] *= drawn.length
        for part in (self._x, self._y, self._psi, self._speed, self._steer):
            part[lanes] = 0.0
        return self._moved()

    def step(self, steer: FloatArray, acceleration: FloatArray) -> Moved:
        """A control period."""
        before = self._steer
        if self._steering is not None:
            limit, rate = self._steering.limit, self._steering.rate_limit
            demand = np.minimum(np.maximum(steer, -limit), limit)
            self._steer = settle(before, demand, PERIOD, lag=self._steering.lag, max_rate=rate)
        was = self._speed
        self._speed = was + PERIOD * acceleration
        for stage in range(_STAGES):
            share = (stage + 0.5) / _STAGES
            self._roll(before + share * (self._steer - before), (was + share * (self._speed - was)) * PERIOD / _STAGES)
        return self._moved()

    def _roll(self, steer: FloatArray, way: FloatArray) -> None:
        """Goes on by a way [m] of the tractor's rear axle, by the halfway rule."""
        halfway = self._psi + 0.5 * self._turn(self._psi, steer, way)
        self._x = self._x + way * np.cos(halfway[:, 0])
        self._y = self._y + way * np.sin(halfway[:, 0])
        self._psi = self._psi + self._turn(halfway, steer, way)

    def _turn(self, psi: FloatArray, steer: FloatArray, way: FloatArray) -> FloatArray:
        """How far every unit turns (n, N) [rad] at these yaw angles."""
        turned = np.empty_like(psi)
        turned[:, 0] = way * np.tan(steer) / self._wheelbase
        ahead, aside = way, np.zeros_like(way)
        for k in range(1, psi.shape[1]):
            aside = aside + self._hitches[k - 1] * turned[:, k - 1]
            c, s = np.cos(psi[:, k - 1] - psi[:, k]), np.sin(psi[:, k - 1] - psi[:, k])
            ahead, aside = c * ahead - s * aside, s * ahead + c * aside
            turned[:, k] = aside / self._lengths[:, k - 1]
        return turned

    def _moved(self) -> Moved:
        poses = np.empty((len(self._x), self._psi.shape[1], 3))
        x, y = self._x, self._y
        for k, hitch in enumerate(self._hitches):
            poses[:, k] = np.column_stack([x, y, self._psi[:, k]])
            x, y = x + hitch * np.cos(self._psi[:, k]), y + hitch * np.sin(self._psi[:, k])
        return Moved(poses, self._speed.copy(), self._steer.copy(), self._level)


def _middle(unit: Unit) -> float:
    return sum(axle.x for axle in unit.axles) / len(unit.axles)
