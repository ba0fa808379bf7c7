"""RANSAC and Gauss-Newton on matches of points with known motion."""

import math

import numpy as np
import pytest

from estimators.odometry import pose
from estimators.odometry.image_points import Matches
from estimators.rigid_motion import rotation_vector
from estimators.stereo_pair import linearised, project, triangulate, triangulation_jacobian
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray, rotation_zyx, so3_exp, transform

pytestmark = pytest.mark.usefixtures("back_end")

STD = 0.1  # [px] of a coordinate
VARIANCE = np.array([1.0, 0.5, 1.0])  # of (u left, v, u right), up to a scale; v is the mean of two
# camera axes: yawing to the left is turning about -y, driving on is -z for a camera that looks back
MOTION = transform(rotation_zyx(0.002, -0.03, 0.004), np.array([0.05, 0.01, -0.5]))


def points_ahead(rng: np.random.Generator, count: int, calibration: StereoCalibration) -> FloatArray:
    """Points that both cameras see before and after the motion, half of them on the ground."""
    depth = rng.uniform(8.0, 60.0, count)
    x, y = rng.uniform(-0.8, 0.8, count) * depth, np.where(rng.random(count) < 0.5, 3.0, rng.uniform(-2.0, 3.0, count))
    return np.column_stack([x, y, depth])


def images(calibration: StereoCalibration, points: FloatArray, rng: np.random.Generator, std: float) -> FloatArray:
    """Noisy z (n, 3); the row is the mean of two."""
    return project(calibration, points) + std * rng.standard_normal(points.shape) * [1.0, math.sqrt(0.5), 1.0]


def matched(calibration: StereoCalibration, rng: np.random.Generator, count: int, std: float) -> Matches:
    points = points_ahead(rng, count, calibration)
    moved = (points - MOTION[:3, 3]) @ MOTION[:3, :3]
    return Matches(images(calibration, points, rng, std), images(calibration, moved, rng, std))


def error(X_PC: FloatArray) -> FloatArray:
    return np.concatenate([rotation_vector(MOTION[:3, :3] @ X_PC[:3, :3].T), MOTION[:3, 3] - X_PC[:3, 3]])


def observations(
    calibration: StereoCalibration, matches: Matches, variance: FloatArray = VARIANCE
) -> pose.Observations:
    """The points that the previous images define, and the current images, with the variance of ``images``."""
    points = triangulate(calibration, matches.previous)
    covariance = pose.point_covariance(calibration, points, VARIANCE)
    return pose.Observations(points, covariance, matches.current, np.broadcast_to(variance, points.shape))


def solved(calibration: StereoCalibration, matches: Matches, seed: int = 0) -> tuple[pose.Consensus, pose.Solution]:
    seen = observations(calibration, matches)
    agreed = pose.consensus(calibration, seen.points, seen.z, np.eye(4), np.inf, np.random.default_rng(seed))
    return agreed, pose.refined(calibration, seen, agreed.X_PC, agreed.inliers)


def test_triangulation_inverts_projection(calibration: StereoCalibration) -> None:
    points = points_ahead(np.random.default_rng(0), 50, calibration)
    assert triangulate(calibration, project(calibration, points)) == pytest.approx(points, abs=1e-9)  # rounding


def test_exact_matches_give_the_exact_motion(calibration: StereoCalibration) -> None:
    _, solution = solved(calibration, matched(calibration, np.random.default_rng(1), 300, 0.0))
    assert solution.converged
    assert error(solution.X_PC) == pytest.approx(np.zeros(6), abs=1e-9)  # quadratic convergence
    assert solution.inliers.all()


def test_both_back_ends_find_the_same(calibration: StereoCalibration, monkeypatch: pytest.MonkeyPatch) -> None:
    """A third is wrong, and a number of points that is no multiple of a vector's: equal but for rounding."""
    rng = np.random.default_rng(21)
    matches = matched(calibration, rng, 203, STD)
    matches.current[::3] += rng.uniform(-15.0, 15.0, matches.current[::3].shape)
    newest = rng.random(203) < 0.5
    found = []
    for name in ("", "none"):
        monkeypatch.setenv("OFFTRACK_COMPILER", name)
        seen = observations(calibration, matches)
        agreed = pose.consensus(calibration, seen.points, seen.z, np.eye(4), np.inf, np.random.default_rng(0))
        found.append(pose.refined(calibration, seen, agreed.X_PC, agreed.inliers, newest))
    compiled, plain = found
    assert compiled.converged
    assert plain.converged
    assert np.array_equal(compiled.inliers, plain.inliers)
    assert 120 < np.count_nonzero(plain.inliers) < 150
    scale = np.sqrt(np.diag(plain.covariance))
    # the normal matrix has a condition of 1e5: solutions differ by that times the rounding
    assert np.abs(error(compiled.X_PC) - error(plain.X_PC)) == pytest.approx(np.zeros(6), abs=1e-9 * scale.min())
    for one, other in ((compiled.covariance, plain.covariance), (compiled.own, plain.own)):
        assert one / np.outer(scale, scale) == pytest.approx(other / np.outer(scale, scale), abs=1e-9)
    assert compiled.differences == pytest.approx(plain.differences, abs=1e-9)


