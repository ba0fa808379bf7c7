"""Instruments for navigation: the driver's perception, reference units, and the instruments of a rover.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 4.1: position to 20 mm RMS, antennas 2.342 m apart along the trailer, the unit on the floor of
the trailer, off its centre line, mounting misalignment identified by straight driving and compensated.

Errors are Gauss-Markov processes: white noise through a first-order lag, with a standard deviation and a time
constant. The position error has two of them. One is the residual of the differential correction (troposphere, orbits,
multipath), which changes over half a minute on a moving vehicle. The other is carrier-phase noise, which the inertial
part passes at periods above about a second. Over shorter times the unit drifts by its gyroscopes and accelerometers
alone, so messages 10 ms apart share nearly all of their errors. These spectra are assumed: no published spectrum of
such a unit was available. Not modelled: loss of lock, jumps between fixed and float solution, misalignment of the
mounting, latency of the unit.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. It names these instruments without data; the errors here are assumed, as in
data sheets of such instruments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from sensors.messages import BodyPose, EgoState, GnssIns, LaserFix, RoverReadings, SlipReading
from vehicle.clock import TICK
from vehicle.combination.truth import Truth, plan_pose
from vehicle.frames import FloatArray, Pose2, rotation_zyx, transform, wrap
from vehicle.rover.truth import RoverTruth


@dataclass(frozen=True, slots=True)
class DriverPerception:
    """Perception of the tractor's driver; exact, as human perception is not modelled."""

    origin_x: float = 0.0  # of the tractor's frame, ahead of its rear-axle centre [m]

    def sample(self, truth: Truth) -> EgoState:
        """Pose and velocity of the tractor at its rear-axle centre, and the articulation angles."""
        x, y, psi = truth.poses[0].tolist()
        v_x, v_y, yaw_rate = truth.velocities[0].tolist()
        if self.origin_x:
            x, y, _ = Pose2(x, y, psi) @ Pose2(-self.origin_x, 0.0, 0.0)
            v_y -= self.origin_x * yaw_rate
        headings = truth.poses[:, 2].tolist()
        articulation = tuple(ahead - behind for ahead, behind in pairwise(headings))
        return EgoState(
            tick=truth.tick, x=x, y=y, psi=psi, v_x=v_x, v_y=v_y, yaw_rate=yaw_rate, articulation=articulation
        )


@dataclass(frozen=True, slots=True)
class ExactPose:
    """Exact reference of one unit's motion on the road."""

    unit: int
    path_height: float  # of the points that off-tracking is about, in the unit's body [m]

    def sample(self, truth: Truth) -> BodyPose:
        """Pose of the unit in plan: x, y and heading of its hitch at the path's height, as truth is judged by."""
        x, y, psi = plan_pose(truth.bodies[self.unit], self.path_height).tolist()
        return BodyPose(tick=truth.tick, X_WB=transform(rotation_zyx(psi, 0.0, 0.0), np.array([x, y, 0.0])))


PERIOD = 10  # 100 Hz, the rate of the RT3022's messages [ticks]
_ANTENNAS = 2.342  # de Saxe 2018, section 4.1 [m]
# The data sheet states 0.1 deg for antennas 2 m apart. Half of that variance is assumed constant during a test, and
# compensated together with the misalignment.
_HEADING = math.radians(0.1) * 2.0 / _ANTENNAS * math.sqrt(0.5)  # [rad]
_LEVEL = math.radians(0.05)  # roll and pitch; assumed: twice the error of dual-frequency units [rad]
_VELOCITY = 0.05 / 3.6  # data sheet: 0.05 km/h RMS [m/s]


# 20 mm RMS in the plane are 14.1 mm along each axis: in quadrature 12.7 mm slow and 6.2 mm fast [m]. Height errors are
# 1.5 times as large, as all satellites are above. Gyroscopes smooth the antennas' noise over some seconds.
_UPWARDS = np.array([1.0, 1.0, 1.5])
# Standard deviations and time constants [s] of position (3 slow, 3 fast), velocity (3), heading, pitch, roll
_STD = np.array([*[0.0127] * 3, *[0.0062] * 3, *[_VELOCITY] * 3, _HEADING, _LEVEL, _LEVEL])
_TIME = np.array([*[30.0] * 3, *[1.0] * 3, *[1.0] * 3, 5.0, 20.0, 20.0])


class ReferenceUnit:
    """Reference unit on one unit of the vehicle; errors are correlated from message to message."""

    def __init__(self, *, unit: int, p_BU: FloatArray, rng: np.random.Generator) -> None:
        """Instrument at p_BU (3,) [m] in the body's frame, aligned with it."""
        self._unit, self._p_BU, self._rng = unit, np.asarray(p_BU, dtype=np.float64), rng
        self._error = _STD * rng.standard_normal(len(_STD))
        self._tick: int | None = None

    def sample(self, truth: Truth) -> GnssIns:
        """Measured position, velocity and attitude of the instrument."""
        error = self.errors_at(truth.tick)
        X_WB, (v_x, v_y, yaw_rate) = truth.bodies[self._unit], truth.velocities[self._unit]
        R = X_WB[:3, :3]
        yaw, pitch, roll = math.atan2(R[1, 0], R[0, 0]), -math.asin(R[2, 0]), math.atan2(R[2, 1], R[2, 2])
        x, y, _ = self._p_BU
        v_B = np.array([v_x - yaw_rate * y, v_y + yaw_rate * x, 0.0])
        return GnssIns(
            tick=truth.tick,
            p_WU=X_WB[:3, 3] + R @ self._p_BU + _UPWARDS * (error[:3] + error[3:6]),
            v_WU=rotation_zyx(yaw, pitch, roll) @ v_B + error[6:9],
            heading=yaw + float(error[9]),
            pitch=pitch + float(error[10]),
            roll=roll + float(error[11]),
        )

    def errors_at(self, tick: int) -> FloatArray:
        """Errors at the tick (12,): the decayed last ones plus new noise. Call it for a message that nobody reads."""
        if self._tick is not None:
            kept, fresh = _decay(tick - self._tick)
            self._error = kept * self._error + fresh * self._rng.standard_normal(len(_STD))
        self._tick = tick
        return self._error


@lru_cache(maxsize=16)
def _decay(ticks: int) -> tuple[FloatArray, FloatArray]:
    """Share (12,) of the errors that remains after so many ticks, and standard deviations (12,) of the new ones."""
    kept = np.exp(-ticks * TICK / _TIME)
    return kept, np.sqrt(1.0 - kept**2) * _STD


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
