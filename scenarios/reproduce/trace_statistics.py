"""Quality of a slip estimator that watches a wheel's trace: the rates of Reina 2008, Table III, and slip errors.

Every image belongs to one of three kinds, by its true content. It is *with a trace* if the wheel's own imprint covers
at least ``WITH`` of the visible ground behind the wheel, *without* if at most ``WITHOUT``. Between them a trace begins
or ends; such images are not counted, as there is no single right answer.

- False positive: an image without a trace, but an estimate. In percent of the images without.
- False negative: an image with a trace, but no estimate. In percent of the images with.
- Misidentification: an image with a trace, and an estimate whose mean distance from the middle of the visible rut
  exceeds half a wheel's width, so that most of the line is off the rut. In percent of the images with. (A criterion on
  the angle would reject good lines wherever the trace is curved.)

Errors of the slip angle are relative to the body's slip angle at the time of the image, over the images with an
identified trace.
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

WITH: Final = 0.8  # smallest share of the visible length of an image with a trace
WITHOUT: Final = 0.1  # largest share of an image without
SIGMAS: Final = 2.5  # bound for 95 % of the errors, in standard deviations (98.8 % of Gaussian errors are within)
_LEAST_STD: Final = 1e-9  # smaller standard deviations mean exact [rad]


class Judgement(NamedTuple):
    """Comparison of one estimate with the truth; errors are NaN where there is nothing to compare."""

    present: bool | None  # True: with a trace; None: it begins or ends
    detected: bool
    misplaced: bool  # True if the line of the estimate is off the trace
    error: float  # of the slip angle [rad]
    sigmas: float  # error over the stated standard deviation [-]
    lagged_error: float  # of the later, better estimate of an earlier slip angle [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceStatistics:
    """Rates in percent and errors of the slip angle; NaN where there is no image to count."""

    frames: int
    without: int  # images without a trace
    present: int  # images with one
    false_positives: float  # of the images without [%]
    false_negatives: float  # of the images with [%]
    misidentified: float  # of the images with [%]
    rms: float  # of the identified [rad]
    bias: float  # mean error of the identified [rad]
    lagged_rms: float  # [rad]
    within: float  # share of the identified within ``SIGMAS`` standard deviations [%]


def judged(
    estimates: Sequence[SlipAngle], truths: Sequence[TraceTruth], rig: TraceRig, steer: Sequence[float] | None = None
) -> list[Judgement]:
    """Compare every estimate of a sequence with the truth at the same image.

    ``steer`` is the steer angle of the watched wheel at every image, + left [rad]; None: always straight.

    Raises:
        ValueError: if numbers or ticks differ.
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
    """Rates and errors over judgements of one or several sequences."""
    table = list(judgements)
    absent = [one for one in table if one.present is False]
    present = [one for one in table if one.present]
    detected = [one for one in present if one.detected]
    identified = [one for one in detected if not one.misplaced]
    errors = np.array([one.error for one in identified])
    return TraceStatistics(
        frames=len(table),
        without=len(absent),
        present=len(present),
        false_positives=_percent(sum(one.detected for one in absent), len(absent)),
        false_negatives=_percent(len(present) - len(detected), len(present)),
        misidentified=_percent(len(detected) - len(identified), len(present)),
        rms=_rms(errors),
        bias=float(errors.mean()) if len(errors) else math.nan,
        lagged_rms=_rms(np.array([one.lagged_error for one in identified])),
        within=_percent(sum(abs(one.sigmas) <= SIGMAS for one in identified), len(identified)),
    )


def line_distance(slip: float, offset: float, truth: TraceTruth, rig: TraceRig) -> float:
    """Mean lateral distance [m] of a straight line from the middle of the visible rut.

    The line passes ``offset`` [m] to the left of the wheel, and its direction in R is ``slip`` [rad].
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
    distance = line_distance(estimate.wheel_slip + steer, estimate.trace_offset, truth, rig)
    error = wrap(estimate.value - truth.slip_angle)
    earlier = None if estimate.lagged_tick is None else slips.get(estimate.lagged_tick)
    return Judgement(
        present=present,
        detected=True,
        misplaced=distance > 0.5 * rig.wheel_width,
        error=error,
        sigmas=error / max(estimate.std, _LEAST_STD),
        lagged_error=math.nan if earlier is None else wrap(estimate.lagged_value - earlier),
    )


def _percent(count: int, of: int) -> float:
    return 100.0 * count / of if of else math.nan


def _rms(errors: FloatArray) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan
