"""Off-tracking of a run by a reference unit on the trailer, as in the field tests of the paper.

C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System Dynamics, 2018.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.estimates import Health
from estimators.off_tracking.reference import ReferenceUnitOffTracking
from sensors.instruments.reference_unit import PERIOD, ReferenceUnit
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

_LATERAL, _FLOOR = 0.8, 1.2  # the unit stood off the middle of the trailer's floor; both distances are assumed [m]
_EVERY = 100  # every tenth message, at the rate of the cameras it is compared with [ticks]


class ReferenceOffTracking:
    """Off-tracking by the reference unit on a run whose truths are shown to it part by part, in order."""

    def __init__(self, *, unit: int, follow_distance: float, path_height: float, rng: np.random.Generator) -> None:
        """Paths are those of points at ``path_height`` [m] in the body of a unit of the vehicle."""
        p_SU = np.array([-0.5 * follow_distance, _LATERAL, _FLOOR])
        self._sensor = ReferenceUnit(unit=unit, p_BU=p_SU, rng=rng)
        self._source = ReferenceUnitOffTracking(p_SU, follow_distance, path_height=path_height)
        self._memory = self._source.init()

    def values(self, truths: Sequence[Truth]) -> FloatArray:
        """Off-tracking [m] at the next truths (n,), NaN where the unit has none.

        The truths come at the unit's 100 Hz; the buffer takes every tenth message.
        """
        values = np.full(len(truths), np.nan)
        for row, truth in enumerate(truths):
            if truth.tick % PERIOD:
                continue
            message = self._sensor.sample(truth)
            if truth.tick % _EVERY == 0:
                self._memory, estimate = self._source.step(self._memory, message)
                if estimate is not None and estimate.health is not Health.LOST:
                    values[row] = estimate.value
        return values
