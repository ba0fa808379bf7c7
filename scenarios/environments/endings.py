"""How an episode can end badly, as functions of a moment."""

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
    """An articulation of a right angle."""
    folded: NDArray[np.bool_] = np.any(np.abs(moment.articulation) >= FOLDED, axis=1)
    return folded


def rolled_over(moment: Moment) -> NDArray[np.bool_]:
    """All load of a unit on one side's wheels; a scenario waits half a second longer for the same."""
    lifted: NDArray[np.bool_] = np.any(np.abs(moment.load_transfer) >= LIFTED, axis=1)
    return lifted


def left_the_road(moment: Moment) -> NDArray[np.bool_]:
    """The tractor's guided point farther from its course than half the road."""
    beside: NDArray[np.bool_] = np.abs(moment.beside_road) > _ROAD
    return beside


def diverged(moment: Moment) -> NDArray[np.bool_]:
    """The physics broke."""
    return ~moment.finite


USUAL: Final[Mapping[str, Ending]] = {
    "jackknifed": jackknifed,
    "rolled over": rolled_over,
    "left the road": left_the_road,
    "diverged": diverged,
}