def test_wrong_matches_are_left_out(calibration: StereoCalibration) -> None:
    """Four in ten matches are anywhere, a fifth of these with one coordinate off by 3 px only."""
    rng = np.random.default_rng(2)
    matches = matched(calibration, rng, 400, STD)
    current = matches.current.copy()
    current[:128] += rng.uniform(-40.0, 40.0, (128, 3))
    current[128:160, 0] += 3.0
    agreed, solution = solved(calibration, Matches(matches.previous, current))
    assert not solution.inliers[128:160].any()
    assert solution.inliers[160:].mean() > 0.98  # 4 sigma
    normalised = error(solution.X_PC) / np.sqrt(np.diag(solution.covariance))
    assert np.abs(normalised).max() < 3.0
    assert np.linalg.norm(error(solution.X_PC)) < np.linalg.norm(error(agreed.X_PC))


def test_slightly_wrong_matches_hardly_pull(calibration: StereoCalibration) -> None:
    """One match in four is off to one side by 3 sigma, too little to be told from the rest: it weighs little."""
    rng = np.random.default_rng(8)
    matches = matched(calibration, rng, 400, STD)
    current = matches.current.copy()
    current[:100, [0, 2]] += 3.0 * STD
    _, solution = solved(calibration, Matches(matches.previous, current))
    yaw = np.degrees(error(solution.X_PC)[1])
    assert abs(yaw) < 0.005  # least squares would be a quarter of 0.3 px wrong: 0.0076 deg


def test_a_moving_body_does_not_take_over(calibration: StereoCalibration) -> None:
    rng = np.random.default_rng(3)
    matches = matched(calibration, rng, 450, STD)
    points = np.column_stack([rng.uniform(-3, 3, 150), rng.uniform(-1, 2, 150), rng.uniform(8, 12, 150)])
    carried = points + np.array([0.0, 0.0, -0.6])
    previous, current = matches.previous.copy(), matches.current.copy()
    previous[:150], current[:150] = images(calibration, points, rng, STD), images(calibration, carried, rng, STD)
    _, solution = solved(calibration, Matches(previous, current))
    assert solution.inliers[:150].mean() < 0.02
    assert np.abs(error(solution.X_PC) / np.sqrt(np.diag(solution.covariance))).max() < 3.0


def test_hypotheses_out_of_reach_are_not_believed(calibration: StereoCalibration) -> None:
    """Most matches agree on a motion that no trailer could have made since the prediction."""
    rng = np.random.default_rng(6)
    matches = matched(calibration, rng, 100, STD)
    points = triangulate(calibration, matches.previous)
    agreed = pose.consensus(calibration, points, matches.current, np.eye(4), 0.1, rng)  # the motion is 0.5 m
    assert np.linalg.norm(agreed.X_PC[:3, 3]) < 0.1


def test_covariance_is_that_of_the_errors(calibration: StereoCalibration) -> None:
    """Normalised squared errors average to 6 for independent noise, but for the allowance for correlated tracks."""
    squared = []
    for seed in range(150):
        rng = np.random.default_rng(100 + seed)
        _, solution = solved(calibration, matched(calibration, rng, 250, STD), seed)
        e = error(solution.X_PC)
        squared.append(e @ np.linalg.solve(solution.covariance / pose.CORRELATION**2, e))
    # chi-squared of 6 degrees: mean 6, its standard error over 150 draws sqrt(12 / 150) = 0.28
    assert np.mean(squared) == pytest.approx(6.0, abs=0.9)


def test_matches_that_say_nothing_do_not_converge_or_say_so(calibration: StereoCalibration) -> None:
    """All matches are one and the same point: no motion comes out that would claim to be certain."""
    z = np.repeat(np.array([[700.0, 250.0, 680.0]]), 40, axis=0)
    _, solution = solved(calibration, Matches(z, z))
    assert np.sqrt(np.linalg.eigvalsh(solution.covariance).max()) > 1.0  # [rad or m]


