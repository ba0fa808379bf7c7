"""Stereo odometry from frame to frame, by circular matching.

Follows the steps of VISO2-S as de Saxe 2018, section 2.1, lists them (corners, circular matching, buckets, RANSAC,
Gauss-Newton on the reprojection error), with sub-pixel tracks. In place of the Kalman filter, the motion at the last
velocity is the initial guess: a filter would smooth the increments whose sum is wanted.
"""

from dataclasses import replace

import numpy as np

from estimators.estimates import Health, Motion, lost_motion
from estimators.odometry.frame_to_frame import ENOUGH_MATCHES, FrameMemory, FrameToFrame, Seen
from estimators.odometry.image_points import detect_corners, match
from estimators.odometry.plausibility import LARGEST_ACCELERATION
from estimators.odometry.pose import Observations, consensus, point_covariance, refined
from estimators.rigid_motion import stretched
from estimators.stereo_pair import Points, triangulate
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray

PER_BUCKET = 4  # corners; 450 to 550 matches on an ordinary road
_SHARE = np.array([1.0, 0.5, 1.0])  # variances of (u left, v, u right) relative to one coordinate; v is the mean of two
_FEWEST_INLIERS = 25  # fewer may agree by chance
_AGREEING = 0.5  # share of inliers below which most matches may lie on a moving object


class CircularOdometry(FrameToFrame[Points]):
    """Stereo odometry from frame to frame with sub-pixel tracks (after VISO2-S)."""

    def _features(self, frame: StereoFrame) -> Points:
        return detect_corners(frame.left, per_bucket=PER_BUCKET)

    def _number(self, features: Points) -> int:
        return len(features)

    def _measured(self, memory: FrameMemory[Points], previous: Seen[Points], current: Seen[Points]) -> Motion:
        return self.motion(*previous, current[0], memory.belief.newest)

    def motion(self, reference: StereoFrame, corners: Points, frame: StereoFrame, last: Motion | None) -> Motion:
        """Motion since the reference frame with its corners, near the motion predicted from the last velocity.

        If there is none near the prediction, any motion is accepted, searched from rest and marked as degraded. The
        covariance counts features as independent.
        """
        guesses = [(np.eye(4), np.inf)]
        if last is not None:
            ticks = frame.tick - reference.tick
            predicted = stretched(last.X_PC, ticks / (last.tick - last.previous_tick))
            guesses.insert(0, (predicted, search_radius(ticks)))
        for guess, reach in guesses:
            motion = self._near(guess, reach, reference, corners, frame)
            if motion.health is Health.DEGRADED:  # a wrong guess costs matches
                again = self._near(motion.X_PC, reach, reference, corners, frame)
                motion = again if again.inliers > motion.inliers else motion
            if motion.health is not Health.LOST:
                break
        unpredicted = last is not None and reach == np.inf
        return replace(motion, health=Health.DEGRADED) if unpredicted and motion.health is Health.OK else motion

    def _near(
        self, guess: FloatArray, reach: float, reference: StereoFrame, corners: Points, frame: StereoFrame
    ) -> Motion:
        """Motion by circular matching, RANSAC and least squares, within ``reach`` [m] of the guess."""
        matches = match(self._calibration, reference, corners, frame, guess)
        nothing = lost_motion(frame.tick, reference.tick, len(matches.current))
        if len(matches.current) < _FEWEST_INLIERS:
            return nothing
        points = triangulate(self._calibration, matches.previous)
        rng = np.random.default_rng([self._seed, frame.tick])
        agreed = consensus(self._calibration, points, matches.current, guess, reach, rng)
        if np.count_nonzero(agreed.inliers) < _FEWEST_INLIERS:
            return nothing
        covariance = point_covariance(self._calibration, points, _SHARE)
        observations = Observations(points, covariance, matches.current, np.broadcast_to(_SHARE, points.shape))
        solution = refined(self._calibration, observations, agreed.X_PC, agreed.inliers)
        inliers = int(np.count_nonzero(solution.inliers))
        found = replace(
            nothing,
            inliers=inliers,
            tracks=matches.tracks()[solution.inliers],
            halves=solution.differences,
        )
        if not solution.converged or inliers < _FEWEST_INLIERS:
            return found
        doubtful = len(points) < ENOUGH_MATCHES or inliers < _AGREEING * len(points)
        health = Health.DEGRADED if doubtful else Health.OK
        return replace(found, X_PC=solution.X_PC, covariance=solution.covariance, health=health)


def search_radius(ticks: int) -> float:
    """Largest distance of a motion over ``ticks`` from the motion predicted at the last velocity [m]."""
    return LARGEST_ACCELERATION * (ticks * TICK) ** 2
