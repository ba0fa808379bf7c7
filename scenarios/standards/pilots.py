"""Who drives on the proving ground: along a path, or by a programme of steer angles, trailers steered or not."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from controllers.driver import DriverCommand, DriverMemory, PreviewDriver
from controllers.trailer import Combination
from estimators.estimates import OffTracking
from estimators.off_tracking.reference import ReferenceOffTracking
from scenarios.assembly.adapters import tractor_geometry, trailer_geometry
from scenarios.assembly.courses import Course
from scenarios.assembly.trailer_law import trailer_law
from scenarios.standards.proving_ground import PERIOD
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import DriverPerception, ExactPose
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

_ESTIMATES = to_ticks(0.1, "period of the estimates")  # a 10 Hz camera's
_CRUISE_GAIN = 2.0  # acceleration demand per speed error [1/s]
_CRUISE_INTEGRAL = 1.0  # [1/s2]: aperiodic with the gain above


class TrailerPilot:
    """The last unit's steering law, fed with the exact off-tracking ten times a second; others stay straight.

    Raises:
        ValueError: if the combination has no such trailer, or there is no such law.
    """

    def __init__(self, vehicle: Vehicle, law: str) -> None:
        """``law`` is a known controller or ``package.module:Name``; ``none`` holds every trailer axle straight."""
        self._count = sum(len(unit.steered_axles) for unit in vehicle.units[1:])
        self._law: Any = None
        if law == "none":
            return
        if not vehicle.units[-1].steered_axles or len(vehicle.units) < 2:
            raise ValueError(f"trailer_steering = {law}: the last unit of {vehicle.name} has no steered axle")
        last = len(vehicle.units) - 1
        trailer = trailer_geometry(vehicle, last)
        self._law = trailer_law(law, trailer, Combination(vehicle, last), {})
        self._source = ReferenceOffTracking(trailer.follow_distance)
        self._sensor = ExactPose(last)
        self._signals = CombinationSensors(vehicle, last, rng=np.random.default_rng(0), noise=0.0)

    def init(self) -> Any:
        """Memory before the first step."""
        return (self._law.init(), self._source.init(), None) if self._law else None

    def step(self, memory: Any, truth: Truth) -> tuple[Any, tuple[float, ...]]:
        """New memory and demands for every steered trailer axle [rad], front to rear."""
        if not self._law:
            return None, (0.0,) * self._count
        law, source, newest = memory
        told: OffTracking | None = None
        if truth.tick % _ESTIMATES == 0:
            source, told = self._source.step(source, self._sensor.sample(truth))
        newest = told or newest
        law, demand = self._law.step(law, truth.tick, newest, self._signals.sample(truth))
        ahead = (0.0,) * (self._count - len(demand.angles))
        return (law, source, newest), (*ahead, *demand.angles.tolist())


class PathPilot:
    """Puts the course's guided point on its path, as the driver of a closed-loop run does."""

    def __init__(self, vehicle: Vehicle, course: Course, speed: float, trailer: TrailerPilot) -> None:
        """For a set ``speed`` [m/s]."""
        self._driver = PreviewDriver(tractor_geometry(vehicle, course), course.path, speed)
        self._trailer = trailer

    def init(self) -> tuple[DriverMemory, Any]:
        """Memory before the first step."""
        return self._driver.init(), self._trailer.init()

    def step(self, memory: tuple[DriverMemory, Any], truth: Truth) -> tuple[tuple[DriverMemory, Any], VehicleCommand]:
        """New memory and the command until the next step."""
        driver, demand = self._driver.step(memory[0], truth.tick, DriverPerception().sample(truth))
        trailer, angles = self._trailer.step(memory[1], truth)
        return (driver, trailer), _command(demand, angles)


class ProgrammeMemory(NamedTuple):
    """What a programme carries from one step to the next."""

    held: float  # acceleration that keeps the speed [m/s2]
    trailer: Any


class SteerProgramme:
    """A steering robot: road-wheel angles over time, whatever comes of them, and the speed held."""

    def __init__(self, angles: FloatArray, speed: float, trailer: TrailerPilot) -> None:
        """``angles`` (n,) [rad], one every ``PERIOD``; the last one stays."""
        self._angles, self._speed, self._trailer = angles, speed, trailer

    def init(self) -> ProgrammeMemory:
        """Memory before the first step."""
        return ProgrammeMemory(0.0, self._trailer.init())

    def step(self, memory: ProgrammeMemory, truth: Truth) -> tuple[ProgrammeMemory, VehicleCommand]:
        """New memory and the command until the next step."""
        error = self._speed - float(truth.velocities[0, 0])
        held = memory.held + _CRUISE_INTEGRAL * error * PERIOD * TICK
        steer = float(self._angles[min(truth.tick // PERIOD, len(self._angles) - 1)])
        trailer, angles = self._trailer.step(memory.trailer, truth)
        demand = DriverCommand(steer=steer, acceleration=_CRUISE_GAIN * error + held)
        return ProgrammeMemory(held, trailer), _command(demand, angles)


def _command(driver: DriverCommand, trailer: tuple[float, ...]) -> VehicleCommand:
    return VehicleCommand(steer=driver.steer, acceleration=driver.acceleration, trailer_steer=trailer)


def half_sine(peak: float, duration: float, start: float, count: int) -> FloatArray:
    """A pulse of steer: half a sine, ``peak`` high [rad], ``duration`` long from ``start`` on [s], shape (count,)."""
    phase = (np.arange(count) * PERIOD * TICK - start) / duration
    pulse: FloatArray = np.where((phase > 0.0) & (phase < 1.0), peak * np.sin(math.pi * phase), 0.0)
    return pulse
