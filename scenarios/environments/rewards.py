"""Parts of a reward, as functions of a moment: 0 at best, negative otherwise.

``weighted`` sums them: a mapping from part to weight, which may hold your own functions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, TypeVar

import numpy as np

from scenarios.environments.moment import Moment
from vehicle.frames import FloatArray

Reward = Callable[[Moment], FloatArray]  # (n,)
M = TypeVar("M", bound=tuple[Any, ...])  # a moment of trailers or rovers; its first field is (n,)

_MAX_ERROR = 3.0  # larger distances from the path cost no more: the trailer is off the road [m]
_KERB = 0.5  # free space to either side: a lane of 3.5 m and a trailer of 2.55 m [m]


def follow_error(moment: Moment) -> FloatArray:
    """Minus the square of the follow point's distance from the path [m2], up to 3 m."""
    distance = np.minimum(np.abs(moment.off_tracking), _MAX_ERROR)
    return -distance * distance


def off_path(moment: Moment) -> FloatArray:
    """Minus the follow point's distance from the path [m], up to 3 m: the cost is linear."""
    return -np.minimum(np.abs(moment.off_tracking), _MAX_ERROR)


def outside_path(moment: Moment) -> FloatArray:
    """Minus the follow point's distance from the path to the outside of the turn [m], up to 3 m."""
    outside = np.sign(moment.curvature) * moment.off_tracking  # path on the left in a left turn: outside
    distance: FloatArray = np.minimum(np.maximum(outside, 0.0), _MAX_ERROR)
    return -distance


def kerb(moment: Moment) -> FloatArray:
    """Minus 1 while the follow point is more than half a metre off the path: its wheels are on the kerb."""
    on_kerb: FloatArray = (np.abs(moment.off_tracking) > _KERB).astype(np.float64)
    return -on_kerb


def steer_effort(moment: Moment) -> FloatArray:
    """Minus the mean square of the trailer axles' steer rates [rad2/s2]."""
    effort: FloatArray = np.einsum("ij,ij->i", moment.steer_rate, moment.steer_rate) / moment.steer_rate.shape[1]
    return -effort


def weighted(parts: Mapping[Callable[[M], FloatArray], float]) -> Callable[[M], FloatArray]:
    """Weighted sum of parts."""
    return partial(_sum, tuple(parts.items()))


def _sum(terms: tuple[tuple[Callable[[M], FloatArray], float], ...], moment: M) -> FloatArray:
    total = np.zeros(len(moment[0]))
    for part, weight in terms:
        total += weight * part(moment)
    return total


# 0.1 m off the path costs 0.01 a step, 0.1 m to the outside another 0.01; axles at 6 deg/s cost 0.0002.
USUAL: Final[Mapping[Reward, float]] = {follow_error: 1.0, outside_path: 0.1, steer_effort: 0.02}
MISHAP: Final = -100.0  # once: as much as 200 steps at 0.7 m
