"""Covariances: what halves of the features tell about them, and the features' own residuals."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Anchor, Health, lost_motion
from estimators.odometry.agreement import agreement, halved
from estimators.odometry.covariance import (
    INDEPENDENT,
    Contributions,
    SelfConsistency,
    Sums,
    estimated,
    factors,
    own_part,
    stated,
    summed,
    updated,
)
from estimators.odometry.pose import CORRELATION, Observations, Solution, point_covariance, refined
from estimators.stereo_pair import project, triangulate
from scenarios.catalogue import ODOMETRY, resolve
from sensors.camera.rig import StereoCalibration
from tests.estimators.odometry.test_pose import MOTION, STD, VARIANCE, error, images, points_ahead
from tests.estimators.stereo_scene import Drive
from vehicle.frames import FloatArray, transform

FOCAL_LENGTH = 564.0  # [px]
AHEAD = np.array([0.0, 0.0, 1.0])  # [m]


def differences(calibration: StereoCalibration, seed: int, common: FloatArray, wrong: float) -> FloatArray:
    """Differences between halves for a motion of 1 m, with noise and images on the left shifted by ``common`` [px].

    All disparities, before and after, are wrong by ``wrong`` [px], as those of a turned camera.
    """
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-8, 8, 400), rng.uniform(-1, 3, 400), rng.uniform(6, 40, 400)])
    before, after = project(calibration, points), project(calibration, points - AHEAD)
    z = after + STD * np.sqrt(VARIANCE) * rng.standard_normal(after.shape)
    z[after[:, 0] < calibration.cx] += common
    for pixels in (before, z):
        pixels[:, 2] -= wrong
    variance = np.broadcast_to(STD**2 * VARIANCE, z.shape)
    measured = triangulate(calibration, before)
    seen = Observations(measured, 1e-6 * point_covariance(calibration, measured, variance), z, variance)
    return refined(calibration, seen, transform(np.eye(3), AHEAD), np.ones(len(points), np.bool_)).differences


def averaged(calibration: StereoCalibration, common: FloatArray, wrong: float, frames: int = 30) -> SelfConsistency:
    consistency = SelfConsistency()
    for seed in range(frames):
        consistency = updated(consistency, differences(calibration, seed, common, wrong))
    return consistency


def test_independent_errors_need_no_factor_for_neighbours(calibration: StereoCalibration) -> None:
    """30 frames: the first doubt has faded, and single components scatter by a fifth."""
    by, _ = factors(averaged(calibration, np.zeros(3), 0.0))
    assert np.all((by >= math.sqrt(INDEPENDENT)) & (by < 1.3))


def test_the_doubt_of_the_first_frames_fades(calibration: StereoCalibration) -> None:
    """One frame says little: the standard deviation counts as 1.1 to 1.6 times as large, and later as stated."""
    first, later = (factors(averaged(calibration, np.zeros(3), 0.0, frames))[0] for frames in (1, 10))
    assert np.all((first > 1.1) & (first < 1.6))
    assert later.mean() < 0.9 * first.mean()


def test_wrong_poses_of_old_keyframes_are_seen(calibration: StereoCalibration) -> None:
    """Points of old keyframes seem to be turned: left, right, near and far points are so alike."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-8, 8, 400), rng.uniform(-1, 3, 400), rng.uniform(6, 40, 400)])
    newest = rng.random(400) < 0.5
    z = project(calibration, points - AHEAD) + STD * np.sqrt(VARIANCE) * rng.standard_normal((400, 3))
    z[~newest] += [2.0 * STD, 0.0, 2.0 * STD]
    variance = np.broadcast_to(STD**2 * VARIANCE, z.shape)
    seen = Observations(points, 1e-6 * point_covariance(calibration, points, variance), z, variance)
    halves = refined(calibration, seen, transform(np.eye(3), AHEAD), np.ones(400, np.bool_), newest).differences
    assert np.abs(halves[2, 1]) > 3.0
    assert np.abs(halves[:2, 1]).max() < 2.5


def test_unknown_differences_change_nothing() -> None:
    differences = np.ones((3, 6))
    differences[2] = np.nan
    consistency = updated(updated(SelfConsistency(), differences), differences)
    assert consistency.frames.tolist() == [2.0, 2.0, 0.0]
    assert np.all(consistency.square[:2] == 1.0)
    assert np.all(consistency.square[2] == 0.0)


