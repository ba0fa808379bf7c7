"""Controllers' model of a steering actuator: first-order lag under a rate limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from controllers.functions import ARRAYS, Functions, Num
from vehicle.frames import FloatArray


def settled(
    f: Functions[Num], angle: Num, demand: Num, duration: Num | float, *, lag: float, max_rate: Num | float
) -> Num:
    """Angle [rad] ``duration`` [s] after the demand [rad] was set: exact for d(angle)/dt = clip((demand - angle)/lag).

    ``lag`` [s] is the first-order time constant (zero: the rate limit alone), ``max_rate`` [rad/s] the limit.
    """
    gap = demand - angle
    # The rate is at its limit while |gap| > max_rate lag; from there on the gap decays exponentially.
    linear = f.fmin(f.fmax(f.fabs(gap) / max_rate - lag, 0.0), duration)  # time at the limit [s]
    remaining = f.fabs(gap) - max_rate * linear
    if lag > 0.0:
        remaining = remaining * f.exp((linear - duration) / lag)
    return demand - f.sign(gap) * remaining


def settle(
    angle: ArrayLike, demand: ArrayLike, duration: ArrayLike, *, lag: float, max_rate: FloatArray | float
) -> FloatArray:
    """`settled` for arrays."""
    angle, demand = np.asarray(angle, dtype=np.float64), np.asarray(demand, dtype=np.float64)
    duration = np.asarray(duration, dtype=np.float64)
    angles: FloatArray = settled(ARRAYS, angle, demand, duration, lag=lag, max_rate=max_rate)
    return angles
