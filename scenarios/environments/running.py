"""Running metrics of many episodes, with the names of a run's summary."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenarios.environments.core import Info
from scenarios.environments.moment import Moment
from scenarios.environments.rewards import outside_path
from vehicle.frames import FloatArray


class RunningMetrics:
    """Off-tracking and steering of n episodes so far."""

    def __init__(self, n: int) -> None:
        """Begin with no steps."""
        self._steps, self._squares = np.zeros(n), np.zeros(n)
        self._largest, self._outside = np.zeros(n), np.zeros(n)
        self._steer, self._rate = np.zeros(n), np.zeros(n)
        self.newest = np.zeros(n)  # off-tracking [m]

    def begin(self, lanes: NDArray[np.intp]) -> None:
        """Begin episodes in these lanes."""
        for part in (self._steps, self._squares, self._largest, self._outside, self._steer, self._rate, self.newest):
            part[lanes] = 0.0

    def step(self, moment: Moment, angles: FloatArray) -> None:
        """Add a step, with the trailer's axles at angles (n, n_steered) [rad]."""
        error = moment.off_tracking
        if not moment.finite.all():
            error = np.where(moment.finite, error, 0.0)
        self.newest = error
        self._steps += 1.0
        self._squares += error * error
        np.fmax(self._largest, np.abs(error), out=self._largest)
        np.fmax(self._outside, -outside_path(moment), out=self._outside)
        np.fmax(self._steer, np.abs(angles).max(axis=1), out=self._steer)
        np.fmax(self._rate, np.abs(moment.steer_rate).max(axis=1), out=self._rate)

    def info(self) -> Info:
        """Metrics by their names in ``summary.json``; ``outside_max_m`` is the follow point's, in turns."""
        return {
            "off_tracking": self.newest.copy(),
            "true_rms_m": np.sqrt(self._squares / np.maximum(self._steps, 1.0)),
            "true_max_m": self._largest.copy(),
            "outside_max_m": self._outside.copy(),
            "steer_max_deg": np.degrees(self._steer),
            "steer_max_rate_deg_s": np.degrees(self._rate),
        }