def test_a_shift_of_one_half_is_seen_between_left_and_right(calibration: StereoCalibration) -> None:
    """One noise, but the same for 200 features: 14 standard deviations of their mean; it moves yaw."""
    consistency = averaged(calibration, np.array([STD, 0.0, STD]), 0.0)
    assert np.sqrt(consistency.square[0, 1]) > 2.0
    assert factors(consistency)[0][1] > 2.0
    assert np.abs(consistency.mean[0, 1]) > 0.8 * np.sqrt(consistency.square[0, 1])


def test_a_wrong_disparity_is_seen_between_near_and_far(calibration: StereoCalibration) -> None:
    """All disparities wrong by 0.5 px, as by a camera turned by 0.05 deg: far points seem to move by more."""
    consistency = averaged(calibration, np.zeros(3), 0.5)
    assert np.sqrt(consistency.square[1, 5]) > 2.0
    assert factors(consistency)[0][5] > 2.5


def test_a_difference_between_two_halves_lasts_and_chance_does_not(calibration: StereoCalibration) -> None:
    """One of two kinds of halves shows it to one side, so half of its variance lasts, but for what chance may make."""
    consistency, scattered = averaged(calibration, np.array([STD, 0.0, STD]), 0.0), SelfConsistency()
    for seed in range(40):  # to either side from frame to frame: the mean is no larger than chance makes it
        sign = 1.0 if seed % 2 else -1.0
        scattered = updated(
            scattered, differences(calibration, seed, sign * np.array([0.5 * STD, 0.0, 0.5 * STD]), 0.0)
        )
    lasting = factors(consistency)[1][1] / abs(consistency.mean[0, 1])
    assert 0.4 < lasting < math.sqrt(0.5)
    assert factors(scattered)[1][1] < 0.2


@pytest.mark.parametrize("anchored", [False, True])
def test_stated_covariances_are_scaled_and_keep_their_correlations(anchored: bool) -> None:
    """Of the motion and of its pose from the anchor, and the part of both that lasts; a lost motion stays lost."""
    P = np.diag(np.full(6, 4e-6)) + 1e-6
    anchor = Anchor(tick=0, X_AC=np.eye(4), covariance=2.0 * P) if anchored else None
    motion = replace(lost_motion(100, 0), covariance=P, health=Health.OK, anchor=anchor, halves=np.full((3, 6), 3.0))
    consistency = SelfConsistency(np.full(3, 100.0), np.full((3, 6), 3.0), np.full((3, 6), 9.0))  # always to one side
    consistency, told = stated(consistency, motion, FOCAL_LENGTH)
    by, lasting = factors(consistency)
    assert np.all(by > 2.0)
    correlation = told.covariance[3, 5] / np.sqrt(told.covariance[3, 3] * told.covariance[5, 5])
    assert correlation == pytest.approx(P[3, 5] / P[3, 3])
    assert np.sqrt(told.covariance[5, 5] / P[5, 5]) == pytest.approx(by[5])
    np.testing.assert_allclose(told.common @ told.common.T, P * np.outer(lasting, lasting))
    if anchored:
        assert told.anchor is not None
        assert told.anchor.covariance[5, 5] == pytest.approx(2.0 * told.covariance[5, 5])
    lost = lost_motion(200, 100)
    assert stated(consistency, lost, FOCAL_LENGTH) == (consistency, lost)


def test_an_error_common_to_all_features_turns_the_camera() -> None:
    """0.01 px in both images of a motion, and half of its variance since the keyframe; no translation."""
    anchor = Anchor(tick=0, X_AC=np.eye(4), covariance=np.zeros((6, 6)))
    motion = replace(lost_motion(100, 0), covariance=np.zeros((6, 6)), health=Health.OK, anchor=anchor)
    _, told = stated(SelfConsistency(), motion, FOCAL_LENGTH)
    expected = np.diag([(0.01 / FOCAL_LENGTH) ** 2] * 2 + [0.0] * 4)
    np.testing.assert_allclose(told.covariance, 2.0 * expected)
    assert told.anchor is not None
    np.testing.assert_allclose(told.anchor.covariance, expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ODOMETRY))
def test_odometry_agrees_with_itself_within_its_standard_deviations(drive: Drive, name: str) -> None:
    """Halves of the images, and backwards in time: RMS over motions and components of some frames."""
    found = agreement(drive.calibration, drive.frames[2:30], resolve("odometry", name, ODOMETRY))
    assert 0.3 < np.sqrt(np.mean(np.square(found.halves))) < 1.2
    assert np.sqrt(np.mean(np.square(found.backwards))) < 1.0  # the noise is common


