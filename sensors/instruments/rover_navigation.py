"""Instruments of a rover: encoders and a fluxgate compass on board, a laser tracker on the ground.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. It names these instruments without data; the errors here are assumed, as in
data sheets of such instruments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from sensors.messages import LaserFix, RoverReadings, SlipReading
from vehicle.frames import wrap
from vehicle.rover.truth import RoverTruth

# Error of a calibrated fluxgate compass: 0.5 deg RMS (assumed, common in data sheets). It is noise plus the residual of
# the calibration for the rover's iron, which has one and two periods per turn of the heading.
COMPASS_NOISE: Final = math.radians(0.35)  # of one reading [rad]
_DEVIATION: Final = np.radians([0.2, 0.15])  # standard deviations of the parts with one and two periods per turn [rad]
_WHEEL_STEP: Final = 2.0 * math.pi / 100_000  # assumed: 100 000 encoder counts per turn of the wheel [rad]
_SPEED_SPAN: Final = 0.05  # time over which counts are summed for a speed [s]
_STEER_NOISE: Final = math.radians(0.05)  # of a steer encoder, assumed [rad]
_LASER_NOISE: Final = 0.003  # of each coordinate; assumed: a tracking total station [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverInstruments:
    """Encoders of wheels and steering, and the compass; ``scale`` multiplies all errors."""

    rng: np.random.Generator
    scale: float = 1.0
    deviation: tuple[tuple[float, float], ...] = field(init=False)  # amplitude and phase of each part [rad]

    def __post_init__(self) -> None:
        amplitudes = self.scale * _DEVIATION * np.abs(self.rng.normal(size=2))
        phases = self.rng.uniform(-math.pi, math.pi, 2)
        object.__setattr__(self, "deviation", tuple(zip(amplitudes.tolist(), phases.tolist(), strict=True)))

    def sample(self, truth: RoverTruth) -> RoverReadings:
        """Readings of all instruments at this tick."""
        n = len(truth.steer)
        noise = self.scale * self.rng.normal(size=1 + 2 * n)
        psi = float(truth.pose[2])
        deviation = sum(size * math.sin((k + 1) * psi + phase) for k, (size, phase) in enumerate(self.deviation))
        quantisation = _WHEEL_STEP / _SPEED_SPAN / math.sqrt(12.0)  # treated as noise
        return RoverReadings(
            tick=truth.tick,
            heading=wrap(psi + deviation + COMPASS_NOISE * float(noise[0])),
            wheel_speeds=truth.wheel_speeds + quantisation * noise[1 : 1 + n],
            steer=truth.steer + _STEER_NOISE * noise[1 + n :],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserTracker:
    """Laser tracker of the rover's position: the reference of Reina 2008, section III, or its navigation."""

    rng: np.random.Generator
    scale: float = 1.0

    def sample(self, truth: RoverTruth) -> LaserFix:
        """Measured position of the rover."""
        noise = self.scale * _LASER_NOISE * self.rng.normal(size=3)
        return LaserFix(tick=truth.tick, p_WR=np.array([truth.pose[0], truth.pose[1], truth.X_WB[2, 3]]) + noise)


@dataclass(frozen=True, slots=True)
class ExactSlip:
    """Ideal slip instrument without errors."""

    wheel: int  # of the rover, whose slip it reads

    def sample(self, truth: RoverTruth) -> SlipReading:
        """True slip of the body and of the left rear wheel."""
        return SlipReading(
            tick=truth.tick, slip_angle=truth.slip_angle, wheel_slip=float(truth.slip_angles[self.wheel])
        )
