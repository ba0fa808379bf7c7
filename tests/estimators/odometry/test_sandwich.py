"""The sandwich estimator: covariances from the features' own residuals."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.odometry.covariance import Contributions, estimated, own_part, stacked, summed
from estimators.odometry.pose import CORRELATION, Observations, Solution, point_covariance, refined
from sensors.camera.rig import StereoCalibration
from tests.estimators.odometry.test_pose import MOTION, STD, VARIANCE, error, images, points_ahead
from vehicle.frames import FloatArray

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


def test_equal_independent_residuals_give_the_covariance_of_least_squares() -> None:
    """sigma^2 inverse(J J'); 3 000 residuals: their scatter is known within 3 %, its shape within 10 %."""
    rng = np.random.default_rng(1)
    contributions = linear(rng, 0.3 * rng.standard_normal((3, 1000)))
    sums = summed(contributions)
    whole = estimated(stacked([sums]), 0.0)
    expected = 0.09 * np.linalg.inv(sums.normal)
    assert np.diag(whole.covariance[0]) == pytest.approx(np.diag(expected), rel=0.2)
    assert own_part(contributions, sums.number, whole) == pytest.approx(0.25 * whole.covariance[0], rel=1e-6, abs=1e-12)


def test_a_direction_that_no_feature_sees_stays_uncertain() -> None:
    """Nothing scatters there, but the least variance of the residuals counts, over next to no information."""
    rng = np.random.default_rng(2)
    J = rng.standard_normal((6, 3, 50))
    J[4] = 0.0
    score = np.einsum("kjn,jn->kn", J, 0.1 * rng.standard_normal((3, 50)))
    contributions = Contributions(J, J, score, np.zeros_like(score), np.ones(50), 0.02**2)
    covariance = estimated(stacked([summed(contributions)]), contributions.least).covariance[0]
    assert np.isfinite(covariance).all()
    assert covariance[4, 4] > 1e3 * covariance[3, 3]


def test_steep_robust_weights_leave_the_slope_positive() -> None:
    """All residuals where the influence of a feature falls: the slope would be negative."""
    rng = np.random.default_rng(3)
    J = rng.standard_normal((6, 3, 40))
    score = np.einsum("kjn,jn->kn", J, rng.standard_normal((3, 40)))
    contributions = Contributions(J, J, score, 5.0 * score, np.ones(40), 0.0)
    covariance = estimated(stacked([summed(contributions)]), 0.0).covariance[0]
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)
