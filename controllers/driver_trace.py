"""A driver who repeats a recording: steer angle and speed, or acceleration, over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.driver import Driver, DriverCommand
from controllers.preview_law import SPEED_GAIN, SPEED_INTEGRAL
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriverTrace:
    """A recorded drive, linear between its samples and constant after the last one.

    Raises:
        ValueError: if the times do not increase from 0 s on, or lengths differ.
    """

    time: FloatArray  # (n,) [s]
    steer: FloatArray  # (n,) road-wheel angle, + left [rad]
    speed: FloatArray | None = None  # (n,) [m/s]; None: the acceleration is used
    acceleration: FloatArray | None = None  # (n,) [m/s2]; with a speed: feedforward

    def __post_init__(self) -> None:
        if len(self.time) < 2 or self.time[0] != 0.0 or not np.all(np.diff(self.time) > 0.0):
            raise ValueError("time must have two samples or more, start at 0 s and increase")
        if self.speed is None and self.acceleration is None:
            raise ValueError("a trace needs a speed or an acceleration")
        for values in (self.steer, self.speed, self.acceleration):
            if values is not None and len(values) != len(self.time):
                raise ValueError(f"{len(values)} values for {len(self.time)} times")

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])


class TraceMemory(NamedTuple):
    """State of the driver between two steps."""

    tick: int | None  # of the last step; None before the first
    integral: float  # of the speed control [m/s2]


class TraceDriver(Driver[TraceMemory]):
    """Steers open loop; a recorded speed is kept by feedback."""

    def __init__(self, trace: DriverTrace) -> None:
        self._trace = trace

    @property
    def duration(self) -> float:
        """Duration of the recorded drive [s]."""
        return self._trace.duration

    @property
    def start_speed(self) -> float | None:
        """Speed at the start [m/s]; None if the recording has no speed."""
        return None if self._trace.speed is None else float(self._trace.speed[0])

    def init(self) -> TraceMemory:
        """Memory before the first step."""
        return TraceMemory(None, 0.0)

    def step(self, memory: TraceMemory, tick: int, ego: EgoState) -> tuple[TraceMemory, DriverCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        trace, now = self._trace, tick * TICK
        steer = float(np.interp(now, trace.time, trace.steer))
        acceleration = self._recorded_acceleration(now)
        integral = memory.integral
        if trace.speed is not None:
            error = float(np.interp(now, trace.time, trace.speed)) - ego.v_x
            integral += SPEED_INTEGRAL * error * elapsed
            acceleration += SPEED_GAIN * error + integral
        return TraceMemory(tick, integral), DriverCommand(steer=steer, acceleration=acceleration)

    def _recorded_acceleration(self, now: float) -> float:
        """Acceleration as recorded, or the slope of the recorded speed [m/s2]; zero after the end."""
        time, speed, acceleration = self._trace.time, self._trace.speed, self._trace.acceleration
        if acceleration is not None:
            return float(np.interp(now, time, acceleration, right=0.0))
        k = int(np.searchsorted(time, now, side="right"))
        if speed is None or k >= len(time):
            return 0.0
        return float((speed[k] - speed[k - 1]) / (time[k] - time[k - 1]))
