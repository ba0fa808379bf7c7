"""Sensors of a combination: signals for the steering of its trailers, alone and with a stereo camera.

Not modelled: errors of the encoders on steered trailer axles, which are their resolution alone (14 bits, 0.02 deg);
tyres that wear or warm up during a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np

from sensors.faults.fault import Fault, with_faults
from sensors.messages import CombinationSignals, Sensor, Stamped, StereoFrame, TrailerView
from vehicle.clock import TICK, Schedule
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.truth import Truth


class _Error(NamedTuple):
    """Error of a sensor."""

    bias: float  # standard deviation of the part that is constant during a run
    noise: float  # standard deviation of each sample


_SPEED_SCALE: Final = 0.005  # assumed: rolling radius known to 2.5 mm of 0.5 m [-]
_SPEED: Final = _Error(bias=0.0, noise=0.02)  # assumed: 100 teeth of a pole wheel, timed over 20 ms [m/s]
_STEER: Final = _Error(bias=math.radians(0.2), noise=math.radians(0.1))  # assumed: play of the linkage, toe [rad]
_ARTICULATION: Final = _Error(bias=math.radians(0.1), noise=math.radians(0.15))  # assumed: play of the kingpin [rad]
_GYRO: Final = _Error(bias=math.radians(0.1), noise=math.radians(0.1))  # assumed: vehicle MEMS, zeroed standing [rad/s]
_ACCELERATION: Final = _Error(bias=0.05, noise=0.05)  # assumed: vehicle MEMS behind a low-pass [m/s2]


class CombinationSensors:
    """Sensors for the steering of one unit, with errors as in data sheets.

    The accelerometer is fixed to the body and also measures the lateral component of gravity; its output is the mean
    since the previous sample.
    """

    def __init__(self, vehicle: Vehicle, unit: int, *, rng: np.random.Generator, noise: float) -> None:
        """Sensors for the ``unit`` of a vehicle; ``noise`` scales all errors: 1 as in data sheets, 0 none."""
        self._unit, self._rng, self._noise = unit, rng, noise
        front = vehicle.units[0].steered_axles[0]
        number = vehicle.units[0].axles.index(front)
        self._front_x, self._front_wheels = front.x, slice(2 * number, 2 * number + 2)
        self._axles = vehicle.law_axles(unit)
        axles = vehicle.led_unit(unit).axles
        self._group_x = sum(axle.x for axle in axles) / len(axles)
        n = len(vehicle.units)
        errors = [_SPEED, _STEER, *[_ARTICULATION] * (n - 1), *[_GYRO] * n, _ACCELERATION]
        self._random = noise * np.array([error.noise for error in errors])
        self._scale = 1.0 + noise * _SPEED_SCALE * float(rng.standard_normal())
        self._biases = noise * np.array([error.bias for error in errors]) * rng.standard_normal(len(errors))
        self._previous: tuple[int, float] | None = None  # tick, lateral speed above the axle group
        self._last: CombinationSignals | None = None
        self._sensor: Sensor[Truth, CombinationSignals] = _Reading(self)

    def fail(self, faults: Sequence[Fault], rng: Callable[[int], np.random.Generator]) -> None:
        """Give the sensors faults before their first sample; ``rng`` is the random stream of the fault of a number.

        Raises:
            ValueError: one line, if a fault does not apply to such sensors.
        """
        self._sensor = with_faults(self._sensor, faults, camera=None, unit=self._unit, rng=rng)

    def sample(self, truth: Truth) -> CombinationSignals:
        """Signals at this tick; the same object for every caller."""
        if self._last is None or self._last.tick != truth.tick:
            self._last = self._sensor.sample(truth) or self._last
        if self._last is None:
            raise ValueError("faults: the combination's own sensors sent nothing at their first sample")
        return self._last

    def read(self, truth: Truth) -> CombinationSignals:
        """Signals of the sound sensors; every call draws new noise."""
        errors = self._biases + self._random * self._rng.standard_normal(len(self._biases))
        psi, yaw_rates = truth.poses[:, 2], truth.velocities[:, 2]
        n = len(yaw_rates)
        return CombinationSignals(
            tick=truth.tick,
            angles=truth.steer[self._axles].copy(),
            speed=self._scale * self._wheel_speed(truth) + float(errors[0]),
            steer=float(truth.steer[0] + errors[1]),
            articulation=psi[:-1] - psi[1:] + errors[2 : n + 1],
            yaw_rates=yaw_rates + errors[n + 1 : -1],
            lateral_acceleration=self._lateral_acceleration(truth) + float(errors[-1]),
        )

    def _wheel_speed(self, truth: Truth) -> float:
        """Speed of the rear axle from the rotation of the front wheels, which brakes slow [m/s]."""
        steer = float(truth.steer[0])
        if truth.wheel_speeds is not None:
            left, right = truth.wheel_speeds[self._front_wheels].tolist()
            return 0.5 * float(left + right) * math.cos(steer)
        v_x, v_y, yaw_rate = map(float, truth.velocities[0])
        rolling = v_x * math.cos(steer) + (v_y + self._front_x * yaw_rate) * math.sin(steer)
        return rolling * math.cos(steer)

    def _lateral_acceleration(self, truth: Truth) -> float:
        """Lateral specific force on the body above the axle group [m/s2]."""
        v_x, v_y, yaw_rate = map(float, truth.velocities[self._unit])
        lateral_speed = v_y + self._group_x * yaw_rate
        rate = 0.0
        if self._previous is not None:
            rate = (lateral_speed - self._previous[1]) / ((truth.tick - self._previous[0]) * TICK)
        self._previous = truth.tick, lateral_speed
        return rate + v_x * yaw_rate + GRAVITY * float(truth.bodies[self._unit][2, 1])


class _Reading:
    """The sound sensors, below their faults."""

    def __init__(self, sensors: CombinationSensors) -> None:
        self._sensors = sensors

    def sample(self, truth: Truth) -> CombinationSignals:
        """Signals at this tick."""
        return self._sensors.read(truth)


TruthT = TypeVar("TruthT", bound=Stamped)


class TrailerViewSensor(Generic[TruthT]):
    """A stereo camera with the signals that arrive until its frame has been processed.

    Signals are collected at their own rate. A view is sent whenever a frame is due, also if none arrives: faults of the
    camera do not touch the signals.
    """

    def __init__(
        self,
        camera: Sensor[TruthT, StereoFrame],
        frames: Schedule,
        signals: Sensor[TruthT, CombinationSignals],
        readings: Schedule,
    ) -> None:
        """For a ``camera`` on the schedule ``frames``, and ``signals`` on the schedule ``readings``.

        ``schedule`` is that of the sensor: sample it whenever one of the two is due.
        """
        self._camera, self._frames = camera, frames
        self._signals, self._readings = signals, readings
        period = math.gcd(frames.period, frames.offset, readings.period, readings.offset)
        self.schedule = Schedule(period=period, latency=frames.latency)
        self._waiting: tuple[CombinationSignals, ...] = ()

    def sample(self, truth: TruthT) -> TrailerView | None:
        """View at this tick; None if no frame is due."""
        rest = self.begin(truth)
        return None if rest is None else rest()

    def begin(self, truth: TruthT) -> Callable[[], TrailerView] | None:
        """Collect the signals of this tick; the returned function takes the frame, also in another thread.

        None if no frame is due.
        """
        if self._readings.due(truth.tick):
            reading = self._signals.sample(truth)
            self._waiting += () if reading is None else (reading,)
        if not self._frames.due(truth.tick):
            return None
        known = truth.tick + self._frames.latency - self._readings.latency  # newest reading when the frame is processed
        arrived = tuple(reading for reading in self._waiting if reading.tick <= known)
        self._waiting = self._waiting[len(arrived) :]
        return lambda: TrailerView(tick=truth.tick, frame=self._camera.sample(truth), signals=arrived)
