"""Warnings about steering, cameras, actuators and signals of a run.

An oscillation is a row of swings to and fro of similar size and period. The swings that the road itself asks for, in a
slalom, do not count: its curvature swings as often. Single turns have few swings, and rough roads small ones.
"""

import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import scipy

from controllers.trailer_steering.actuators import ActuatorFinding, Kind
from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.estimates import Motion, OffTracking
from estimators.off_tracking.signal_fusion import DIRECTION
from estimators.off_tracking.signal_monitor import Finding
from scenarios.results.log import Log
from vehicle.clock import TICK
from vehicle.frames import FloatArray

SWING: Final = math.radians(1.5)  # smallest swing that counts, from end to end [rad]: estimates' noise causes less
SWINGS: Final = 10  # in a row: five periods
LASTING: Final = 3.0  # time of oscillation, and of an angle at its limit, that is warned of [s]
_SLOWEST: Final = 2.5  # of a swing [s]: quicker than any course of turns
_REGULAR: Final = 0.25  # largest deviation of sizes and of durations over their mean; rough roads cause twice of it
_SUSTAINED: Final = 0.7  # size of the last swings over that of the first ones; transients die out faster
_AT_LIMIT: Final = math.radians(0.1)  # distance from the limit [rad]
_AT_RATE: Final = 0.95  # share of the rate limit
_WINDOW: Final = 4.0  # in which the rate is at its limit for more than half of the time [s]
_OF_ROAD: Final = 4  # swings of the road meanwhile; with more of them it is the road that asks for the steer
_ROAD_SWING: Final = 0.005  # smallest swing of the road's curvature that counts [1/m]: half of a bend of 200 m


@dataclass(frozen=True, slots=True, kw_only=True)
class SteeredAxle:
    """A steered axle in the log."""

    signal: str  # its angle
    name: str  # for the reader
    limit: float  # [rad]
    rate_limit: float  # [rad/s]


class _Turning(NamedTuple):
    """A turning point of a signal."""

    row: int
    value: float


def steer_warnings(log: Log, axles: Sequence[SteeredAxle], road: FloatArray, tractor: FloatArray) -> tuple[str, ...]:
    """A line for every axle that oscillates or stays at a limit.

    Args:
        log: with a row every control period.
        axles: steered ones; those that are not in the log are skipped.
        road: centre line (n, 2) [m].
        tractor: its positions over time (rows, 2) [m].
    """
    if len(log) < 3:
        return ()
    time = log["time"]
    bends = _bends(road, tractor)
    return tuple(
        line
        for axle in axles
        if axle.signal in log
        for line in _of_axle(axle, time, np.nan_to_num(log[axle.signal]), bends)
    )


def _of_axle(axle: SteeredAxle, time: FloatArray, angle: FloatArray, bends: FloatArray) -> Iterator[str]:
    oscillation = _oscillation(time, angle, bends)
    if oscillation is not None:
        start, end, size, period = oscillation
        yield (
            f"{axle.name}: its steer oscillates from {start:.1f} to {end:.1f} s, {math.degrees(size):.1f} deg from "
            f"side to side with a period of {period:.2f} s; lower the gains of its law or the speed"
        )
    longest = _longest(time, np.abs(angle) >= axle.limit - _AT_LIMIT)
    if longest[1] - longest[0] >= LASTING:
        yield (
            f"{axle.name}: its steer is at the limit of {math.degrees(axle.limit):.0f} deg from {longest[0]:.1f} to "
            f"{longest[1]:.1f} s"
        )
    hurried = _hurried(time, angle, axle.rate_limit)
    if hurried is not None:
        yield (
            f"{axle.name}: its steer is at the rate limit of {math.degrees(axle.rate_limit):.0f} deg/s for more than "
            f"{0.5 * _WINDOW:g} s of {_WINDOW:g} s, from {hurried:.1f} s on"
        )


