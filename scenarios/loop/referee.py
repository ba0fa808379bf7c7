"""How a run can go wrong, told from what is really so: jackknifed, rolled over, left the road."""

from __future__ import annotations

import math
from typing import Final, Literal

import numpy as np
from scipy.spatial import KDTree

from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

Outcome = Literal["jackknifed", "rolled over", "left the road"]

# At a right angle the pull at the hitch has no part left along the unit behind: from there on, driving forward rolls
# its axles backwards, and no driver can pull the combination straight any more.
FOLDED: Final = 0.5 * math.pi  # articulation [rad]

# The wheels of one side carry a hundredth of the load at most: the plant leaves some newtons to a wheel in the air.
LIFTED: Final = 0.98  # load transfer [-]

# A wheel that skips over a bump is no roll-over. A laden body with its centre of gravity 2.2 m from its outer wheels
# and a radius of gyration of 1.1 m falls over them with a time constant of sqrt((1.1^2 + 2.2^2) / (9.81 * 2.2)) s.
FALLING: Final = 0.5  # how long one side has to be in the air before it does not come back [s]


class Referee:
    """Watches a combination, and its tractor on the road if there is one to stay on.

    Trailers are not judged by the road: a long one cuts in by metres on a roundabout and may use its inside.
    """

    def __init__(self, vehicle: Vehicle, road: FloatArray | None = None, road_half_width: float = math.inf) -> None:
        """``road`` is its centre line, (n, 2) [m] with points no further apart than the road is wide."""
        tractor = vehicle.units[0]
        self._wheels = np.array([(axle.x, side * 0.5 * axle.track) for axle in tractor.axles for side in (1, -1)])
        self._road = None if road is None else KDTree(road)
        self._half_width = road_half_width

    def init(self) -> int | None:
        """Memory at the start: the tick from which on one side of a unit has been in the air, None if none is."""
        return None

    def step(self, memory: int | None, truth: Truth) -> tuple[int | None, Outcome | None]:
        """New memory, and how the run has ended, None if it goes on."""
        lifted = bool(np.any(np.abs(truth.load_transfer) >= LIFTED))
        since = (truth.tick if memory is None else memory) if lifted else None
        if np.any(np.abs(np.diff(truth.poses[:, 2])) >= FOLDED):
            return since, "jackknifed"
        if since is not None and (truth.tick - since) * TICK >= FALLING:
            return since, "rolled over"
        return since, "left the road" if self._beside_the_road(truth) else None

    def _beside_the_road(self, truth: Truth) -> bool:
        """Whether a wheel of the tractor stands beyond the road's edge."""
        if self._road is None:
            return False
        x, y, psi = truth.poses[0].tolist()
        c, s = math.cos(psi), math.sin(psi)
        wheels = np.array([x, y]) + self._wheels @ np.array([[c, s], [-s, c]])
        distance, _ = self._road.query(wheels)
        return bool(np.any(distance > self._half_width))
