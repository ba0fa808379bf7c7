"""Parts of a rover's reward, as functions of a moment: 0 at best, negative otherwise.

A mapping from part to weight is the option ``reward``; it may hold your own functions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np

from vehicle.frames import FloatArray


class RoverMoment(NamedTuple):
    """Ground truth of n rovers after a step, independent of the observation."""

    cross_track: FloatArray  # (n,) of R's origin from the path, + left [m]
    heading_error: FloatArray  # (n,) from the path's direction, + left [rad]
    slip_angle: FloatArray  # (n,) direction of travel relative to the heading, + left [rad]
    yaw_rate: FloatArray  # (n,) [rad/s]
    progress: FloatArray  # (n,) along the path, mean over the step [m/s]
    speed: FloatArray  # (n,) set speed of the wheels [m/s]
    demand_left: FloatArray  # (n,) wheel speed demanded of the left side, over its largest [-]
    demand_right: FloatArray  # (n,) of the right side [-]
    sinkage: FloatArray  # (n,) of the wheel that has sunk in most [m]


RoverReward = Callable[[RoverMoment], FloatArray]  # (n,)


def cross_track_error(moment: RoverMoment) -> FloatArray:
    """Minus the squared distance from the path [dm2]."""
    return np.asarray(-((moment.cross_track / 0.1) ** 2))


def off_path(moment: RoverMoment) -> FloatArray:
    """Minus the distance from the path [m]: the cost is linear."""
    return -np.abs(moment.cross_track)


def slowness(moment: RoverMoment) -> FloatArray:
    """Minus the squared lack of progress over the set speed."""
    return np.asarray(-((1.0 - moment.progress / moment.speed) ** 2))


def turn_effort(moment: RoverMoment) -> FloatArray:
    """Minus the squared difference of the sides' demands."""
    return np.asarray(-((moment.demand_left - moment.demand_right) ** 2))


def misalignment(moment: RoverMoment) -> FloatArray:
    """Minus the squared angle between the direction of travel and the path [rad2]."""
    return np.asarray(-((moment.heading_error + moment.slip_angle) ** 2))


# 0.1 m off the path costs 1 a step, standing still 0.1
USUAL: Final[Mapping[RoverReward, float]] = {cross_track_error: 1.0, slowness: 0.1, turn_effort: 0.01}
MISHAP: Final = -100.0  # once
