"""The history of slip as filters of different pace have it, and what is made of them together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker import path_line, path_state
from estimators.slip.trace_tracker.pace import PACES
from estimators.slip.trace_tracker.path_state import PathState
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_FORGETTING: Final = 0.98  # a picture: slip that was steady for ten seconds may be so no longer
_LEAST: Final = -4.0  # log of a pace's share against the best: it must be able to come back


class Histories(NamedTuple):
    """One path state for each pace."""

    paths: tuple[PathState, ...]
    worth: FloatArray  # (paces,) log of the share of each, up to a constant

    @property
    def shares(self) -> FloatArray:
        """Of each pace (paces,), 1 in all."""
        share = np.exp(self.worth - self.worth.max())
        total: FloatArray = share / share.sum()
        return total

    @property
    def together(self) -> PathState:
        """The mean of the paces, with a covariance that has their differences in it."""
        shares = self.shares
        means = np.stack([path.mean for path in self.paths])
        mean = shares @ means
        off = np.sqrt(shares)[:, None] * (means - mean)
        covariance = off.T @ off
        for share, path in zip(shares, self.paths, strict=True):
            covariance += share * path.covariance
        return self.paths[0]._replace(mean=mean, covariance=covariance)

    def each(self, changed: Callable[[PathState], PathState]) -> Histories:
        """With every path changed."""
        return self._replace(paths=tuple(changed(path) for path in self.paths))


def begun(heading: float, steer: float, tick: int, bands: int) -> Histories:
    """Before anything was seen."""
    paths = tuple(path_state.begun(heading, steer, tick, bands, pace) for pace in PACES)
    return Histories(paths, np.zeros(len(paths)))


def found(histories: Histories, slip: float, std: float) -> Histories:
    """With the slip of a trace just found [rad]; how fast it changes is open."""
    return histories.each(lambda path: path_state.with_slip(path, slip, std))._replace(worth=np.zeros(len(PACES)))


def with_trace(
    histories: Histories,
    rig: TraceRig,
    bands: FloatArray,
    places: FloatArray,
    use: NDArray[np.bool_],
    noise: FloatArray,
) -> Histories:
    """Corrected by the places (bands,) beside the wheel where the trace was seen, in the bands of ``use``."""
    paths, worth = [], []
    for path in histories.paths:
        lies, gradient = path_line.seen(path, rig, bands)
        corrected, likelihood = path_state.with_seen(path, gradient[use], (places - lies)[use], noise)
        paths.append(corrected)
        worth.append(likelihood)
    kept = _FORGETTING * histories.worth + np.array(worth)
    return Histories(tuple(paths), np.maximum(kept - kept.max(), _LEAST))
