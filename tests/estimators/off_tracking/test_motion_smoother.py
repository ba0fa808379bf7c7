"""The Kalman filter of the motions: consistent where its model holds, without lag, deaf to single outliers."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, OffTrackingBuffer
from estimators.off_tracking.motion_smoother import Moments, started, updated
from estimators.rigid_motion import UncertainMotion
from tests.estimators.body_drive import FRAME, NOISE, anchored_motions, disturbed, followed, motion
from vehicle.frames import FloatArray, rotation_zyx, transform

LENGTH = 14.0  # hitch to follow point [m]
SPAN = 0.1  # [s]


def moved(yaw: float, x: float, y: float) -> FloatArray:
    """The pose after a motion at constant velocities, in the frame before."""
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return transform(rotation_zyx(yaw, 0.0, 0.0), np.array([c * x - s * y, s * x + c * y, 0.0]))


class Turn(NamedTuple):
    """A turn of the trailer: true motions between frames."""

    motions: list[FloatArray]
    velocities: FloatArray  # (n, 3) yaw rate [rad/s], v_x, v_y [m/s] in the middle of every motion


def turn(frames: int = 220) -> Turn:
    """At 10 km/h into a bend and out, the trailer swinging at its hitch: as smooth as tractors steer."""
    t = SPAN * (np.arange(frames) + 0.5)
    yaw_rate = 0.2 / (1.0 + np.exp(-(t - 9.0) / 0.7)) - 0.2 / (1.0 + np.exp(-(t - 16.0) / 0.7))
    v_y = 0.9 / (1.0 + np.exp(-(t - 8.0) / 0.7)) - 0.9 / (1.0 + np.exp(-(t - 14.5) / 0.7))
    velocities = np.column_stack([yaw_rate, np.full(frames, 2.8), v_y])
    return Turn([moved(*(SPAN * v)) for v in velocities], velocities)


def tracked(motions: list[BodyMotion], *, smoothing: bool) -> list[OffTracking]:
    return followed(OffTrackingBuffer(LENGTH, smoothing=smoothing), motions)[1]


def measured(true: list[FloatArray], rng: np.random.Generator, noise: FloatArray) -> list[BodyMotion]:
    """Each from the frame before, with errors ``noise`` n."""
    found = [disturbed(X, noise @ rng.standard_normal(6)) for X in true]
    return [motion(k, k + 1, X, covariance=noise @ noise.T) for k, X in enumerate(found)]


def values(results: list[OffTracking]) -> FloatArray:
    return np.array([result.value if result.health is not Health.LOST else np.nan for result in results])


def test_innovations_and_velocities_are_as_uncertain_as_stated() -> None:
    """Motions drawn from the model itself: both squared normalised errors have a mean of their three degrees."""
    rng, scores, errors = np.random.default_rng(1), [], []
    q = np.array([0.05, 1.5, 0.4])  # the model's jerk
    t = SPAN
    Q = np.array([[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]])
    F, root = np.array([[1.0, t, t**2 / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]]), np.linalg.cholesky(Q)
    for _ in range(12):
        state = np.zeros((3, 3))  # way, velocity, acceleration by yaw, x, y
        state[1] = [0.1, 2.8, 0.2]
        moments: Moments = ()
        for k in range(50):
            state = F @ np.vstack([np.zeros(3), state[1:]]) + root @ rng.standard_normal((3, 3)) * q
            X = disturbed(moved(*state[0]), NOISE @ rng.standard_normal(6))
            motion = UncertainMotion(X, NOISE @ NOISE.T)
            if not moments:
                moments = started(0, np.eye(4), motion, SPAN)
                continue
            moments = updated(moments, FRAME * k, motion, SPAN, anchored=False)
            if k > 15:
                newest = moments[-1]
                scores.append(newest.score)
                off = newest.state[3:6] - state[1]
                errors.append(off @ np.linalg.solve(newest.covariance[3:6, 3:6], off))
    assert np.mean(scores) == pytest.approx(3.0, abs=0.4)  # 420 innovations with a spread of sqrt(6): three sigma
    assert np.mean(errors) == pytest.approx(3.0, abs=0.9)  # neighbours belong together: some 100 independent ones
    assert np.mean(np.array(scores) > 16.27) < 0.01  # one in a thousand, and the gate lets them be


def test_smoothing_does_not_lag() -> None:
    """Exact motions of a turn with the covariance of noisy ones: value and rate stay those of the same tick."""
    true = turn()
    exact = tracked(measured(true.motions, np.random.default_rng(0), np.zeros((6, 6))), smoothing=False)
    motions = measured(true.motions, np.random.default_rng(0), np.zeros((6, 6)))
    told = [replace(motion, covariance=NOISE @ NOISE.T) for motion in motions]
    smooth = tracked(told, smoothing=True)
    e, estimate = values(exact), values(smooth)
    there = np.flatnonzero(np.isfinite(e) & np.isfinite(estimate))
    assert np.ptp(e[there]) > 1.0  # [m] the case turns
    shifts = np.linspace(-0.05, 0.05, 51)  # [s]
    ticks = SPAN * there
    costs = [
        np.mean((np.diff(estimate[there]) - np.diff(np.interp(ticks - shift, ticks, e[there])))[2:-2] ** 2)
        for shift in shifts
    ]
    assert abs(shifts[int(np.argmin(costs))]) <= 0.010  # [s]
    assert np.abs(estimate - e)[there].max() < 0.004  # [m] nothing is smoothed away that was there


@pytest.mark.slow
def test_smoothing_quietens_the_rate_without_costing_the_value() -> None:
    """White errors of the motions: noise in the rates goes, and the value has no more error than before."""
    true = turn(320)
    exact = values(tracked(measured(true.motions, np.random.default_rng(0), np.zeros((6, 6))), smoothing=False))
    rates, errors, turns = [], [], []
    for seed in range(3):
        motions = measured(true.motions, np.random.default_rng(seed), NOISE)
        both = [tracked(motions, smoothing=smoothing) for smoothing in (False, True)]
        off = [(values(results) - exact)[np.isfinite(exact)] for results in both]
        rates.append([np.std(np.diff(error)[1:]) for error in off])
        errors.append([np.sqrt(np.mean(error[1:] ** 2)) for error in off])
        turns.append([np.std([r.v_y - v[2] for r, v in zip(b, true.velocities, strict=True)][20:]) for b in both])
    raw, smooth = np.mean(rates, axis=0)
    assert smooth < 0.9 * raw
    assert np.mean(errors, axis=0)[1] < 1.02 * np.mean(errors, axis=0)[0]
    assert np.mean(turns, axis=0)[1] < 0.9 * np.mean(turns, axis=0)[0]


@pytest.mark.slow
def test_single_outlier_is_passed_over() -> None:
    """A frame full of biased matches turns one motion by 6 mrad: 80 mm over the trailer, were it believed."""
    true = turn()
    motions = measured(true.motions, np.random.default_rng(3), NOISE)
    wild = list(motions)
    wild[150] = replace(wild[150], X_PC=disturbed(wild[150].X_PC, np.array([0.0, 0.0, 6e-3, 0.0, 0.0, 0.0])))
    without, believed, passed_over = (
        values(tracked(which, smoothing=smoothing))
        for which, smoothing in ((motions, True), (wild, False), (wild, True))
    )
    assert np.abs(believed - without)[151:170].max() > 0.06  # [m]
    assert np.abs(passed_over - without)[151:170].max() < 0.02


def test_manoeuvre_sharper_than_the_model_is_believed_in_the_end() -> None:
    """From one frame to the next the yaw rate is another: the first such motion is an outlier, the second is not."""
    velocities = np.column_stack([np.zeros(160), np.full(160, 2.8), np.zeros(160)])
    velocities[120:, 0] = 0.15
    true = [moved(*(SPAN * v)) for v in velocities]
    exact = tracked(measured(true, np.random.default_rng(0), np.zeros((6, 6))), smoothing=False)
    smooth = tracked(measured(true, np.random.default_rng(4), NOISE), smoothing=True)
    assert smooth[128].yaw_rate == pytest.approx(0.15, abs=0.02)
    off = values(smooth) - values(exact)
    assert np.abs(off[135:]).max() < 0.06  # [m] the errors of fifty motions, and no more than half a turn unseen


@pytest.mark.slow
def test_poses_measured_from_a_keyframe_are_smoothed_as_such() -> None:
    """Each pose errs anew against its keyframe: a quarter of the noise in the rate goes."""
    true, rng = turn(), np.random.default_rng(6)
    own, poses = 0.3 * NOISE, [np.eye(4)]
    for X in true.motions:
        poses.append(poses[-1] @ X)
    motions = anchored_motions(poses, lambda k: 6 * ((k - 1) // 6), lambda: own @ rng.standard_normal(6), own @ own.T)
    exact = values(tracked(measured(true.motions, rng, np.zeros((6, 6))), smoothing=False))
    raw, smooth = (np.diff(values(tracked(motions, smoothing=s)) - exact) for s in (False, True))
    assert np.nanstd(smooth) < 0.75 * np.nanstd(raw)


def test_smoothing_survives_lost_frames_stops_and_going_back() -> None:
    """Dark frames, a stop and a way back in one drive: the path goes on, and the value is the truth's."""
    speeds = np.concatenate([np.full(70, 2.8), np.linspace(2.8, 0.0, 28), np.zeros(30), np.full(30, -1.0), np.zeros(9)])
    speeds = np.concatenate([speeds, np.linspace(0.0, 2.8, 30), np.full(30, 2.8)])
    direction = np.array([math.cos(0.2), math.sin(0.2)])
    true = [moved(0.0, *(SPAN * v * direction)) for v in speeds]
    motions = measured(true, np.random.default_rng(8), NOISE)
    for k in (40, 41):
        motions[k] = BodyMotion.lost(motions[k].tick, motions[40].previous_tick)
    across = disturbed(true[40] @ true[41] @ true[42], NOISE @ np.ones(6))
    motions[42] = replace(motions[42], previous_tick=motions[40].previous_tick, X_PC=across)
    results = tracked(motions, smoothing=True)
    for result in results[75:]:
        assert result.health is Health.OK
        assert result.value == pytest.approx(-LENGTH * math.tan(0.2), abs=4.0 * result.std)
