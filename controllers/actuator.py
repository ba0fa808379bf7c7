"""A controller's own model of a steering actuator: first-order lag under a rate limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vehicle.frames import FloatArray


def settle(angle: ArrayLike, demand: ArrayLike, duration: ArrayLike, *, lag: float, max_rate: float) -> FloatArray:
    """Angle [rad] ``duration`` [s] after the demand [rad] was set: exact for d(angle)/dt = clip((demand - angle)/lag).

    ``lag`` [s] is the first-order time constant (zero: the rate limit alone), ``max_rate`` [rad/s] the limit.
    """
    angle, demand = np.asarray(angle, dtype=np.float64), np.asarray(demand, dtype=np.float64)
    duration = np.asarray(duration, dtype=np.float64)
    gap = demand - angle
    # The rate is at its limit while |gap| > max_rate lag; from there on the gap decays exponentially.
    at_limit = np.maximum(np.abs(gap) / max_rate - lag, 0.0)  # [s]
    linear = np.minimum(at_limit, duration)
    left = np.abs(gap) - max_rate * linear
    if lag > 0.0:
        left = left * np.exp(-(duration - linear) / lag)
    settled: FloatArray = demand - np.sign(gap) * left
    return settled
