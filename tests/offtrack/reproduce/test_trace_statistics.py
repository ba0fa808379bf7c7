"""Rates and errors of slip estimators on made-up verdicts whose numbers are known."""

import math

import numpy as np
import pytest

from estimators.estimates import Health, SlipAngle
from offtrack.studies.reproduce.trace_tables import Judgement, compared_with_truth, line_distance, statistics
from sensors.sand.trace_rig import nominal_rig
from sensors.sand.world import TraceTruth
from vehicle.rover.description import load_rover

RIG = nominal_rig(load_rover("el_dorado_ii"))
BEHIND = np.arange(0.12, 0.61, 0.02)


def truth(tick: int, share: float, slip: float = 0.1) -> TraceTruth:
    """A straight trace of which a share is there, nearest to the wheel first."""
    x, y = RIG.wheel
    return TraceTruth(
        tick=tick,
        line=np.stack([x - BEHIND, y - math.tan(slip) * BEHIND], axis=-1),
        there=np.arange(len(BEHIND)) < share * len(BEHIND),
        slip_angles=np.full(len(BEHIND), slip),
        wheel_slip=slip,
        slip_angle=slip,
    )


def estimate(tick: int, slip: float = 0.1, offset: float = 0.0, health: Health = Health.OK) -> SlipAngle:
    return SlipAngle(
        tick=tick,
        value=slip,
        std=0.02,
        health=health,
        wheel_slip=slip,
        trace_offset=offset,
        confidence=0.8,
        lagged_tick=tick - 200,
        lagged_value=slip,
        lagged_std=0.01,
    )


def one(there: TraceTruth, guess: SlipAngle) -> Judgement:
    return compared_with_truth([guess], [there], RIG)[0]


def test_estimates_without_a_trace_and_traces_without_an_estimate_are_counted() -> None:
    """One of two images without a trace has an estimate, a degraded one is used too; one of four is not seen."""
    bare = [truth(0, 0.0), truth(200, 0.0)]
    for health in (Health.OK, Health.DEGRADED):
        table = compared_with_truth([estimate(0, health=health), estimate(200, health=Health.LOST)], bare, RIG)
        assert (statistics(table).without, statistics(table).false_positives) == (2, 50.0)
    table = [one(truth(k, 1.0), estimate(k, health=Health.LOST if k == 0 else Health.OK)) for k in range(4)]
    assert statistics(table).false_negatives == 25.0


def test_trace_that_begins_or_ends_counts_for_nothing() -> None:
    """Half a trace is neither with nor without: whatever is said of it, no rate changes."""
    table = [one(truth(0, 0.5), estimate(0)), one(truth(0, 0.5), estimate(0, health=Health.LOST))]
    got = statistics(table)
    assert (got.frames, got.without, got.present) == (2, 0, 0)
    assert math.isnan(got.false_positives)
    assert math.isnan(got.rms)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_line_beside_the_rut_is_a_misidentification(side: float) -> None:
    """The limit is half a wheel's width to either side, and a misplaced line is not in the error of the right ones."""
    near, far = (side * (0.5 * RIG.wheel_width + d) for d in (-1e-6, 1e-6))
    table = [one(truth(0, 1.0), estimate(0, offset=near)), one(truth(0, 1.0), estimate(0, 0.1, offset=far))]
    assert [case.misplaced for case in table] == [False, True]
    assert statistics(table).misidentified == 50.0


def test_line_is_judged_where_the_rut_is_not_by_its_angle_alone() -> None:
    """A line from the wheel that is 0.05 rad off leaves the rut by 0.36 m times that on average: still on it."""
    off = line_distance(0.15, 0.0, truth(0, 1.0), RIG)
    assert off == pytest.approx((math.tan(0.15) - math.tan(0.1)) * BEHIND.mean(), rel=1e-9)  # rounding


def test_errors_are_taken_at_their_own_moments() -> None:
    """Now against now; the later, better estimate against the slip that was at its moment.

    RMS of 3 and -1, one of them beyond 2.5 standard deviations. An estimate belongs to the image it was made of.
    """
    truths = [truth(0, 1.0, slip=0.12), truth(200, 1.0, slip=0.10)]
    got = compared_with_truth([estimate(0, 0.12), estimate(200, 0.13)], truths, RIG)[1]
    assert (got.error, got.lagged_error, got.sigmas) == pytest.approx((0.03, 0.01, 1.5))
    table = [Judgement(True, True, False, error, sigmas, error) for error, sigmas in ((3.0, 2.6), (-1.0, -2.4))]
    found = statistics(table)
    assert (found.rms, found.lagged_rms, found.within) == pytest.approx((math.sqrt(5.0), math.sqrt(5.0), 50.0))
    with pytest.raises(ValueError, match="ticks must be equal"):
        compared_with_truth([estimate(0)], [truth(200, 1.0)], RIG)