def test_halves_of_odd_images_meet_at_the_edges(calibration: StereoCalibration) -> None:
    odd = replace(calibration, width=1345, cx=672.0)
    left, right = (halved(odd, side) for side in (0, 1))
    assert (left.width, right.width) == (672, 672)
    assert (left.cx, right.cx) == (672.0, -1.0)


def test_no_frames_say_nothing(calibration: StereoCalibration) -> None:
    found = agreement(calibration, [], resolve("odometry", "circular", ODOMETRY))
    assert np.isnan([found.halves, found.backwards]).all()


# The sandwich estimator: covariances from the features' own residuals


DRAWS = 40


def promising_too_much(calibration: StereoCalibration, seed: int) -> Solution:
    """Motion from 300 points, of which those on the left promise a third of their error."""
    rng = np.random.default_rng(seed)
    points = points_ahead(rng, 300, calibration)
    moved = (points - MOTION[:3, 3]) @ MOTION[:3, :3]
    on_left = moved[:, 0] < 0.0
    claimed = np.where(on_left, 1.0 / 9.0, 1.0)[:, None] * STD**2 * VARIANCE
    seen = Observations(
        points, 1e-9 * point_covariance(calibration, points, claimed), images(calibration, moved, rng, STD), claimed
    )
    return refined(calibration, seen, MOTION, np.ones(300, np.bool_))


def test_errors_are_as_stated_where_weights_promise_too_much(calibration: StereoCalibration) -> None:
    """Half of the features are three times as wrong as they promise, so weights are far from right.

    The allowance for correlated tracks is left out. Standard errors of 40 draws of six components: 5 %.
    """
    ratios = []
    for seed in range(DRAWS):
        solution = promising_too_much(calibration, seed)
        ratios.append(CORRELATION * error(solution.X_PC) / np.sqrt(np.diag(solution.covariance)))
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.2)
    assert np.sqrt(np.mean(np.square(ratios), axis=0)).max() < 1.4  # each component: 11 %, times 4


def linear(rng: np.random.Generator, residuals: FloatArray) -> Contributions:
    """Contributions of a linear model with these residuals (3, n) and equal weights."""
    J = rng.standard_normal((6, *residuals.shape))
    score = np.einsum("kjn,jn->kn", J, residuals)
    return Contributions(J, J, score, np.zeros_like(score), np.full(residuals.shape[1], 0.25), 0.0)


def over_all(contributions: Contributions) -> Sums:
    """Sums over all features, without halves."""
    return summed(contributions, np.empty((0, len(contributions.share)), np.bool_))


def test_equal_independent_residuals_give_the_covariance_of_least_squares() -> None:
    """sigma^2 inverse(J J'); 3 000 residuals: their scatter is known within 3 %, its shape within 10 %."""
    rng = np.random.default_rng(1)
    contributions = linear(rng, 0.3 * rng.standard_normal((3, 1000)))
    sums = over_all(contributions)
    whole = estimated(sums, 0.0)
    expected = 0.09 * np.linalg.inv(sums.normal[0])
    assert np.diag(whole.covariance[0]) == pytest.approx(np.diag(expected), rel=0.2)
    assert own_part(sums, whole, 0.0) == pytest.approx(0.25 * whole.covariance[0], rel=1e-6, abs=1e-12)


def test_a_direction_that_no_feature_sees_stays_uncertain() -> None:
    """Nothing scatters there, but the least variance of the residuals counts, over next to no information."""
    rng = np.random.default_rng(2)
    J = rng.standard_normal((6, 3, 50))
    J[4] = 0.0
    score = np.einsum("kjn,jn->kn", J, 0.1 * rng.standard_normal((3, 50)))
    contributions = Contributions(J, J, score, np.zeros_like(score), np.ones(50), 0.02**2)
    covariance = estimated(over_all(contributions), contributions.least).covariance[0]
    assert np.isfinite(covariance).all()
    assert covariance[4, 4] > 1e3 * covariance[3, 3]


def test_steep_robust_weights_leave_the_slope_positive() -> None:
    """All residuals where the influence of a feature falls: the slope would be negative."""
    rng = np.random.default_rng(3)
    J = rng.standard_normal((6, 3, 40))
    score = np.einsum("kjn,jn->kn", J, rng.standard_normal((3, 40)))
    contributions = Contributions(J, J, score, 5.0 * score, np.ones(40), 0.0)
    covariance = estimated(over_all(contributions), 0.0).covariance[0]
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)
