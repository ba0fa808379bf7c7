"""Slip angles from external instruments: exact ones, or a laser tracker with the compass.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final, NamedTuple, Self

import numpy as np

from estimators.context import RoverContext
from estimators.estimates import Health, SlipAngle
from sensors.messages import LaserFix, SlipReading
from vehicle.clock import TICK
from vehicle.frames import wrap

_SPAN: Final = 4.0  # of fixes and headings for a direction of travel: 0.3 m of travel [s]
_LEAST_DISTANCE: Final = 0.05  # a shorter one shows the tracker's noise, not a direction [m]


class ReferenceSlip:
    """Slip angle that an exact instrument reads."""

    sensor: ClassVar[str] = "slip_reading"

    @classmethod
    def of(cls, context: RoverContext) -> Self:
        """Estimator that needs nothing of the context."""
        return cls()

    def init(self) -> None:
        """Empty memory."""
        return

    def step(self, memory: None, reading: SlipReading) -> tuple[None, SlipAngle]:
        """The reading as an estimate without error."""
        return None, SlipAngle(
            tick=reading.tick,
            value=reading.slip_angle,
            std=0.0,
            health=Health.OK,
            wheel_slip=reading.wheel_slip,
            trace_offset=0.0,
            confidence=1.0,
        )


class LaserSample(NamedTuple):
    """Laser fix with the heading at the same tick."""

    time: float  # [s]
    x: float  # [m]
    y: float  # [m]
    heading: float  # [rad]


class LaserSlip:
    """Reina 2008's ground truth: direction of travel by the tracker minus heading by the compass (eqs 5 and 6).

    Both are means over the last seconds, so the result is delayed by half of them.
    """

    def init(self) -> tuple[LaserSample, ...]:
        """Memory before the first fix."""
        return ()

    def step(
        self, memory: tuple[LaserSample, ...], fix: LaserFix, heading: float
    ) -> tuple[tuple[LaserSample, ...], float | None]:
        """Memory with the fix in it, and the slip angle [rad] at its middle; None while the distance is too short."""
        now = LaserSample(fix.tick * TICK, float(fix.p_WR[0]), float(fix.p_WR[1]), heading)
        memory = (*(sample for sample in memory if sample.time > now.time - _SPAN), now)
        time, x, y, psi = np.array(memory).T
        if len(memory) < 3 or math.hypot(x[-1] - x[0], y[-1] - y[0]) < _LEAST_DISTANCE:
            return memory, None
        x_rate, y_rate = (float(np.polyfit(time - time.mean(), at, 1)[0]) for at in (x, y))
        mean_heading = math.atan2(float(np.sin(psi).mean()), float(np.cos(psi).mean()))
        return memory, wrap(math.atan2(y_rate, x_rate) - mean_heading)

    def delay(self) -> float:
        """Delay of its slip angle [s]."""
        return 0.5 * _SPAN