def _oscillation(time: FloatArray, angle: FloatArray, bends: FloatArray) -> tuple[float, float, float, float] | None:
    """Start and end [s], mean swing [rad] and period [s] of the first sustained oscillation; None without one."""
    points = _turnings(angle, SWING)
    at, values = time[[point.row for point in points]], np.array([point.value for point in points])
    last = 0
    for first in range(len(points) - SWINGS):
        last = max(last, first + SWINGS)
        while last < len(points) - 1 and at[last] - at[first] < LASTING:
            last += 1
        if not _is_sustained(at[first : last + 1], values[first : last + 1]):
            continue
        of_road = len(_turnings(bends[points[first].row : points[last].row + 1], _ROAD_SWING)) + 1
        if of_road > _OF_ROAD:
            continue
        while last < len(points) - 1 and _is_sustained(at[first : last + 2], values[first : last + 2]):
            last += 1
        size, duration = float(np.abs(np.diff(values[first : last + 1])).mean()), float(at[last] - at[first])
        return float(at[first]), float(at[last]), size, 2.0 * duration / (last - first)
    return None


def _is_sustained(at: FloatArray, values: FloatArray) -> bool:
    """True if these swings last, and are alike in size and duration."""
    sizes, durations = np.abs(np.diff(values)), np.diff(at)
    if len(sizes) < SWINGS or at[-1] - at[0] < LASTING or durations.max() > _SLOWEST:
        return False
    if sizes[-2:].mean() < _SUSTAINED * sizes[:2].mean():
        return False
    return all(float(parts.std()) <= _REGULAR * float(parts.mean()) for parts in (sizes, durations))


def _turnings(values: FloatArray, swing: float) -> list[_Turning]:
    """Turning points between swings of at least this size; the ends of the signal are none."""
    points: list[_Turning] = []
    low = high = _Turning(0, float(values[0]))
    rising: bool | None = None
    for row, value in enumerate(values.tolist()):
        if rising is not False and value > high.value:
            high = _Turning(row, value)
        if rising is not True and value < low.value:
            low = _Turning(row, value)
        if rising is not False and high.value - value >= swing:
            points.append(high)
            rising, low = False, _Turning(row, value)
        elif rising is not True and value - low.value >= swing:
            points.append(low)
            rising, high = True, _Turning(row, value)
    return points


def _bends(road: FloatArray, tractor: FloatArray) -> FloatArray:
    """Curvature of the road beside the tractor over time [1/m], (rows,)."""
    if len(road) < 5:
        return np.zeros(len(tractor))
    legs = np.diff(road, axis=0)
    headings = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    lengths = np.maximum(np.hypot(*legs.T), 1e-6)
    curvature = np.concatenate([[0.0], np.diff(headings) / (0.5 * (lengths[1:] + lengths[:-1])), [0.0]])
    _, nearest = scipy.spatial.KDTree(road).query(np.nan_to_num(tractor))
    beside: FloatArray = curvature[nearest]
    return beside


