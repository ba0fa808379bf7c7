"""VISO2-S in the stages of de Saxe 2018, section 2.1: the odometry of the paper, as a reference.

(1) corner-like features, (2) circular matching, (3) buckets, (4) Gauss-Newton on the reprojection error inside (5)
RANSAC, (6) a constant-acceleration Kalman filter. Features lie at whole pixels, and this rounding limits the accuracy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.estimates import Health, Motion
from estimators.odometry.circular import ENOUGH_MATCHES, LONGEST_SPAN
from estimators.odometry.point_tracking import Matches
from estimators.odometry.ransac import consensus
from estimators.odometry.viso2_matching import PairFeatures, circular_matches, pair_features
from estimators.protocol import above_ground
from estimators.rigid_motion import UncertainMotion, rotation_vector
from estimators.stereo_geometry import linearised, triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, orthonormalised, so3_exp, transform

# Density of white jerk: 6 m/s3 and 3 rad/s3 for a tenth of a second, as in braking and as a trailer's body rolls and
# pitches over bumps.
_JERK = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # [rad/s3/sqrt(Hz)], [m/s3/sqrt(Hz)]
_START = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])  # initial standard deviation of the acceleration [rad/s2], [m/s2]
NEAR, _FAR = 24.0, 60.0  # search radius around the prediction, and around no motion without one [px]
_GATE = 2.0  # largest reprojection error of an inlier: four roundings and their effect on the point [px]
_FEWEST_INLIERS = 12  # two for each unknown
_ITERATIONS = 20  # of Gauss-Newton, at most
_CONVERGED = 1e-6  # [rad, m]
_CORRELATION = 1.6  # factor for correlated rounding errors: measured
_BOTH_ROWS = np.array([1.0, 2.0, 1.0])  # weights: the row is the mean of two images


class Velocity(NamedTuple):
    """Velocity and acceleration of six components (rotation, then translation) at a tick, each with its covariance."""

    tick: int
    state: FloatArray  # (6, 2) velocity [rad/s, m/s], acceleration [rad/s2, m/s2]
    covariance: FloatArray  # (6, 2, 2)


class Viso2Memory(NamedTuple):
    """Features of the previous pair, and the velocity filter."""

    tick: int = 0
    features: PairFeatures | None = None
    velocity: Velocity | None = None


class Viso2Odometry:
    """VISO2-S stereo odometry from frame to frame (de Saxe 2018)."""

    def __init__(self, calibration: StereoCalibration, *, seed: int = 0) -> None:
        """An odometry for this rig; ``seed`` and a frame's tick fix the draws of RANSAC.

        Raises:
            ValueError: if the left camera is not above the ground.
        """
        self._calibration = above_ground(calibration)
        self._seed = seed

    def init(self) -> Viso2Memory:
        """Memory before the first frame."""
        return Viso2Memory()

    def step(self, memory: Viso2Memory, frame: StereoFrame) -> tuple[Viso2Memory, Motion | None]:
        """Memory with the frame in it, and the filtered motion since the frame before; None for the first frame.

        The filter spreads the error of a motion over later ones but keeps the sum. So the covariance is that of the
        motion before the filter. A frame with almost no features is lost and skipped.
        """
        features = pair_features(frame)
        if memory.features is None:
            return Viso2Memory(frame.tick, features), None
        span, last = frame.tick - memory.tick, memory.velocity
        guesses = [(np.eye(4), _FAR)]
        if last is not None:
            guesses.insert(0, (expected_motion(last, frame.tick, span), NEAR))
        for guess, reach in guesses:
            matches = circular_matches(self._calibration, memory.features, features, guess, reach)
            inliers, measured = self._measured(matches, guess, frame.tick)
            if measured is not None:
                break
        if measured is None:
            motion = _lost(frame.tick, memory.tick, matches)
            skipped = len(features.left.points) < ENOUGH_MATCHES and span < LONGEST_SPAN
            return (memory if skipped else Viso2Memory(frame.tick, features)), motion
        velocity = started(frame.tick, span, measured) if last is None else updated(last, frame.tick, span, measured)
        motion = Motion(
            tick=frame.tick,
            previous_tick=memory.tick,
            X_PC=expected_motion(velocity, frame.tick, span),
            covariance=measured.covariance,
            matches=len(matches.current),
            inliers=int(np.count_nonzero(inliers)),
            health=Health.OK if len(matches.current) >= ENOUGH_MATCHES else Health.DEGRADED,
            tracks=np.column_stack([matches.previous[:, :2], matches.current[:, :2]])[inliers].astype(np.float32),
        )
        return Viso2Memory(frame.tick, features, velocity), motion

    def _measured(
        self, matches: Matches, guess: FloatArray, tick: int
    ) -> tuple[NDArray[np.bool_], UncertainMotion | None]:
        """Inliers of RANSAC and their least-squares motion; None if there are too few."""
        nothing = np.zeros(len(matches.current), np.bool_)
        if len(matches.current) < _FEWEST_INLIERS:
            return nothing, None
        points = triangulate(self._calibration, matches.previous)
        rng = np.random.default_rng([self._seed, tick])
        agreed = consensus(self._calibration, points, matches.current, guess, np.inf, rng, gate=_GATE)
        if np.count_nonzero(agreed.inliers) < _FEWEST_INLIERS:
            return nothing, None
        used = points[agreed.inliers], matches.current[agreed.inliers]
        measured = _least_squares(self._calibration, *used, agreed.X_PC)
        return (nothing, None) if measured is None else (agreed.inliers, measured)


def _least_squares(
    calibration: StereoCalibration, points: FloatArray, z: FloatArray, X_PC: FloatArray
) -> UncertainMotion | None:
    """Least-squares motion over the reprojection errors in both current images; None without convergence."""
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
            variance = _CORRELATION**2 * float(np.sum(_BOTH_ROWS @ np.square(r))) / (r.size - 6)
            covariance = variance * np.asarray(np.linalg.inv(normal), dtype=np.float64)
            return UncertainMotion(transform(orthonormalised(R), p), covariance)
    return None


def _lost(tick: int, previous_tick: int, matches: Matches) -> Motion:
    return Motion(
        tick=tick,
        previous_tick=previous_tick,
        X_PC=np.eye(4),
        covariance=np.diag(np.full(6, np.inf)),
        matches=len(matches.current),
        inliers=0,
        health=Health.LOST,
        tracks=np.zeros((0, 4), np.float32),
    )


def started(tick: int, span: int, measured: UncertainMotion) -> Velocity:
    """Initial velocity from the first motion, which took ``span`` ticks."""
    velocity, variance = _velocity(span, measured)
    covariance = np.zeros((6, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = variance, _START**2
    return Velocity(tick, np.column_stack([velocity, np.zeros(6)]), covariance)


def updated(last: Velocity, tick: int, span: int, measured: UncertainMotion) -> Velocity:
    """Velocity updated with a motion of ``span`` ticks that ended at ``tick``."""
    predicted = _predicted(last, tick)
    velocity, variance = _velocity(span, measured)
    gain = predicted.covariance[:, :, 0] / (predicted.covariance[:, 0, 0] + variance)[:, None]
    state = predicted.state + gain * (velocity - predicted.state[:, 0])[:, None]
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
