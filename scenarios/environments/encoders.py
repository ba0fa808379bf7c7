"""Sensors of many combinations: those errors of ``sensors.instruments.combination`` that last a whole episode.

Its noise from sample to sample is white and as large as the bias; a policy that lives on single samples of it would be
noticed in the loop. Here it is left out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vehicle.combination.batch import BatchMotion
from vehicle.frames import FloatArray

_ARTICULATION, _GYRO = math.radians(0.1), math.radians(0.1)  # as there: biases, 1 sigma [rad], [rad/s]


class Encoders:
    """Articulation encoders and gyros of n vehicles."""

    def __init__(self, n: int, n_units: int) -> None:
        """Without error until they ``begin``."""
        self._articulation, self._gyro = np.zeros((n, n_units - 1)), np.zeros((n, n_units))

    def begin(self, lanes: NDArray[np.intp], generators: list[np.random.Generator], scale: FloatArray) -> None:
        """New errors of this ``scale`` (k,) for these vehicles."""
        n_hitches, n_units = self._articulation.shape[1], self._gyro.shape[1]
        drawn = scale[:, None] * np.array([rng.standard_normal(n_hitches + n_units) for rng in generators])
        self._articulation[lanes] = _ARTICULATION * drawn[:, :n_hitches]
        self._gyro[lanes] = _GYRO * drawn[:, n_hitches:]

    def read(self, seen: BatchMotion) -> tuple[FloatArray, FloatArray]:
        """Articulation (n, N - 1) [rad] and yaw rates (n, N) [rad/s]."""
        psi = seen.poses[:, :, 2]
        return psi[:, :-1] - psi[:, 1:] + self._articulation, seen.velocities[:, :, 2] + self._gyro
