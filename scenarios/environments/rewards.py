"""Parts of a reward, as functions of a moment: each costs nothing where all is well, and is negative elsewhere.

Put together by ``weighted``: a mapping from part to weight, which a user's own functions may be in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from scenarios.environments.moment import Moment
from vehicle.frames import FloatArray

Reward = Callable[[Moment], FloatArray]  # (n,)

_WORST = 3.0  # farther beside its path than this a trailer costs no more: off the road is off the road [m]
_KERB = 0.5  # room beside the path of the hitch: a lane of 3.5 m and a trailer of 2.55 m [m]


def follow_error(moment: Moment) -> FloatArray:
    """Minus the square of the follow point's distance from the path [m2], up to 3 m."""
    distance = np.minimum(np.abs(moment.off_tracking), _WORST)
    return -distance * distance


def off_path(moment: Moment) -> FloatArray:
    """Minus the follow point's distance from the path [m], up to 3 m: the last centimetres cost as the first do."""
    return -np.minimum(np.abs(moment.off_tracking), _WORST)


def outside_path(moment: Moment) -> FloatArray:
    """Minus the follow point's distance from the path to the outside of the turn [m], up to 3 m."""
    outside = np.sign(moment.turn) * moment.off_tracking  # the path lies left of it: in a left turn it is outside
    distance: FloatArray = np.minimum(np.maximum(outside, 0.0), _WORST)
    return -distance


def kerb(moment: Moment) -> FloatArray:
    """Minus 1 while the follow point is more than half a metre beside the path: its wheels are on the kerb."""
    up: FloatArray = (np.abs(moment.off_tracking) > _KERB).astype(np.float64)
    return -up


def steer_effort(moment: Moment) -> FloatArray:
    """Minus the mean square of the trailer axles' steer rates [rad2/s2]."""
    effort: FloatArray = np.einsum("ij,ij->i", moment.steer_rate, moment.steer_rate) / moment.steer_rate.shape[1]
    return -effort


def weighted(parts: Mapping[Reward, float]) -> Reward:
    """The sum of some parts, each with its weight."""
    terms = tuple(parts.items())

    def together(moment: Moment) -> FloatArray:
        total = np.zeros(len(moment.off_tracking))
        for part, weight in terms:
            total += weight * part(moment)
        return total

    return together


# A decimetre beside the path costs 0.01 a step, a decimetre to the outside as much again; axles at 6 deg/s cost 0.0002.
USUAL: Final[Mapping[Reward, float]] = {follow_error: 1.0, outside_path: 0.1, steer_effort: 0.02}
MISHAP: Final = -100.0  # once: as much as two hundred steps at 0.7 m
