"""VISO2-S in the stages of de Saxe 2018, section 2.1: the odometry of the paper, to compare others with.

(1) corner-like features, (2) circular matching, (3) buckets, (4) Gauss-Newton on the reprojection error inside (5)
RANSAC, (6) a constant-acceleration Kalman filter. Features lie at whole pixels: their rounding is what limits it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.estimates import Health, Motion
from estimators.odometry.circular import LONGEST_SPAN, PLENTY
from estimators.odometry.circular_matching import Matches
from estimators.odometry.protocol import above_ground
from estimators.odometry.ransac import consensus
from estimators.odometry.reprojection import linearised
from estimators.odometry.velocity_filter import Velocity, expected_motion, started, updated
from estimators.odometry.viso2_matching import PairFeatures, circular_matches, pair_features
from estimators.rigid_motion import UncertainMotion
from estimators.stereo_geometry import triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray, orthonormalised, so3_exp, transform

NEAR, _FAR = 24.0, 60.0  # how far to look from the prediction, and from rest when there is none [px]
_GATE = 2.0  # reprojection error of an inlier: four roundings, and what they make of the point [px]
_FEWEST_INLIERS = 12  # two for each unknown
_ITERATIONS = 20  # of Gauss-Newton, at most
_CONVERGED = 1e-6  # [rad, m]
_CORRELATION = 1.6  # roundings of neighbours, and of the point that they place, are not independent: measured
_BOTH_ROWS = np.array([1.0, 2.0, 1.0])  # the row is the mean of two images, so it counts for two


class Viso2Memory(NamedTuple):
    """The features that the next pair is matched with, and the filter."""

    tick: int = 0
    features: PairFeatures | None = None
    velocity: Velocity | None = None


class Viso2Odometry:
    """Motion between the pairs of a stereo rig, each compared with the one before, as the paper does it."""

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

        The filter spreads the error of a motion over those after it but leaves the sum as it is; so the covariance is
        that of the motion before the filter. A frame with next to no features is lost and passed over.
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
            dark = len(features.left.points) < PLENTY and span < LONGEST_SPAN
            return (memory if dark else Viso2Memory(frame.tick, features)), motion
        velocity = started(frame.tick, span, measured) if last is None else updated(last, frame.tick, span, measured)
        motion = Motion(
            tick=frame.tick,
            previous_tick=memory.tick,
            X_PC=expected_motion(velocity, frame.tick, span),
            covariance=measured.covariance,
            matches=len(matches.current),
            inliers=int(np.count_nonzero(inliers)),
            health=Health.OK if len(matches.current) >= PLENTY else Health.DEGRADED,
            tracks=np.column_stack([matches.previous[:, :2], matches.current[:, :2]])[inliers].astype(np.float32),
        )
        return Viso2Memory(frame.tick, features, velocity), motion

    def _measured(
        self, matches: Matches, guess: FloatArray, tick: int
    ) -> tuple[NDArray[np.bool_], UncertainMotion | None]:
        """The matches that RANSAC finds to agree, and the motion that fits them best; None if too few agree."""
        nothing = np.zeros(len(matches.current), np.bool_)
        if len(matches.current) < _FEWEST_INLIERS:
            return nothing, None
        points = triangulate(self._calibration, matches.previous)
        rng = np.random.default_rng([self._seed, tick])
        agreed = consensus(self._calibration, points, matches.current, guess, np.inf, rng, gate=_GATE)
        if np.count_nonzero(agreed.inliers) < _FEWEST_INLIERS:
            return nothing, None
        seen = points[agreed.inliers], matches.current[agreed.inliers]
        measured = _least_squares(self._calibration, *seen, agreed.X_PC)
        return (nothing, None) if measured is None else (agreed.inliers, measured)


def _least_squares(
    calibration: StereoCalibration, points: FloatArray, z: FloatArray, X_PC: FloatArray
) -> UncertainMotion | None:
    """The motion of least reprojection error in both current images, by Gauss-Newton; None if it does not settle."""
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
