"""VISO2-S in the stages of de Saxe 2018, section 2.1: the odometry of the paper, as a reference.

(1) corner-like features, (2) circular matching, (3) buckets, (4) Gauss-Newton on the reprojection error inside (5)
RANSAC, (6) a constant-acceleration Kalman filter. Features lie at whole pixels, and this rounding limits the accuracy.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.estimates import Health, Motion, lost_motion
from estimators.odometry.covariance import Contributions, halves, summed, with_differences
from estimators.odometry.frame_to_frame import ENOUGH_MATCHES, FrameMemory, FrameToFrame, Seen
from estimators.odometry.image_points import moved
from estimators.odometry.plausibility import is_implausible
from estimators.odometry.pose import consensus
from estimators.odometry.viso2_matching import PairFeatures, circular_matches, pair_features
from estimators.rigid_motion import UncertainMotion, rotation_vector, stretched
from estimators.stereo_pair import linearised, triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, orthonormalised, so3_exp, transform

# Density of white jerk: 6 m/s3 and 3 rad/s3 for a tenth of a second, as in braking and as a trailer's body rolls and
# pitches over bumps.
_JERK = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # [rad/s3/sqrt(Hz)], [m/s3/sqrt(Hz)]
_START = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])  # initial standard deviation of the acceleration [rad/s2], [m/s2]
# Innovation after which the filter starts anew: it would go on compensating a wrong motion with the next ones, which
# are right [standard deviations]. Those stated for fast travel are half of the real ones.
_CONTRADICTION = 10.0
NEAR, _FAR = 24.0, 60.0  # search radius around the prediction, and around no motion without one [px]
_GATE = 2.0  # largest reprojection error of an inlier: four roundings and their effect on the point [px]
_FEWEST_INLIERS = 12  # two for each unknown
_AGREEING = 0.45  # least share of inliers: distant points alone agree with no motion; measured over gaps of 3 to 10 m
_FARTHEST = 5.0  # longest motion; features of whole pixels are decimetres wrong after that: measured [m]
_STRAYED = 0.05  # share of the inliers in the outer half of their windows from which on others may lie beyond
_ITERATIONS = 20  # of Gauss-Newton, at most
_CONVERGED = 1e-6  # [rad, m]
_CORRELATION = 1.6  # factor for correlated rounding errors: measured
_BOTH_ROWS = np.array([1.0, 2.0, 1.0])  # weights: the row is the mean of two images


class Velocity(NamedTuple):
    """Velocity and acceleration of six components (rotation, then translation) at a tick, each with its covariance."""

    tick: int
    state: FloatArray  # (6, 2) velocity [rad/s, m/s], acceleration [rad/s2, m/s2]
    covariance: FloatArray  # (6, 2, 2)


class Viso2Odometry(FrameToFrame[PairFeatures]):
    """VISO2-S stereo odometry from frame to frame (de Saxe 2018).

    The filter spreads the error of a motion over later ones but keeps the sum. So the covariance is that of the motion
    before the filter.
    """

    def _features(self, frame: StereoFrame) -> PairFeatures:
        return pair_features(frame)

    def _number(self, features: PairFeatures) -> int:
        return len(features.left.points)

    def _filtered(self, velocity: Velocity | None, measured: Motion, motion: Motion) -> tuple[Velocity, Motion]:
        velocity = _filtered(velocity, measured)
        if motion is measured:
            motion = replace(motion, X_PC=expected_motion(velocity, motion.tick, motion.tick - motion.previous_tick))
        return velocity, motion

    def _measured(
        self, memory: FrameMemory[PairFeatures], previous: Seen[PairFeatures], current: Seen[PairFeatures]
    ) -> Motion:
        """Unfiltered motion near one of the predictions, if possible one that is plausible."""
        (reference, before), (frame, features) = previous, current
        span, last = frame.tick - reference.tick, memory.belief.newest
        guesses = [(np.eye(4), _FAR)]
        if last is not None:
            guesses.insert(0, (stretched(last.X_PC, span / (last.tick - last.previous_tick)), _FAR))
        if memory.velocity is not None:
            guesses.insert(0, (expected_motion(memory.velocity, frame.tick, span), NEAR))
        first, ticks = None, (reference.tick, frame.tick)
        for guess, reach in guesses:
            motion, strayed = self._near(before, features, guess, reach, ticks)
            if motion.health is Health.DEGRADED and strayed:  # a wrong guess costs matches
                again, _ = self._near(before, features, motion.X_PC, NEAR, ticks)
                motion = again if again.inliers > motion.inliers else motion
            if motion.health is Health.LOST:
                continue
            if last is None or not is_implausible(last, motion):
                return motion
            first = first or motion
        return first or motion

    def _near(
        self, before: PairFeatures, features: PairFeatures, guess: FloatArray, reach: float, ticks: tuple[int, int]
    ) -> tuple[Motion, bool]:
        """Motion by matching, RANSAC and least squares, from the first to the second of two ticks.

        It is lost if too few matches agree. The flag tells that many of them are far from where the guess has them.
        """
        matches, (previous_tick, tick) = circular_matches(self._calibration, before, features, guess, reach), ticks
        lost = lost_motion(tick, previous_tick, len(matches.current))
        if len(matches.current) < _FEWEST_INLIERS:
            return lost, False
        points = triangulate(self._calibration, matches.previous)
        rng = np.random.default_rng([self._seed, tick])
        agreed = consensus(self._calibration, points, matches.current, guess, np.inf, rng, gate=_GATE)
        inliers = agreed.inliers
        if np.count_nonzero(inliers) < max(_FEWEST_INLIERS, _AGREEING * len(inliers)):
            return lost, False
        found = _least_squares(self._calibration, points[inliers], matches.current[inliers], agreed.X_PC)
        if found is None:
            return lost, False
        solution, differences = found
        if np.linalg.norm(solution.X[:3, 3]) > _FARTHEST:
            return lost, False
        surprise = np.abs(matches.current - moved(self._calibration, matches.previous, guess))[inliers].max(axis=1)
        motion = replace(
            lost,
            X_PC=solution.X,
            covariance=solution.covariance,
            inliers=int(np.count_nonzero(inliers)),
            health=Health.OK if len(inliers) >= ENOUGH_MATCHES else Health.DEGRADED,
            tracks=matches.tracks()[inliers],
            halves=differences,
        )
        return motion, float(np.mean(surprise > 0.5 * reach)) > _STRAYED


def _least_squares(
    calibration: StereoCalibration, points: FloatArray, z: FloatArray, X_PC: FloatArray
) -> tuple[UncertainMotion, FloatArray] | None:
    """Least-squares motion over the reprojection errors in both current images; None without convergence.

    Also the differences (3, 6) between halves of the features, as in ``self_consistency``.
    """
    R, p = X_PC[:3, :3], X_PC[:3, 3]
    points, z = np.ascontiguousarray(points.T), np.ascontiguousarray(z.T)
    for _ in range(_ITERATIONS):
        r, J = linearised(calibration, R, p, points, z)
        weighted = (J * _BOTH_ROWS[:, None]).reshape(6, -1)
        normal = weighted @ J.reshape(6, -1).T
        if np.linalg.matrix_rank(normal, hermitian=True) < 6:
            return None
        step = np.asarray(np.linalg.solve(normal, weighted @ r.ravel()), dtype=np.float64)
        R, p = so3_exp(step[:3]) @ R, p + step[3:]
        if np.abs(step).max() < _CONVERGED:
            contributions = _contributions(J, weighted.reshape(J.shape), r)
            whole, differences = with_differences(summed(contributions, halves(z)), contributions.least)
            motion = UncertainMotion(transform(orthonormalised(R), p), _CORRELATION**2 * whole.covariance[0])
            return motion, differences / _CORRELATION
    return None


def _contributions(J: FloatArray, weighted: FloatArray, r: FloatArray) -> Contributions:
    """Contributions of n features, none of which is robustly weighted."""
    score = np.einsum("kjn,jn->kn", weighted, r)
    return Contributions(J, weighted, score, bend=np.zeros_like(score), share=np.ones(r.shape[1]), least=0.0)


def _filtered(last: Velocity | None, motion: Motion) -> Velocity:
    """Velocity after one more motion; it starts anew from one that contradicts those before."""
    measured, span = UncertainMotion(motion.X_PC, motion.covariance), motion.tick - motion.previous_tick
    if last is not None:
        filtered = updated(last, motion.tick, span, measured)
        if filtered is not None:
            return filtered
    return started(motion.tick, span, measured)


def started(tick: int, span: int, measured: UncertainMotion) -> Velocity:
    """Initial velocity from the first motion, which took ``span`` ticks."""
    velocity, variance = _velocity(span, measured)
    covariance = np.zeros((6, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = variance, _START**2
    return Velocity(tick, np.column_stack([velocity, np.zeros(6)]), covariance)


def updated(last: Velocity, tick: int, span: int, measured: UncertainMotion) -> Velocity | None:
    """Velocity updated with a motion of ``span`` ticks that ended at ``tick``; None if they contradict each other."""
    predicted = _predicted(last, tick)
    velocity, variance = _velocity(span, measured)
    innovation, variance = velocity - predicted.state[:, 0], predicted.covariance[:, 0, 0] + variance
    if np.any(innovation**2 > _CONTRADICTION**2 * variance):
        return None
    gain = predicted.covariance[:, :, 0] / variance[:, None]
    state = predicted.state + gain * innovation[:, None]
    covariance = predicted.covariance - gain[:, :, None] * predicted.covariance[:, None, 0, :]
    return Velocity(tick, state, covariance)


def expected_motion(last: Velocity, tick: int, span: int) -> FloatArray:
    """Motion X (4, 4) over the ``span`` ticks before ``tick`` at the velocity predicted for ``tick``."""
    twist = _predicted(last, tick).state[:, 0] * (span * TICK)
    return transform(so3_exp(twist[:3]), twist[3:])


def _velocity(span: int, measured: UncertainMotion) -> tuple[FloatArray, FloatArray]:
    """Mean velocity (6,) over a motion, and its variance."""
    seconds = span * TICK
    velocity = np.concatenate([rotation_vector(measured.X[:3, :3]), measured.X[:3, 3]]) / seconds
    return velocity, np.diag(measured.covariance) / seconds**2


def _predicted(last: Velocity, tick: int) -> Velocity:
    """Velocity predicted for a later tick at constant acceleration, with white jerk as process noise."""
    t = (tick - last.tick) * TICK
    F = np.array([[1.0, t], [0.0, 1.0]])
    Q = np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
    return Velocity(tick, last.state @ F.T, F @ last.covariance @ F.T + (_JERK**2)[:, None, None] * Q)
