"""Combinations that a policy drives: the plant with slipping tyres, forwards and backwards."""

from __future__ import annotations

from typing import Final

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
_MAX_SHIFT_SPEED: Final = 0.1  # gear changes below; a stopped combination rocks back at about this speed [m/s]


class SlippingTyreFleet:
    """n combinations on slipping tyres, forwards and backwards, with unsteered trailer axles."""

    def __init__(self, vehicle: Vehicle, n: int, engine: Engine) -> None:
        """All equal to ``vehicle``."""
        self._fleet, self._variation = PlantBatch(vehicle, n, engine), Variation(vehicle)
        self._straight = np.zeros((n, sum(len(unit.steered_axles) for unit in vehicle.units[1:])))
        self._speed = np.zeros(n)

    def place(self, lanes: Lanes, drawn: Circumstances) -> BatchMotion:
        """Place these at W's origin, at standstill."""
        nowhere = np.full((len(lanes), 2), np.nan)
        ground = BatchGround(drawn.friction, drawn.cross_fall, nowhere)
        return self._noted(self._fleet.place(lanes, self._variation.numbers(drawn), ground, np.zeros(len(lanes))))

    def step(self, steer: FloatArray, acceleration: FloatArray) -> BatchMotion:
        """Advance by a control period under constant demands, (n,) [rad] and (n,) [m/s2], + forwards.

        An acceleration against the motion brakes; near standstill the gear changes.
        """
        direction = np.where(np.abs(self._speed) > _MAX_SHIFT_SPEED, self._speed, acceleration)
        gear = np.where(direction < 0.0, -1.0, 1.0)
        return self._noted(self._fleet.step(steer, gear * acceleration, self._straight, _STEP, gear))

    def _noted(self, motion: BatchMotion) -> BatchMotion:
        self._speed = motion.velocities[:, 0, 0]
        return motion
