"""Errors of a combination's signals: what is assumed, how noisy they are, and whether they contradict each other.

Rows are those of ``DeadReckoning.row``: tick, speed, steer angle, slip by scrub, ``unit``
articulations, ``unit + 1`` yaw rates, and more.
"""

from __future__ import annotations

import math

import numpy as np

from vehicle.clock import TICK
from vehicle.frames import FloatArray

# White noise of every sample and constant error, 1 sigma: assumed, as of the sensors of a truck
# (``sensors.instruments.combination``).
SPEED_NOISE = 0.02  # [m/s]
STEER_NOISE = math.radians(0.1)  # [rad]
ARTICULATION_NOISE = math.radians(0.15)  # [rad]
GYRO_NOISE = math.radians(0.1)  # [rad/s]
GYRO_BIAS = math.radians(0.12)  # [rad/s]

_SPEED, _FIRST = 1, 4  # columns of the speed and of the first articulation
_VISIBLE = 0.3  # noise of a gyro that tells that signals have noise at all [its assumed standard deviation]
_LEVEL_OF = 50  # samples that the noise is measured from: to 10 %
_NOISIER = 1.5  # noise above which the assumed one is replaced by the measured one [its standard deviations]
_COMPARED = 2000  # time over which signals are compared with each other [ticks]
_STUCK = 5.0  # difference of signals that contradict each other [standard deviations]


def noise_level(history: FloatArray, unit: int, least: int = _LEVEL_OF) -> float:
    """White noise of articulations and gyros over the assumed one; 1 if it is about that or less.

    From second differences of the newest rows of ``history`` (n, columns): motion hardly has any within 40 ms. It is 1
    with less than so many rows.
    """
    recent = history[-_LEVEL_OF:, _FIRST : _FIRST + 2 * unit + 1]
    if len(recent) < least:
        return 1.0
    measured = np.sqrt(np.mean(np.square(np.diff(recent, n=2, axis=0)), axis=0) / 6.0)  # 1 + 4 + 1 of its variance
    assumed = np.array([ARTICULATION_NOISE] * unit + [GYRO_NOISE] * (unit + 1))
    level = float(np.median(measured / assumed))
    return level if level > _NOISIER else 1.0


def agree(history: FloatArray, unit: int) -> bool:
    """Test the signals of ``history`` (n, columns): articulations change by the difference of two yaw rates.

    A gyro or an angle sensor that is stuck is noticed as soon as the vehicle turns by some degrees. The wheel speed has
    no such counterpart; it is stuck if it repeats the same value for a second, while gyros are noisy.
    """
    if len(history) < 2:
        return True
    if _speed_repeats(history[-_LEVEL_OF:], unit):
        return False
    recent = history[history[:, 0] >= history[-1, 0] - _COMPARED]
    time = recent[:, 0] * TICK
    gammas, rates = recent[:, _FIRST : _FIRST + unit], recent[:, _FIRST + unit : _FIRST + 2 * unit + 1]
    differences = -np.diff(rates, axis=1)
    turned = np.sum(0.5 * np.diff(time)[:, None] * (differences[1:] + differences[:-1]), axis=0)
    residual = gammas[-1] - gammas[0] - turned
    drifted = GYRO_BIAS * float(time[-1] - time[0])
    std = math.sqrt(2.0) * math.hypot(ARTICULATION_NOISE, drifted)  # of two samples, and of two gyros
    limit = _STUCK * std * noise_level(history, unit)
    return bool(np.all(np.abs(np.remainder(residual + math.pi, 2.0 * math.pi) - math.pi) < limit))


def _speed_repeats(recent: FloatArray, unit: int) -> bool:
    """True if the speed is the same in all rows, although the signals are noisy."""
    if len(recent) < _LEVEL_OF or np.ptp(recent[:, _SPEED]) > 0.0:
        return False
    rates = recent[:, _FIRST + unit : _FIRST + 2 * unit + 1]
    noise = np.sqrt(np.mean(np.square(np.diff(rates, n=2, axis=0)), axis=0) / 6.0)
    return bool(np.median(noise) > _VISIBLE * GYRO_NOISE)
