"""Steering robots and steered trailers of the proving ground."""

from __future__ import annotations

import math

import numpy as np

from controllers.driver import DriverCommand
from controllers.trailer import Combination
from estimators.off_tracking.reference import ReferenceOffTracking
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.sensing import Sensing
from scenarios.assembly.trailer import WatchedTrailer
from scenarios.assembly.trailer_law import trailer_law
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import ExactPose
from sensors.messages import EgoState
from vehicle.clock import TICK, Schedule
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_ESTIMATES = Schedule.at_rate(10.0)  # of the off-tracking: a 10 Hz camera's
_CRUISE_GAIN = 2.0  # acceleration demand per speed error [1/s]
_CRUISE_INTEGRAL = 1.0  # [1/s2]: aperiodic with the gain above


def steered_trailer(vehicle: Vehicle, law: str) -> WatchedTrailer | None:
    """The last unit with a steering law that knows the exact off-tracking; None for ``none``: all axles stay straight.

    Raises:
        ValueError: one line, if the last unit has no steered axle, or there is no such law.
    """
    if law == "none":
        return None
    last = len(vehicle.units) - 1
    if last == 0 or not vehicle.units[last].steered_axles:
        raise ValueError(f"trailer_steering = {law}: the last unit of {vehicle.name} has no steered axle")
    geometry = trailer_geometry(vehicle, last)
    return WatchedTrailer(
        unit=last,
        name=vehicle.units[last].name,
        geometry=geometry,
        path_height=vehicle.units[last].roll_axis_height,
        steers_ahead=sum(len(unit.steered_axles) for unit in vehicle.units[:last]),
        law=trailer_law(law, geometry, Combination(vehicle, last), {}),
        signals=CombinationSensors(vehicle, last, rng=np.random.default_rng(0), noise=0.0),
        sensing=Sensing(
            sensor=ExactPose(last, vehicle.units[last].roll_axis_height),
            schedule=_ESTIMATES,
            period=_ESTIMATES.period,
            estimator=ReferenceOffTracking(geometry.follow_distance),
            cameras=None,
        ),
    )


class SpeedHold:
    """Speed control of the robots: proportional and integral."""

    @staticmethod
    def step(held: float, error: float, duration: float) -> tuple[float, float]:
        """New memory and demanded acceleration [m/s2] for a speed error [m/s], ``duration`` [s] after the last step."""
        held = held + _CRUISE_INTEGRAL * error * duration
        return held, _CRUISE_GAIN * error + held


class SteerProgramme:
    """A steering robot: road-wheel angles over time, open loop, at a speed that is held."""

    def __init__(self, angles: FloatArray, speed: float, period: int) -> None:
        """Steer by ``angles`` (n,) [rad], one every ``period`` [ticks]; the last one stays."""
        self._angles, self._speed, self._period = angles, speed, period

    def init(self) -> float:
        """Acceleration that holds the speed, before the first step [m/s2]."""
        return 0.0

    def step(self, held: float, tick: int, ego: EgoState) -> tuple[float, DriverCommand]:
        """New memory and command at ``tick``."""
        held, acceleration = SpeedHold.step(held, self._speed - ego.v_x, self._period * TICK)
        steer = float(self._angles[min(tick // self._period, len(self._angles) - 1)])
        return held, DriverCommand(steer=steer, acceleration=acceleration)


def half_sine(peak: float, duration: float, start: float, count: int, period: int) -> FloatArray:
    """A pulse of steer: half a sine of height ``peak`` [rad], ``duration`` [s] long from ``start`` [s] on.

    Shape (count,), one value every ``period`` [ticks].
    """
    phase = (np.arange(count) * period * TICK - start) / duration
    pulse: FloatArray = np.where((phase > 0.0) & (phase < 1.0), peak * np.sin(math.pi * phase), 0.0)
    return pulse