def _longest(time: FloatArray, holds: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> tuple[float, float]:
    """Start and end [s] of the longest stretch on which a condition holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    if not len(edges):
        return 0.0, 0.0
    starts, ends = edges[::2], edges[1::2] - 1
    k = int(np.argmax(time[ends] - time[starts]))
    return float(time[starts[k]]), float(time[ends[k]])


def _hurried(time: FloatArray, angle: FloatArray, limit: float) -> float | None:
    """Start [s] of the first window in which the rate is at its limit for more than half of the time."""
    step = float(np.median(np.diff(time)))
    count = round(_WINDOW / step)
    if len(time) <= count:
        return None
    quick = np.abs(np.diff(angle)) >= _AT_RATE * limit * np.diff(time)
    sums = np.convolve(quick, np.ones(count), mode="valid")
    rows = np.flatnonzero(sums > 0.5 * count)
    return float(time[rows[0]]) if len(rows) else None


_FEWEST: Final = 3  # motions; one or two may be a coincidence
_LATE: Final = 4.0  # delay that is warned of [standard deviations]
_LEAST_DELAY: Final = 1e-3  # the same [s]


def calibration_warnings(motions: Iterable[Motion | None], remedy: str) -> tuple[str, ...]:
    """A line for a calibration that is refuted, and one for images that are not taken at the same time.

    Args:
        motions: of one pair of cameras, in order; None where there is none.
        remedy: what turns on self-calibration, in words.
    """
    watched, refuted, late = 0, _Found(), _Found()  # an hour of motions is not held in memory
    for motion in motions:
        if isinstance(motion, SelfCalibratedMotion):
            watched += 1
            refuted = refuted.with_motion(motion) if motion.miscalibrated else refuted
            late = late.with_motion(motion) if abs(motion.right_delay) > _limit(motion) else late
    return (*_of_rotation(refuted, watched, remedy), *_of_delay(late))


class _Found(NamedTuple):
    """Motions of one kind: how many, and the last of them."""

    number: int = 0
    last: SelfCalibratedMotion | None = None

    def with_motion(self, motion: SelfCalibratedMotion) -> "_Found":
        """One more."""
        return _Found(self.number + 1, motion)


def _of_rotation(refuted: _Found, watched: int, remedy: str) -> Iterator[str]:
    if refuted.last is not None and refuted.number >= _FEWEST:
        angles = ", ".join(f"{name} {math.degrees(angle):.2f}" for name, angle in refuted.last.right_rotation.named())
        yield (
            f"the right camera is turned against its calibration by {angles} deg, which makes {refuted.number} of "
            f"{watched} motions degraded or lost; calibrate the cameras anew, or {remedy}"
        )


def _of_delay(late: _Found) -> Iterator[str]:
    if late.last is not None and late.number >= _FEWEST:
        delay, std = late.last.right_delay, late.last.right_delay_std
        yield (
            f"the right image is taken {1e3 * abs(delay):.1f} ms {'after' if delay > 0.0 else 'before'} the left one "
            f"(standard deviation {1e3 * std:.1f} ms); trigger both cameras together"
        )


def _limit(motion: SelfCalibratedMotion) -> float:
    return max(_LATE * motion.right_delay_std, _LEAST_DELAY)


_SOUND: Final[Kind] = "sound"
_MEANING: Final[Mapping[Kind, str]] = {
    "stuck": "stuck",
    "dead": "it returned to straight, without power",
    "slow": "slow",
    "offset": "an offset; corrected",
    "late": "late",
}


def actuator_warnings(findings: Sequence[ActuatorFinding]) -> Iterator[str]:
    """A line for every actuator: when it did not follow its demands, and why."""
    for axles in dict.fromkeys(finding.axles for finding in findings):
        name = ("axle " if len(axles) == 1 else "axles ") + " and ".join(map(str, axles))
        follows = "does not follow its demand" if len(axles) == 1 else "do not follow their demand"
        yield f"{name}: {follows} {'; '.join(_periods(f for f in findings if f.axles == axles))}"


def _periods(findings: Iterator[ActuatorFinding]) -> Iterator[str]:
    """Periods at fault; a kind that was named first and corrected later is not told."""
    begin, kind = 0, _SOUND
    for finding in findings:
        if kind == _SOUND:
            begin = finding.tick
        elif finding.kind == _SOUND:
            yield f"from {begin * TICK:.1f} s to {finding.tick * TICK:.1f} s ({_MEANING[kind]})"
        kind = finding.kind
    if kind != _SOUND:
        yield f"from {begin * TICK:.1f} s ({_MEANING[kind]})"


_OF_CAMERAS: Final = (
    "all axles contradict it, as of a left camera that was turned; its estimates have a larger standard deviation"
)


def signal_warnings(findings: Sequence[Finding]) -> Iterator[str]:
    """A line for every signal, with the times at which it was distrusted."""
    for signal in dict.fromkeys(finding.signal for finding in findings):
        reason = _OF_CAMERAS if signal == DIRECTION else "it contradicts the other signals; corrected"
        times = ", ".join(
            f"{'from' if finding.at_fault else 'to'} {finding.tick * TICK:.1f} s"
            for finding in findings
            if finding.signal == signal
        )
        yield f"{signal} distrusted {times.replace(', to', ' to')}: {reason}"


def doubt_warnings(estimates: Iterable[OffTracking], known: Container[str] = ()) -> Iterator[str]:
    """A line for every sensor that the estimates have doubted, but those whose names are ``known``."""
    findings: list[Finding] = []
    before: tuple[str, ...] = ()
    for estimate in estimates:
        for name in dict.fromkeys((*before, *estimate.doubts)):
            if (name in before) != (name in estimate.doubts) and name not in known:
                findings.append(Finding(estimate.tick, name, name in estimate.doubts))
        before = estimate.doubts
    yield from signal_warnings(findings)


def fault_warnings(faults: Iterable[tuple[str, float]], outcome: str | None, end: float) -> Iterator[str]:
    """A line for each fault, by kind and start [s], that had not begun when a completed run ended, ``end`` [s]."""
    for k, (kind, start) in enumerate(faults):
        if outcome == "completed" and start >= end:
            yield f"faults.{k} ({kind}): begins at {start:g} s, and the run was completed at {end:.1f} s"
