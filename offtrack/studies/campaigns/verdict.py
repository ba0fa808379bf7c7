"""Verdict on a run of a campaign: requirements, response to the fault, and what was broken."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from offtrack.reports.sections import groups
from offtrack.studies.campaigns.fault_entry import FaultTime, fault_time
from offtrack.studies.case import MOST_CASES, Case, Outcome, composed
from offtrack.studies.draws import number_of
from scenarios.results.log import OK, Log, read_log
from vehicle.foundation.user_file import nearest, shown
from vehicle.frames import FloatArray

OUTCOMES: Final = ("completed", "jackknifed", "rolled over", "left the road", "left the lane", "timed out", "diverged")
DETECT, HARMLESS, ALLOWED = "time_to_detect_s", "harmless_below_m", "outcomes"
RECOVER, BELOW = "time_to_recover_s", "recovered_below_m"
_OWN: Final = (ALLOWED, DETECT, HARMLESS, RECOVER, BELOW)
GROUPS: Final = ("off_tracking", "swept_path", "road", "steer", "tyres", "slip", "odometry", "position", "wheels")


class Limit(NamedTuple):
    """Limits of a number ``group.name`` of the summary, in the summary's unit."""

    path: str
    low: float = -math.inf
    high: float = math.inf

    @property
    def text(self) -> str:
        """The limits, as tables show them."""
        group, _, name = self.path.partition(".")
        number = groups()[group].numbers[name]
        of, unit = number.label, number.own_unit.removeprefix("-")
        parts = [f"at least {self.low:g}"] if self.low > -math.inf else []
        parts += [f"at most {self.high:g}"] if self.high < math.inf else []
        return f"{of}: {', '.join(parts)} {unit}".strip()

    def severity(self, value: float) -> float:
        """Value over its limit: above 1 it is beyond it."""
        above = value / self.high if self.high > 0.0 else 1.0 + value - self.high
        below = 1.0 + (self.low - value) / max(abs(self.low), 1.0)
        return max(above if self.high < math.inf else -math.inf, below if self.low > -math.inf else -math.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirements:
    """Requirements that each run must keep."""

    limits: tuple[Limit, ...] = ()
    outcomes: tuple[str, ...] = ("completed",)  # that are no failures
    detect: float | None = None  # longest time from the onset of a fault until it is noticed [s]; None: any
    harmless_below: float = 0.0  # off-tracking up to which a fault need not be noticed [m]
    recover: float | None = None  # longest time from the end of a fault until all is well again [s]; None: any
    recovered_below: float = 0.2  # off-tracking that counts as recovered [m]

    def table(self) -> dict[str, Any]:
        """The table ``requirements`` of a campaign file."""
        table: dict[str, Any] = {ALLOWED: list(self.outcomes), BELOW: self.recovered_below}
        for limit in self.limits:
            known = {"min": limit.low, "max": limit.high}
            table[limit.path] = {key: value for key, value in known.items() if math.isfinite(value)}
        times = {DETECT: self.detect, HARMLESS: self.harmless_below or None, RECOVER: self.recover}
        return table | {key: value for key, value in times.items() if value is not None}


def read_requirements(place: str, table: Iterable[tuple[str, Any]]) -> Requirements:
    """Requirements of a campaign file, from the dotted keys of its table ``requirements``.

    A number of the summary has an upper limit (``steer.max_deg = 30``), or ``.min`` and ``.max``.

    Raises:
        ValueError: one line, naming the key.
    """
    known = [f"{group}.{name}" for group in GROUPS for name in groups()[group].numbers]
    limits, own = dict[str, Limit](), dict[str, Any]()
    for key, value in table:
        path, _, side = key.rpartition(".")
        path, side = (path, side) if side in ("min", "max") else (key, "max")
        if key in _OWN:
            own[key] = value
        elif path not in known:
            raise ValueError(f"{place}: requirements.{shown(key)}{nearest(path, [*known, *_OWN])}")
        else:
            limit, number = limits.get(path, Limit(path)), number_of(f"{place}: requirements.{key}", value)
            limits[path] = limit._replace(low=number) if side == "min" else limit._replace(high=number)
    times = {key: _positive(f"{place}: requirements.{key}", own[key]) for key in _OWN[1:] if key in own}
    return Requirements(
        limits=tuple(limits.values()),
        outcomes=_allowed(place, own.get(ALLOWED, ["completed"])),
        detect=times.get(DETECT),
        harmless_below=times.get(HARMLESS, 0.0),
        recover=times.get(RECOVER),
        recovered_below=times.get(BELOW, Requirements().recovered_below),
    )


def _allowed(place: str, values: Any) -> tuple[str, ...]:
    if not isinstance(values, list | tuple) or not values:
        raise ValueError(f"{place}: requirements.{ALLOWED} must be a list of {', '.join(OUTCOMES)}")
    for value in values:
        if value not in OUTCOMES:
            raise ValueError(f"{place}: requirements.{ALLOWED}: {shown(str(value))}{nearest(str(value), OUTCOMES)}")
    return tuple(values)


def _positive(place: str, value: Any) -> float:
    number = number_of(place, value)
    if number <= 0.0:
        raise ValueError(f"{place} = {number:g} must be above 0")
    return number


_TRUE: Final = "off_tracking_true_"  # begins the signal of every verdict_on trailer
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
    """Every verdict_on trailer, or the rover."""
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


END_OF_RUN, DETECTION, RECOVERY = "outcome", "time to detect", "time to recover"
_WORST: Final = 1e9  # severity of a run that did not end as it should


class Breach(NamedTuple):
    """A broken requirement."""

    requirement: str  # as tables name it
    reason: str  # with the value
    severity: float  # value over limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A run with its verdict."""

    outcome: Outcome
    fault: str  # title of the entry; "none" for a reference
    breaches: tuple[Breach, ...]
    response: Response
    reached: bool  # False: the run was completed before its fault began, so that it tells nothing
    severity: float  # of its worst requirement, broken or not

    @property
    def failed(self) -> bool:
        """True if a requirement is broken."""
        return bool(self.breaches)

    @property
    def verdict(self) -> str:
        """The verdict in a word."""
        return "failed" if self.failed else "passed" if self.reached else "fault not reached"

    @property
    def reasons(self) -> str:
        """All broken requirements with their values."""
        return "; ".join(breach.reason for breach in self.breaches)


def verdict_on(outcome: Outcome, fault: str, requirements: Requirements) -> Judgement:
    """Judge a run by its summary and its signals."""
    time = time_of(outcome.case)
    measured = _response(outcome, time, requirements)
    checks = list(_checks(outcome, time, measured, requirements))
    end = outcome.number("timing.simulated_s")
    return Judgement(
        outcome=outcome,
        fault=fault,
        breaches=tuple(check for check in checks if check.severity > 1.0),
        response=measured,
        reached=time is None or not outcome.completed or end is None or time.onset < end,
        severity=max((check.severity for check in checks), default=0.0),
    )


def time_of(case: Case) -> FaultTime | None:
    """When the faults of a run act; None: it has none."""
    text = dict(case.axes).get("faults", "")
    return fault_time(composed("faults", text, case.drawn))


def _response(outcome: Outcome, time: FaultTime | None, requirements: Requirements) -> Response:
    if outcome.signals is None or not outcome.signals.is_file():
        return Response()
    return _response_in(outcome.signals, time, requirements.recovered_below, outcome.completed)


@lru_cache(maxsize=MOST_CASES)  # a file of signals is named by its content
def _response_in(signals: Path, time: FaultTime | None, below: float, completed: bool) -> Response:
    return response(read_log(signals), time, recovered_below=below, completed=completed)


def _checks(
    outcome: Outcome, time: FaultTime | None, measured: Response, requirements: Requirements
) -> Iterator[Breach]:
    """Every requirement that applies; a severity above 1 breaks it."""
    ending = str(outcome.numbers["outcome"])
    yield Breach(END_OF_RUN, ending, 0.0 if ending in requirements.outcomes else _WORST)
    if ending.startswith("failed"):
        return
    for limit in requirements.limits:
        value = outcome.number(limit.path)
        text = f"{limit.path} = {'no value' if value is None else f'{value:.4g}'}"
        yield Breach(limit.path, text, math.inf if value is None else limit.severity(value))
    if time is not None:
        yield from _timely(outcome, time, measured, requirements)


def _timely(outcome: Outcome, time: FaultTime, measured: Response, requirements: Requirements) -> Iterator[Breach]:
    """Times to detect and to recover, as far as they apply: not if fault or course ended before they had to come."""
    simulated = outcome.number("timing.simulated_s")
    ran = math.inf if simulated is None or not outcome.completed else simulated
    over = math.inf if time.end is None else time.end
    is_harmless = requirements.harmless_below > 0.0 and measured.deviation <= requirements.harmless_below
    for name, longest, value, room in (
        (DETECTION, None if is_harmless else requirements.detect, measured.detection, min(over, ran) - time.onset),
        (RECOVERY, requirements.recover, measured.recovery, ran - over),
    ):
        never = math.isinf(value)
        if longest is not None and not math.isnan(value) and not (never and room < longest):
            yield Breach(name, f"{name}: {'never' if never else f'{value:.2f} s'}", value / longest)