def test_jacobians_are_those_of_differences(calibration: StereoCalibration) -> None:
    """Central differences: of images with the motion, for several motions at once, and of points with their images."""
    rng, step = np.random.default_rng(11), 1e-6
    points = points_ahead(rng, 20, calibration)
    z = project(calibration, points)
    R, p = np.array([np.eye(3), MOTION[:3, :3]]), np.array([np.zeros(3), MOTION[:3, 3]])

    def predicted(d: FloatArray) -> FloatArray:
        return -linearised(calibration, so3_exp(d[:3]) @ R, p + d[3:], points.T, z.T)[0]

    _, J = linearised(calibration, R, p, points.T, z.T)
    changes = [(predicted(d) - predicted(-d)) / (2.0 * step) for d in step * np.eye(6)]
    np.testing.assert_allclose(J, np.stack(changes, axis=1), rtol=1e-6, atol=1e-6)  # rounding of 1e-13 px over a step
    moved = [(triangulate(calibration, z + d) - triangulate(calibration, z - d)) / 2e-3 for d in 1e-3 * np.eye(3)]
    # the square of a step over a disparity of at least 4 px
    np.testing.assert_allclose(
        triangulation_jacobian(calibration, points), np.stack(moved, axis=2), rtol=1e-6, atol=1e-9
    )


def test_covariance_of_points_is_that_of_their_spread(calibration: StereoCalibration) -> None:
    """Monte Carlo: noise of the images through triangulation, along the ray far more than across it."""
    rng = np.random.default_rng(9)
    point = np.array([[1.0, 2.0, 12.0]])
    spread = np.cov(triangulate(calibration, images(calibration, np.repeat(point, 4000, axis=0), rng, STD)).T)
    predicted = pose.point_covariance(calibration, point, STD**2 * VARIANCE)[0]
    # 4000 draws: 2.2 % of a variance, times 4; the second order of triangulation is below
    assert predicted == pytest.approx(spread, rel=0.1, abs=0.01 * spread.max())
    assert predicted[2, 2] > 20.0 * predicted[0, 0]


def test_own_part_of_the_covariance_is_the_difference_between_frames(calibration: StereoCalibration) -> None:
    """Frames that see the same points share the points' errors: what differs is their own images' part alone."""
    rng = np.random.default_rng(10)
    points = points_ahead(rng, 300, calibration)
    previous = images(calibration, points, rng, STD)
    moved = (points - MOTION[:3, 3]) @ MOTION[:3, :3]
    solutions = [solved(calibration, Matches(previous, images(calibration, moved, rng, STD)))[1] for _ in range(60)]
    across = np.std([error(solution.X_PC) for solution in solutions], axis=0)
    seen = observations(calibration, Matches(previous, images(calibration, moved, rng, STD)))
    solution = pose.refined(calibration, seen, MOTION, np.ones(len(points), np.bool_))
    own = np.sqrt(np.diag(solution.own)) / pose.CORRELATION
    assert own == pytest.approx(across, rel=0.4)  # a standard deviation of 60: 9 %, times 4
    assert np.all(own < np.sqrt(np.diag(solution.covariance)) / pose.CORRELATION)


@pytest.mark.parametrize(("wrong", "kept"), [(0.2, True), (0.45, False)])
def test_a_prediction_that_a_clear_majority_agrees_with_needs_no_hypotheses(
    calibration: StereoCalibration, wrong: float, kept: bool
) -> None:
    """1 mm off: with 80 % the prediction stays and nothing is drawn; with 55 % hypotheses compete with it."""
    rng, draws = np.random.default_rng(11), np.random.default_rng(12)
    points = points_ahead(rng, 200, calibration)
    z = images(calibration, (points - MOTION[:3, 3]) @ MOTION[:3, :3], rng, STD)
    right = np.arange(len(z)) >= int(wrong * len(z))
    z[~right] += 20.0
    predicted = MOTION.copy()
    predicted[2, 3] += 1e-3
    agreed = pose.consensus(calibration, points, z, predicted, 1.0, draws)
    drawn = draws.bit_generator.state != np.random.default_rng(12).bit_generator.state
    assert drawn is not kept
    assert np.array_equal(agreed.X_PC, predicted) or drawn
    assert np.mean(agreed.inliers == right) > 0.95
