"""What rewards and ends of an episode look at: one moment of n combinations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray


class Moment(NamedTuple):
    """What is really so, whatever the observation says."""

    off_tracking: FloatArray  # (n,) of the last trailer, + where its path lies left of the follow point [m]
    turn: FloatArray  # (n,) curvature of the way that the hitch takes, + left [1/m]
    steer_rate: FloatArray  # (n, n_steered) of the trailer's axles, mean over the step [rad/s]
    articulation: FloatArray  # (n, N - 1) [rad]
    load_transfer: FloatArray  # (n, N) +-1: all load on one side's wheels
    beside_road: FloatArray  # (n,) distance of the tractor from its course [m]
    speed: FloatArray  # (n,) of the tractor [m/s]
    finite: NDArray[np.bool_]  # (n,) whether the physics holds
