"""A rover's own instruments: encoders and a fluxgate compass on board, a laser tracker beside the field.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. It names these instruments and gives none of their data; what is said here of them
is assumed, in the size that data sheets of such instruments state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from sensors.messages import LaserFix, RoverReadings, SlipReading
from vehicle.frames import wrap
from vehicle.rover.truth import RoverTruth

# A calibrated fluxgate compass is good to 0.5 deg RMS (assumed, as common data sheets say): noise of the reading, and
# what a calibration for the rover's own iron leaves, which goes round once and twice with the heading.
COMPASS_NOISE: Final = math.radians(0.35)  # of one reading [rad]
_DEVIATION: Final = np.radians([0.2, 0.15])  # standard deviations of the once and the twice periodic part [rad]
_WHEEL_STEP: Final = 2.0 * math.pi / 100_000  # encoder counts a turn of the wheel, behind its gear: assumed [rad]
_SPEED_SPAN: Final = 0.05  # over which counts are taken for a speed [s]
_STEER_NOISE: Final = math.radians(0.05)  # of a steer encoder, assumed [rad]
_LASER_NOISE: Final = 0.003  # of each coordinate: a tracking total station, assumed [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverInstruments:
    """Encoders of wheels and steering, and the compass; ``scale`` multiplies all their errors."""

    rng: np.random.Generator
    scale: float = 1.0
    deviation: tuple[tuple[float, float], ...] = field(init=False)  # amplitude and phase of each part [rad]

    def __post_init__(self) -> None:
        amplitudes = self.scale * _DEVIATION * np.abs(self.rng.normal(size=2))
        phases = self.rng.uniform(-math.pi, math.pi, 2)
        object.__setattr__(self, "deviation", tuple(zip(amplitudes.tolist(), phases.tolist(), strict=True)))

    def sample(self, truth: RoverTruth) -> RoverReadings:
        """One reading of them all."""
        n = len(truth.steer)
        noise = self.scale * self.rng.normal(size=1 + 2 * n)
        psi = float(truth.pose[2])
        turned = sum(size * math.sin((k + 1) * psi + phase) for k, (size, phase) in enumerate(self.deviation))
        counting = _WHEEL_STEP / _SPEED_SPAN / math.sqrt(12.0)  # of a count more or less, as if it were noise
        return RoverReadings(
            tick=truth.tick,
            heading=wrap(psi + turned + COMPASS_NOISE * float(noise[0])),
            wheel_speeds=truth.wheel_speeds + counting * noise[1 : 1 + n],
            steer=truth.steer + _STEER_NOISE * noise[1 + n :],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserTracker:
    """Absolute position of the rover, for judging it (Reina 2008, section III) or as its navigation."""

    rng: np.random.Generator
    scale: float = 1.0

    def sample(self, truth: RoverTruth) -> LaserFix:
        """Where it is seen."""
        noise = self.scale * _LASER_NOISE * self.rng.normal(size=3)
        return LaserFix(tick=truth.tick, p_WR=np.array([truth.pose[0], truth.pose[1], truth.X_WB[2, 3]]) + noise)


@dataclass(frozen=True, slots=True)
class ExactSlip:
    """An instrument without any error."""

    wheel: int  # of the rover, whose slip it reads

    def sample(self, truth: RoverTruth) -> SlipReading:
        """The slip as it is."""
        return SlipReading(
            tick=truth.tick, slip_angle=truth.slip_angle, wheel_slip=float(truth.slip_angles[self.wheel])
        )
