"""Moment of n combinations: the input of rewards and endings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray


class Moment(NamedTuple):
    """Ground truth at one step, independent of the observation."""

    off_tracking: FloatArray  # (n,) of the last trailer, + if the path lies left of the follow point [m]
    curvature: FloatArray  # (n,) of the hitch path, + left [1/m]
    steer_rate: FloatArray  # (n, n_steered) of the trailer's axles, mean over the step [rad/s]
    articulation: FloatArray  # (n, N - 1) [rad]
    load_transfer: FloatArray  # (n, N) +-1: all load on one side's wheels
    road_offset: FloatArray  # (n,) of the tractor from its course, + left [m]
    speed: FloatArray  # (n,) of the tractor [m/s]
    finite: NDArray[np.bool_]  # (n,) False once the physics diverged
