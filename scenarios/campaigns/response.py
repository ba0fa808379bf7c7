"""Response of a loop to a fault, from the signals of its run: when it is noticed, and when all is well again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenarios.campaigns.fault_entry import FaultTime
from scenarios.results.log import OK, Log
from vehicle.frames import FloatArray

_TRUE: Final = "off_tracking_true_"  # begins the signal of every judged trailer
_CROSS: Final = "cross_track_true"  # signal of a rover
_STEADY: Final = 1.0  # for which all must be well to count as recovered [s]
_ROUNDING: Final = 1e-9  # of times [s]


class Response(NamedTuple):
    """Times of one run [s]. NaN: does not apply. Infinite: it never came."""

    detection: float = math.nan  # from the onset until something is noticed, of any trailer
    recovery: float = math.nan  # from the end until health is ok, no fallback steers and all deviation is small
    deviation: float = math.nan  # largest off-tracking of any trailer, or cross-track, from the onset on [m]
    alarm: bool = False  # something was noticed at some time after the first health that was ok


def response(log: Log, fault: FaultTime | None, *, recovered_below: float, completed: bool) -> Response:
    """Response to a fault.

    The time of a health is that of its capture; control learns of it when the estimate arrives. All is well once it
    has been for a second without a break, or until a completed course ends.

    Args:
        log: signals of the run.
        fault: when it acts; None: never, which leaves the alarms.
        recovered_below: off-tracking, or distance of a rover from its path, that counts as recovered [m].
        completed: the run ended by completing its course.
    """
    time, guided = log["time"], list(_all_guided(log))
    alarm = any(_alarm(one.noticed, one.known) for one in guided)
    if fault is None or not guided or not len(time) or time[-1] < fault.onset:
        return Response(alarm=alarm)
    since = time >= fault.onset - _ROUNDING
    noticed = np.any([one.noticed for one in guided], axis=0)
    detection = _first(time, noticed & since) - fault.onset
    off = np.concatenate([one.deviation[since] for one in guided])
    deviation = float(np.max(np.abs(off[np.isfinite(off)]), initial=0.0))
    if fault.end is None or time[-1] < fault.end:
        return Response(detection, math.nan if fault.end is None or completed else math.inf, deviation, alarm)
    well = np.all([~(t.degraded | (np.abs(t.deviation) > recovered_below)) for t in guided], axis=0)
    steady = _steady(time, well, completed=completed)
    recovery = _first(time, steady & (time >= fault.end - _ROUNDING)) - fault.end
    return Response(detection, recovery, deviation, alarm)


class _Guided(NamedTuple):
    """Signals of one trailer, or of a rover, over time, as far as its response goes."""

    degraded: NDArray[np.bool_]  # its health is not ok, or the fallback steers
    distrusted: NDArray[np.bool_]  # a signal or an axle is held to be at fault
    known: NDArray[np.bool_]  # its health is known
    deviation: FloatArray  # true off-tracking, or distance from the path [m]

    @property
    def noticed(self) -> NDArray[np.bool_]:
        """That something is wrong."""
        return self.degraded | self.distrusted


def _all_guided(log: Log) -> Iterator[_Guided]:
    """Every judged trailer, or the rover."""
    for true in log.names:
        if not true.startswith(_TRUE) and true != _CROSS:
            continue
        ending = "" if true == _CROSS else f"_{true.removeprefix(_TRUE)}"
        health, fallback, distrusted, axles = (
            log[f"{signal}{ending}"] if f"{signal}{ending}" in log else np.full(len(log), np.nan)
            for signal in ("health", "fallback", "distrusted", "axles_at_fault")
        )
        health = _held(health)
        at_fault = (distrusted > 0.0) | (axles > 0.0)
        yield _Guided((health > OK) | (fallback > 0.0), at_fault, np.isfinite(health), log[true])


def _held(values: FloatArray) -> FloatArray:
    """Each value until the next; NaN before the first."""
    places = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    return np.where(places < 0, np.nan, values[np.maximum(places, 0)])


def _alarm(noticed: NDArray[np.bool_], known: NDArray[np.bool_]) -> bool:
    well = np.flatnonzero(known & ~noticed)
    return bool(well.size and noticed[well[0] :].any())


def _steady(time: FloatArray, well: NDArray[np.bool_], *, completed: bool) -> NDArray[np.bool_]:
    """True where all is well from now on for the time that counts as recovered."""
    breaks = np.append(time[~well], math.inf if completed else time[-1])
    following = breaks[np.searchsorted(breaks, time)]
    return well & (following - time >= _STEADY - _ROUNDING)


def _first(time: FloatArray, chosen: NDArray[np.bool_]) -> float:
    return float(time[np.argmax(chosen)]) if chosen.any() else math.inf
