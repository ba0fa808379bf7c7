"""What moves combinations that a policy drives: the plant with slipping tyres, and a shifter for its two gears."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from controllers.driver import PERIOD
from scenarios.environments.domain import Circumstances
from scenarios.environments.variation import Variation
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchGround, BatchMotion, Lanes, PlantBatch
from vehicle.combination.description import Vehicle
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray

_STEP = to_ticks(PERIOD, "control period")
_SHIFTING: Final = 0.1  # slower a gear may be changed; a stopped combination rocks back about as fast [m/s]


class Moved(NamedTuple):
    """Where n combinations are."""

    poses: FloatArray  # (n, N, 3) x [m], y [m], psi [rad]
    speed: FloatArray  # (n,) of the tractor, backwards below 0 [m/s]
    steer: FloatArray  # (n,) of its foremost steered axle [rad]
    load_transfer: FloatArray  # (n, N) [-]


class Slipping:
    """n combinations on slipping tyres, forwards and backwards, whose trailer axles point straight."""

    def __init__(self, vehicle: Vehicle, n: int, engine: Engine) -> None:
        """All like ``vehicle``."""
        self._fleet, self._variation = PlantBatch(vehicle, n, engine), Variation(vehicle)
        self._straight = np.zeros((n, sum(len(unit.steered_axles) for unit in vehicle.units[1:])))
        self._speed = np.zeros(n)

    def place(self, lanes: Lanes, drawn: Circumstances) -> Moved:
        """Puts these at W's origin, standing."""
        nowhere = np.full((len(lanes), 2), np.nan)
        ground = BatchGround(drawn.friction, drawn.cross_fall, nowhere)
        return self._moved(self._fleet.place(lanes, self._variation.numbers(drawn), ground, np.zeros(len(lanes))))

    def step(self, steer: FloatArray, acceleration: FloatArray) -> Moved:
        """A control period under held demands, (n,) [rad] and (n,) [m/s2]; an acceleration below 0 points backwards.

        Against the motion it is the brakes that are asked, and close to standstill the gear is changed.
        """
        way = np.where(np.abs(self._speed) > _SHIFTING, self._speed, acceleration)
        gear = np.where(way < 0.0, -1.0, 1.0)
        return self._moved(self._fleet.step(steer, gear * acceleration, self._straight, _STEP, gear))

    def _moved(self, seen: BatchMotion) -> Moved:
        self._speed = seen.velocities[:, 0, 0]
        return Moved(seen.poses, self._speed, seen.steer[:, 0], seen.load_transfer)
