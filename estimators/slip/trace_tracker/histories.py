"""Path states of parallel filters with different paces, and their mixture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker import path_line, path_state
from estimators.slip.trace_tracker.path_state import PACES, PathState
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_FORGETTING: Final = 0.98  # per image: slip that was steady for ten seconds may change
_LEAST: Final = -4.0  # least log weight of a pace relative to the best, so that it can recover


class Histories(NamedTuple):
    """One path state for each pace, with their weights."""

    paths: tuple[PathState, ...]
    worth: FloatArray  # (paces,) log weights up to a constant

    @property
    def shares(self) -> FloatArray:
        """Normalised weights (paces,)."""
        share = np.exp(self.worth - self.worth.max())
        total: FloatArray = share / share.sum()
        return total

    @property
    def together(self) -> PathState:
        """Mixture of the paces: mean, and covariance including their differences."""
        shares = self.shares
        means = np.stack([path.mean for path in self.paths])
        mean = shares @ means
        off = np.sqrt(shares)[:, None] * (means - mean)
        covariance = off.T @ off
        for share, path in zip(shares, self.paths, strict=True):
            covariance += share * path.covariance
        return self.paths[0]._replace(mean=mean, covariance=covariance)

    def each(self, changed: Callable[[PathState], PathState]) -> Histories:
        """Histories with every path changed."""
        return self._replace(paths=tuple(changed(path) for path in self.paths))


def begun(heading: float, steer: float, tick: int, bands: int) -> Histories:
    """Histories before any observation."""
    paths = tuple(path_state.begun(heading, steer, tick, bands, pace) for pace in PACES)
    return Histories(paths, np.zeros(len(paths)))


def with_new_trace(histories: Histories, slip: float, std: float) -> Histories:
    """Histories with the slip of a new trace [rad] and equal weights."""
    return histories.each(lambda path: path_state.with_slip(path, slip, std))._replace(worth=np.zeros(len(PACES)))


def with_trace(
    histories: Histories,
    rig: TraceRig,
    bands: FloatArray,
    positions: FloatArray,
    use: NDArray[np.bool_],
    noise: FloatArray,
) -> Histories:
    """Histories corrected by lateral positions (bands,) of the trace, in the bands of ``use``."""
    paths, worth = [], []
    for path in histories.paths:
        expected, gradient = path_line.predicted(path, rig, bands)
        corrected, likelihood = path_state.with_innovation(path, gradient[use], (positions - expected)[use], noise)
        paths.append(corrected)
        worth.append(likelihood)
    kept = _FORGETTING * histories.worth + np.array(worth)
    return Histories(tuple(paths), np.maximum(kept - kept.max(), _LEAST))
