"""Mishaps that end an episode, as functions of a moment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scenarios.environments.moment import Moment
from scenarios.loop.referee import FOLDED, LIFTED

Ending = Callable[[Moment], NDArray[np.bool_]]  # (n,)
_ROAD = 4.5  # half the width of a course's road [m]


def jackknifed(moment: Moment) -> NDArray[np.bool_]:
    """True at an articulation of 90 deg or more."""
    folded: NDArray[np.bool_] = np.logical_or.reduce(np.abs(moment.articulation) >= FOLDED, axis=1)
    return folded


def rolled_over(moment: Moment) -> NDArray[np.bool_]:
    """True if all load of a unit is on one side's wheels; a scenario waits until it falls."""
    lifted: NDArray[np.bool_] = np.logical_or.reduce(np.abs(moment.load_transfer) >= LIFTED, axis=1)
    return lifted


def left_the_road(moment: Moment) -> NDArray[np.bool_]:
    """True if the tractor's guided point is off its course by more than half the road."""
    off_road: NDArray[np.bool_] = np.abs(moment.road_offset) > _ROAD
    return off_road


def diverged(moment: Moment) -> NDArray[np.bool_]:
    """True if the physics diverged."""
    return ~moment.finite


USUAL: Final[Mapping[str, Ending]] = {
    "jackknifed": jackknifed,
    "rolled over": rolled_over,
    "left the road": left_the_road,
    "diverged": diverged,
}
