"""Encoders and gyros of many combinations: the constant errors of ``sensors.instruments.combination``.

Its white noise, as large as the bias, is not modelled here.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vehicle.combination.batch import BatchMotion
from vehicle.frames import FloatArray

_ARTICULATION, _GYRO = math.radians(0.1), math.radians(0.1)  # biases as in that module, 1 sigma [rad], [rad/s]


class Encoders:
    """Articulation encoders and gyros of n vehicles."""

    def __init__(self, n: int, n_units: int) -> None:
        """Without errors until they ``begin``."""
        self._articulation, self._gyro = np.zeros((n, n_units - 1)), np.zeros((n, n_units))

    def begin(self, lanes: NDArray[np.intp], generators: list[np.random.Generator], scale: FloatArray) -> None:
        """Draw errors of this ``scale`` (k,) for these vehicles."""
        n_hitches, n_units = self._articulation.shape[1], self._gyro.shape[1]
        drawn = scale[:, None] * np.array([rng.standard_normal(n_hitches + n_units) for rng in generators])
        self._articulation[lanes] = _ARTICULATION * drawn[:, :n_hitches]
        self._gyro[lanes] = _GYRO * drawn[:, n_hitches:]

    def read(self, motion: BatchMotion) -> tuple[FloatArray, FloatArray]:
        """Articulation (n, N - 1) [rad] and yaw rates (n, N) [rad/s]."""
        psi = motion.poses[:, :, 2]
        return psi[:, :-1] - psi[:, 1:] + self._articulation, motion.velocities[:, :, 2] + self._gyro
