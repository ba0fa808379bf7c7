"""The buffer of a trailer that stands: noise that must not move it, a start that must not be missed, blind cameras."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from tests.estimators.body_drive import NOISE, disturbed, followed, motion
from vehicle.frames import FloatArray, rotation_zyx, transform

LENGTH = 8.0  # hitch to follow point [m]
SLIP = 0.2  # of the trailer on its way [rad]


def drive(speeds: FloatArray, seed: int = 0) -> list[BodyMotion]:
    """Motions at these speeds [m/s] along the x axis, each measured from the frame before with noise."""
    rng, covariance = np.random.default_rng(seed), NOISE @ NOISE.T
    direction = rotation_zyx(SLIP, 0.0, 0.0) @ np.array([1.0, 0.0, 0.0])
    exact = [transform(np.eye(3), 0.1 * v * direction) for v in speeds]
    measured = [disturbed(X, NOISE @ rng.standard_normal(6)) for X in exact]
    return [motion(k, k + 1, X, covariance=covariance) for k, X in enumerate(measured)]


def run(motions: list[BodyMotion]) -> tuple[BufferMemory, list[OffTracking]]:
    return followed(OffTrackingBuffer(LENGTH), motions)


ARRIVING = np.concatenate([np.full(40, 2.8), np.linspace(2.8, 0.0, 28)])  # braking at 1 m/s2
STARTING = np.concatenate([np.linspace(0.0, 2.8, 56), np.full(10, 2.8)])  # at 0.5 m/s2
STOP = len(ARRIVING)


def blind(motion: BodyMotion, since: int | None = None) -> BodyMotion:
    """The frame shows nothing; ``since``: of the frames before it only the one at that tick had shown anything."""
    return BodyMotion.lost(motion.tick, motion.previous_tick if since is None else since)


@pytest.mark.slow
def test_a_minute_at_a_stop_neither_moves_nor_fills_the_buffer() -> None:
    """A minute of noise: unwithheld it would walk 71 mm across and 2 mrad; here nothing comes of it."""
    stop = np.zeros(600)
    _, before = run(drive(ARRIVING))
    memory, results = run(drive(np.concatenate([ARRIVING, stop])))
    early, late = results[STOP + 20], results[-1]
    assert early.health is late.health is Health.OK
    assert early.value == pytest.approx(before[-1].value, abs=0.015)  # [m] the last motions, before it is clear
    assert late.value == pytest.approx(early.value, abs=0.010)  # [m] noise that passes the gate, if any does
    assert late.std == pytest.approx(early.std, rel=0.02)
    assert len(memory.samples) <= len(run(drive(ARRIVING))[0].samples) + 2
    assert np.array_equal(late.path[0], [0.0, 0.0])
    assert (late.v_x, late.v_y, late.yaw_rate) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("speeds", [STARTING, np.full(60, 0.08), np.full(60, -0.08)])
def test_way_of_a_start_is_not_lost(speeds: FloatArray) -> None:
    """After a stop a start at 0.5 m/s2, a creep at 8 cm/s and one backwards: all of what the motions say then."""
    motions = drive(np.concatenate([ARRIVING, np.zeros(300), speeds]))
    memory, results = run(motions)
    told = np.eye(4)
    for one in (*motions[:STOP], *motions[STOP + 300 :]):
        told = told @ one.X_PC
    # Up to 15 motions of 1.8 mm that were noise come along with the first that is not, and the last may be withheld.
    assert memory.samples[0].X_OS[0, 3] == pytest.approx(told[0, 3], abs=0.03)  # [m]
    assert results[STOP + 299].health is Health.OK


def test_frames_lost_at_a_stop_leave_no_trace() -> None:
    """Three dark frames, then one that is measured from the last good one: as if nothing had been."""
    motions = drive(np.concatenate([ARRIVING, np.zeros(60)]))
    since = motions[STOP + 20].tick
    dark = [*range(STOP + 21, STOP + 24)]
    faulty = [blind(motion, since) if k in dark else motion for k, motion in enumerate(motions)]
    faulty[STOP + 24] = replace(motions[STOP + 24], previous_tick=since)
    whole, result = run(motions)[1], run(faulty)[1]
    assert [result[k].health for k in dark] == [Health.LOST] * 3
    assert result[-1].health is Health.OK
    assert result[-1].value == pytest.approx(whole[-1].value, abs=0.005)  # [m] one motion less was drawn
    assert result[-1].std == pytest.approx(whole[-1].std, rel=0.02)


@pytest.mark.parametrize(("seconds", "low", "high"), [(1.5, 0.03, 0.15), (4.0, 0.5, 2.0)])
def test_longer_blackout_at_a_stop_keeps_the_path_with_doubt(seconds: float, low: float, high: float) -> None:
    """Standstill before and after a loss: the longer it lasts, the more likely the trailer has moved."""
    motions = drive(np.concatenate([ARRIVING, np.zeros(120)]))
    first, last = STOP + 20, STOP + 20 + round(10 * seconds)
    faulty = [blind(motion) if first <= k < last else motion for k, motion in enumerate(motions)]
    results = run(faulty)[1]
    assert results[last - 1].health is Health.LOST
    assert results[-1].health is Health.DEGRADED
    assert results[-1].value == pytest.approx(results[first - 1].value, abs=0.005)
    assert low < results[-1].std < high


def test_blackout_that_ends_in_motion_begins_a_new_path() -> None:
    """Standstill, then walking pace after two seconds of loss: the distance between is unknown."""
    motions = drive(np.concatenate([ARRIVING, np.zeros(40), np.full(60, 1.5)]))
    faulty = [blind(motion) if STOP + 30 <= k < STOP + 50 else motion for k, motion in enumerate(motions)]
    results = run(faulty)[1]
    assert results[STOP + 29].health is Health.OK
    assert results[STOP + 51].health is Health.LOST


def test_a_motion_that_is_hardly_known_is_no_standstill() -> None:
    """Zero as measured, give or take half a metre: that must count in the standard deviation."""
    motions = drive(np.concatenate([ARRIVING, np.zeros(40)]))
    vague = np.diag([1e-2, 1e-2, 1e-2, 0.5, 0.5, 0.5]) ** 2
    motions[STOP + 30] = replace(motions[STOP + 30], X_PC=np.eye(4), covariance=vague, health=Health.DEGRADED)
    results = run(motions)[1]
    assert results[-1].health is Health.DEGRADED
    assert results[-1].std > 0.4


def test_an_occluder_that_looks_like_a_standstill_stays_doubted() -> None:
    """At full speed a motion of zero from a minority of matches: degraded it was, degraded the path behind it is."""
    motions = drive(np.full(80, 2.8))
    motions[60] = replace(motions[60], X_PC=np.eye(4), health=Health.DEGRADED)
    assert run(motions)[1][-1].health is Health.DEGRADED
