"""Find the points of a track that were recorded at a standstill: they jump about and make no headway."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

Groups = NDArray[np.intp]

_BACK: Final = 1.75  # turn within the reach that no vehicle drives [rad]
_LARGEST: Final = 4.0  # size of a standstill over the reach: a longer way to and fro is driven
_ROUNDS: Final = 500  # usual are 1, and 10 to 30 where there is a standstill


def standstills(places: FloatArray, reach: float) -> Groups:
    """For each of the points (n, 2) [m] the number of its group; points of one standstill share theirs.

    Wherever the way turns back, the shorter one of the legs there becomes a point, the mean of its points, unless it is
    longer than the ``reach`` [m]; until the way turns back no more.
    """
    begins = np.arange(len(places), dtype=np.intp)  # rows of the first points of the groups
    for _ in range(_ROUNDS):
        counts = np.diff(begins, append=len(places))
        legs = np.diff(np.add.reduceat(places, begins) / counts[:, None], axis=0)
        lengths = np.hypot(*legs.T)
        low, high = np.minimum.reduceat(places, begins), np.maximum.reduceat(places, begins)
        sizes = np.hypot(*(np.maximum(high[1:], high[:-1]) - np.minimum(low[1:], low[:-1])).T)
        costs = np.where(_back(legs, lengths, reach) & (sizes <= _LARGEST * reach), lengths, np.inf)
        around = np.concatenate([[np.inf], costs, [np.inf]])
        shortest = np.isfinite(costs) & (costs <= around[:-2]) & (costs < around[2:])
        if not shortest.any():
            break
        begins = begins[np.append(True, ~shortest)]
    return np.asarray(np.repeat(np.arange(len(begins)), np.diff(begins, append=len(places))), dtype=np.intp)


def means(groups: Groups, values: FloatArray) -> FloatArray:
    """Means of values (n, ...) over each group."""
    counts = np.bincount(groups)
    columns = [np.bincount(groups, column) / counts for column in values.reshape(len(groups), -1).T]
    return np.stack(columns, axis=1).reshape(-1, *values.shape[1:])


def _back(legs: FloatArray, lengths: FloatArray, reach: float) -> NDArray[np.bool_]:
    """True for the legs (n, 2) that are the shorter one at a turn back, and no longer than the reach."""
    chosen: NDArray[np.bool_] = lengths == 0.0
    if len(legs) < 2:
        return chosen
    heading = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    along = np.append(0.0, np.cumsum(lengths))[:-1]  # at the begin of each leg
    later = np.searchsorted(along, along[1:] + reach, side="right") - 1
    turns = np.abs(np.stack([heading[1:], heading[later]]) - heading[:-1]).max(axis=0)
    at = np.flatnonzero(turns > _BACK)
    at = at + (lengths[at + 1] < lengths[at])
    chosen[at] = lengths[at] <= reach
    return chosen
