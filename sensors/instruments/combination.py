"""The sensors that a combination steers its trailers by: wheel speeds, angles at axles and hitches, gyros.

Not modelled: the encoders of the steered trailer axles err by their resolution alone, 0.02 deg with 14 bits, and are
exact here; tyres that wear or warm up during a run.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.truth import Truth


class _Error(NamedTuple):
    """What a sensor adds to the truth."""

    bias: float  # standard deviation of what stays the same throughout a run
    noise: float  # of each sample


_SPEED_SCALE: Final = 0.005  # assumed: rolling radius learnt to 2.5 mm of 0.5 m [-]
_SPEED: Final = _Error(bias=0.0, noise=0.02)  # assumed: 100 teeth of a pole wheel, timed over 20 ms [m/s]
_STEER: Final = _Error(bias=math.radians(0.2), noise=math.radians(0.1))  # assumed: play of the linkage, toe [rad]
_ARTICULATION: Final = _Error(bias=math.radians(0.1), noise=math.radians(0.15))  # assumed: play of the kingpin [rad]
_GYRO: Final = _Error(bias=math.radians(0.1), noise=math.radians(0.1))  # assumed: vehicle MEMS, zeroed standing [rad/s]
_ACCELERATION: Final = _Error(bias=0.05, noise=0.05)  # assumed: vehicle MEMS behind a low-pass [m/s2]


class CombinationSensors:
    """The sensors for the steering of one unit, with errors like those of a data sheet.

    The accelerometer is fixed to the body and feels gravity across it, too; what it shows is the mean since the sample
    before.
    """

    def __init__(self, vehicle: Vehicle, unit: int, *, rng: np.random.Generator, noise: float) -> None:
        """Sensors for the ``unit`` of a vehicle; ``noise`` scales all errors, 1 is the data sheet and 0 none."""
        self._unit, self._rng, self._noise = unit, rng, noise
        self._front_x = vehicle.units[0].steered_axles[0].x
        first = sum(len(u.steered_axles) for u in vehicle.units[:unit])
        self._axles = slice(first, first + len(vehicle.units[unit].steered_axles))
        axles = vehicle.units[unit].axles
        self._group_x = sum(axle.x for axle in axles) / len(axles)
        n = len(vehicle.units)
        kinds = [_SPEED, _STEER, *[_ARTICULATION] * (n - 1), *[_GYRO] * n, _ACCELERATION]
        self._random = noise * np.array([kind.noise for kind in kinds])
        self._scale = 1.0 + noise * _SPEED_SCALE * float(rng.standard_normal())
        self._biases = noise * np.array([kind.bias for kind in kinds]) * rng.standard_normal(len(kinds))
        self._before: tuple[int, float] | None = None  # tick of the last sample, lateral speed above the axle group
        self._last: CombinationSignals | None = None

    def sample(self, truth: Truth) -> CombinationSignals:
        """What they say at this tick, to whoever asks."""
        if self._last is None or self._last.tick != truth.tick:
            self._last = self._read(truth)
        return self._last

    def _read(self, truth: Truth) -> CombinationSignals:
        added = self._biases + self._random * self._rng.standard_normal(len(self._biases))
        articulation, yaw_rates = -np.diff(truth.poses[:, 2]), truth.velocities[:, 2]
        n = len(yaw_rates)
        return CombinationSignals(
            tick=truth.tick,
            angles=truth.steer[self._axles].copy(),
            speed=self._scale * self._rolled(truth) + float(added[0]),
            steer=float(truth.steer[0] + added[1]),
            articulation=articulation + added[2 : n + 1],
            yaw_rates=yaw_rates + added[n + 1 : -1],
            lateral_acceleration=self._felt(truth) + float(added[-1]),
        )

    def _rolled(self, truth: Truth) -> float:
        """Speed of the rear axle by the rolling of the steered front one, whose wheels are not driven [m/s]."""
        v_x, v_y, yaw_rate = map(float, truth.velocities[0])
        steer = float(truth.steer[0])
        rolling = v_x * math.cos(steer) + (v_y + self._front_x * yaw_rate) * math.sin(steer)
        return rolling * math.cos(steer)

    def _felt(self, truth: Truth) -> float:
        """Lateral specific force on the body above the axle group [m/s2]."""
        v_x, v_y, yaw_rate = map(float, truth.velocities[self._unit])
        sideways = v_y + self._group_x * yaw_rate
        changed = 0.0
        if self._before is not None:
            changed = (sideways - self._before[1]) / ((truth.tick - self._before[0]) * TICK)
        self._before = truth.tick, sideways
        return changed + v_x * yaw_rate + GRAVITY * float(truth.bodies[self._unit][2, 1])
