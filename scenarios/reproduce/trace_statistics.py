"""How good a slip estimator is that watches a wheel's trace: the rates of Reina 2008, Table III, and errors of slip.

Every image falls into one of three kinds by what is really in it. It is *with a trace* if the wheel's own imprint
covers at least ``WITH`` of the ground in view behind the wheel, *without* if at most ``WITHOUT``. Between them a trace
begins or ends: such images count for nothing, as nobody can say what the right answer is.

- False positive: an image without a trace, and an estimate. In percent of the images without.
- False negative: an image with a trace, and no estimate. In percent of the images with.
- Misidentification: an image with a trace and an estimate whose line lies elsewhere: over the trace in view it is on
  average farther than half a wheel's width from the middle of the rut, so that most of it is off the rut. In percent
  of the images with. (Judging the angle instead would call good lines wrong wherever the trace is curved.)

Errors of the slip angle are taken against that of the body at the very moment, over the images with a trace where it
was identified; ``detected_rms`` has the misidentified ones in it, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from estimators.estimates import Health, SlipAngle
from sensors.sand.trace import TraceTruth
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray, wrap

WITH: Final = 0.8  # share of the visible length from which there is a trace to be seen
WITHOUT: Final = 0.1  # share up to which there is none
SIGMAS: Final = 2.5  # within which 95 % of the errors shall be (98.8 % of a Gaussian's are)
_LEAST_STD: Final = 1e-9  # below which a standard deviation says: exact [rad]


class Judgement(NamedTuple):
    """One estimate beside the truth; errors are NaN where there is nothing to compare."""

    present: bool | None  # whether there is a trace; None: one that begins or ends
    detected: bool
    misplaced: bool  # the estimate's line lies elsewhere than the trace
    error: float  # of the slip angle [rad]
    sigmas: float  # the same over the stated standard deviation [-]
    lagged_error: float  # of the later, better estimate of an earlier moment [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceStatistics:
    """Rates in percent and errors of the slip angle, NaN where there was nothing to judge."""

    frames: int
    without: int  # images without a trace
    present: int  # images with one
    false_positives: float  # of the images without [%]
    false_negatives: float  # of the images with [%]
    misidentified: float  # of the images with [%]
    rms: float  # of the identified [rad]
    detected_rms: float  # of all images with a trace and an estimate [rad]
    bias: float  # mean error of the identified [rad]
    lagged_rms: float  # [rad]
    within: float  # share of the identified within ``SIGMAS`` standard deviations [%]


def judged(
    estimates: Sequence[SlipAngle], truths: Sequence[TraceTruth], rig: TraceRig, steer: Sequence[float] | None = None
) -> list[Judgement]:
    """Every estimate of a sequence beside the truth of the same image.

    ``steer`` is, at every image, the angle of the watched wheel that its slip angle is stated against, + left [rad];
    None: always straight.

    Raises:
        ValueError: if they do not belong together.
    """
    steer = [0.0] * len(truths) if steer is None else steer
    if [estimate.tick for estimate in estimates] != [truth.tick for truth in truths] or len(steer) != len(truths):
        raise ValueError(f"{len(estimates)} estimates, {len(truths)} truths, {len(steer)} angles: ticks must be equal")
    slips = {truth.tick: truth.slip_angle for truth in truths}
    return [
        _judgement(estimate, truth, angle, rig, slips)
        for estimate, truth, angle in zip(estimates, truths, steer, strict=True)
    ]


def statistics(judgements: Iterable[Judgement]) -> TraceStatistics:
    """Rates and errors over all the judgements, of one sequence or of many."""
    table = list(judgements)
    absent = [one for one in table if one.present is False]
    present = [one for one in table if one.present]
    seen = [one for one in present if one.detected]
    right = [one for one in seen if not one.misplaced]
    errors = np.array([one.error for one in right])
    return TraceStatistics(
        frames=len(table),
        without=len(absent),
        present=len(present),
        false_positives=_percent(sum(one.detected for one in absent), len(absent)),
        false_negatives=_percent(len(present) - len(seen), len(present)),
        misidentified=_percent(len(seen) - len(right), len(present)),
        rms=_rms(errors),
        detected_rms=_rms(np.array([one.error for one in seen])),
        bias=float(errors.mean()) if len(errors) else math.nan,
        lagged_rms=_rms(np.array([one.lagged_error for one in right])),
        within=_percent(sum(abs(one.sigmas) <= SIGMAS for one in right), len(right)),
    )


def line_distance(slip: float, offset: float, truth: TraceTruth, rig: TraceRig) -> float:
    """Mean distance [m], across the rover, of a straight line from the middle of the rut where there is one.

    The line passes ``offset`` to the left of the wheel, and the wheel came along it from the direction ``slip`` [rad]
    in R.
    """
    x, y = truth.line[truth.there].T
    line = rig.wheel[1] + offset + math.tan(slip) * (x - rig.wheel[0])
    return float(np.abs(line - y).mean()) if len(x) else math.inf


def _judgement(
    estimate: SlipAngle, truth: TraceTruth, steer: float, rig: TraceRig, slips: dict[int, float]
) -> Judgement:
    share = truth.share
    present = True if share >= WITH else False if share <= WITHOUT else None
    if estimate.health is Health.LOST:
        return Judgement(present, False, False, math.nan, math.nan, math.nan)
    off = line_distance(estimate.wheel_slip + steer, estimate.trace_offset, truth, rig)
    error = wrap(estimate.value - truth.slip_angle)
    earlier = None if estimate.lagged_tick is None else slips.get(estimate.lagged_tick)
    return Judgement(
        present=present,
        detected=True,
        misplaced=off > 0.5 * rig.wheel_width,
        error=error,
        sigmas=error / max(estimate.std, _LEAST_STD),
        lagged_error=math.nan if earlier is None else wrap(estimate.lagged_value - earlier),
    )


def _percent(count: int, of: int) -> float:
    return 100.0 * count / of if of else math.nan


def _rms(errors: FloatArray) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan
