"""A GNSS-aided inertial unit with two antennas and a base station, like the RT3022 with GPS-Base-2 of the field tests.

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
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sensors.messages import GnssIns
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, rotation_zyx

PERIOD = 10  # 100 Hz, the rate of the RT3022's messages [ticks]
_ANTENNAS = 2.342  # de Saxe 2018, section 4.1 [m]
# The data sheet states 0.1 deg for antennas 2 m apart. Half of that variance is assumed constant during a test, and
# compensated together with the misalignment.
_HEADING = math.radians(0.1) * 2.0 / _ANTENNAS * math.sqrt(0.5)  # [rad]
_LEVEL = math.radians(0.05)  # roll and pitch; assumed: twice the error of dual-frequency units [rad]
_VELOCITY = 0.05 / 3.6  # data sheet: 0.05 km/h RMS [m/s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Standard deviation and time constant of a Gauss-Markov error."""

    std: float
    time_constant: float  # [s]


# 20 mm RMS in the plane are 14.1 mm along each axis: in quadrature 12.7 mm slow and 6.2 mm fast. Height errors are 1.5
# times as large, as all satellites are above.
_SLOW = Drift(std=0.0127, time_constant=30.0)  # [m]
_FAST = Drift(std=0.0062, time_constant=1.0)  # [m]
_UPWARDS = np.array([1.0, 1.0, 1.5])
_DRIFTS = (  # of position (3 slow, 3 fast), velocity (3), heading, pitch, roll
    *(_SLOW,) * 3,
    *(_FAST,) * 3,
    *(Drift(std=_VELOCITY, time_constant=1.0),) * 3,
    Drift(std=_HEADING, time_constant=5.0),  # gyroscopes smooth the antennas' noise over some seconds
    *(Drift(std=_LEVEL, time_constant=20.0),) * 2,
)
_STD = np.array([drift.std for drift in _DRIFTS])
_TIME = np.array([drift.time_constant for drift in _DRIFTS])  # [s]


class ReferenceUnit:
    """Reference unit on one unit of the vehicle; errors are correlated from message to message.

    Raises:
        ValueError: if ``unit`` is negative.
    """

    def __init__(self, *, unit: int, p_BU: FloatArray, rng: np.random.Generator) -> None:
        """Instrument at p_BU (3,) [m] in the body's frame, aligned with it."""
        if unit < 0:
            raise ValueError(f"unit = {unit} must be 0 (the tractor) or more")
        self._unit, self._p_BU, self._rng = unit, np.asarray(p_BU, dtype=np.float64), rng
        self._error = _STD * rng.standard_normal(len(_STD))
        self._tick: int | None = None

    def sample(self, truth: Truth) -> GnssIns:
        """Measured position, velocity and attitude of the instrument."""
        error = self._errors_at(truth.tick)
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

    def _errors_at(self, tick: int) -> FloatArray:
        """Errors at the tick (12,): the decayed last ones plus new noise."""
        if self._tick is not None:
            kept = np.exp(-(tick - self._tick) * TICK / _TIME)
            fresh = np.sqrt(1.0 - kept**2) * _STD
            self._error = kept * self._error + fresh * self._rng.standard_normal(len(_STD))
        self._tick = tick
        return self._error
