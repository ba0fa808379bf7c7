"""Computing time of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Computing time of a run by stage [s]."""

    simulated_s: float
    wall_s: float
    physics_s: float
    render_s: float
    odometry_s: float
    odometry_parallel_s: float = 0.0  # part of it that ran in parallel to other stages and cost no wall time

    @property
    def rest_s(self) -> float:
        """Wall time outside the three stages: controllers, bookkeeping, log [s]."""
        waited = self.odometry_s - self.odometry_parallel_s
        return max(0.0, self.wall_s - self.physics_s - self.render_s - waited)

    @property
    def realtime_factor(self) -> float:
        """Simulated time over wall time: above 1 the run was faster than reality."""
        return self.simulated_s / self.wall_s if self.wall_s > 0.0 else math.nan
