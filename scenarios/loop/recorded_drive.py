"""Comparison of a run with the recorded drive that it repeats; the vehicle may not be able to do what was recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from controllers.driver_trace import DriverTrace
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

# Lags of driveline, brakes and steering end within a second or two. A miss that lasts longer leads elsewhere: 20 % of
# 80 km/h are 22 m after 5 s, more than a vehicle's length.
HELD: Final = 5.0  # time that a quantity is missed before the run ends [s]
HELD_AT_END: Final = 1.0  # the same, at the end of the recording [s]
SHARE: Final = 0.2  # of the recorded speed or steer angle that may be missed all the time [-]
SPEED: Final = 1.0  # added to it: noise of a recorded speed at walking pace [m/s]
STEER: Final = math.radians(2.0)  # added to it: play and offset of a recorded steering [rad]

# A recorded acceleration is applied open loop. Gravity on a 10 % slope, or rolling resistance, may change it.
ACCELERATION: Final = 1.5  # mean difference over HELD [m/s2]
_AT_REST: Final = 0.1  # brakes do not move a vehicle backwards [m/s]


class RecordedDrive:
    """Finds out whether a vehicle does what a recording asks for."""

    def __init__(self, trace: DriverTrace) -> None:
        self._trace = trace
        self._since: dict[str, int] = {}  # tick since which a quantity has been missed
        self._before: tuple[int, float] | None = None  # tick and speed [m/s] of the step before
        self._lag = 0.0  # recorded less driven change of speed, forgotten with the time constant HELD [m/s]

    def outcome(self, truth: Truth, *, ends: bool) -> str | None:
        """The quantity that is missed for too long, in words; None if the vehicle does as recorded."""
        self._since = {name: self._since.get(name, truth.tick) for name in self._missed(truth)}
        held = HELD_AT_END if ends else HELD
        late = [name for name, since in self._since.items() if (truth.tick - since) * TICK >= held]
        return f"did not reach the recorded {late[0]}" if late else None

    def _missed(self, truth: Truth) -> Iterator[str]:
        trace, now, v_x = self._trace, truth.tick * TICK, float(truth.velocities[0, 0])
        steer = float(np.interp(now, trace.time, trace.steer))
        if not abs(truth.steer[0] - steer) <= STEER + SHARE * abs(steer):
            yield "steer angle"
        if trace.speed is not None:
            speed = float(np.interp(now, trace.time, trace.speed))
            if not abs(v_x - speed) <= SPEED + SHARE * abs(speed):
                yield "speed"
        elif trace.acceleration is not None and not self._keeps_up(trace.acceleration, truth.tick, v_x):
            yield "acceleration"

    def _keeps_up(self, recorded: FloatArray, tick: int, v_x: float) -> bool:
        before, v_before = self._before or (tick, v_x)
        self._before = tick, v_x
        span = (tick - before) * TICK
        acceleration = float(np.interp(tick * TICK, self._trace.time, recorded))
        asked = max(acceleration, 0.0) if abs(v_x) < _AT_REST else acceleration
        self._lag += asked * span - (v_x - v_before) - self._lag * span / HELD
        return abs(self._lag) <= ACCELERATION * HELD
