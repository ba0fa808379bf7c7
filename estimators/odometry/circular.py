"""Stereo odometry from frame to frame, by circular matching.

Follows the steps of VISO2-S as de Saxe 2018, section 2.1, lists them (corners, circular matching, buckets, RANSAC,
Gauss-Newton on the reprojection error), with sub-pixel tracks. In place of the Kalman filter, the motion at the last
velocity is the initial guess: a filter would smooth the increments whose sum is wanted.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.context import above_ground
from estimators.estimates import Health, Motion, lost_motion
from estimators.odometry.covariance import SelfConsistency, stated
from estimators.odometry.exposure import match_exposures, match_over_time
from estimators.odometry.image_points import Points, detect_corners, match
from estimators.odometry.plausibility import LARGEST_ACCELERATION, Belief, believed
from estimators.odometry.pose import Observations, consensus, point_covariance, refined
from estimators.odometry.repeated_frames import is_repeated, visible_noise
from estimators.rigid_motion import stretched
from estimators.stereo_pair import triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray

PER_BUCKET = 4  # corners; 450 to 550 matches on an ordinary road
ENOUGH_MATCHES = 250  # with fewer matches errors grow: de Saxe 2018, section 3.2.1
_SHARE = np.array([1.0, 0.5, 1.0])  # variances of (u left, v, u right) relative to one coordinate; v is the mean of two
_FEWEST_INLIERS = 25  # fewer may agree by chance
_AGREEING = 0.5  # share of inliers below which most matches may lie on a moving object
LONGEST_SPAN = 500  # between two frames; after that a fast truck no longer sees the same ground [ticks]
_SHARED_VIEW = 5.0  # travel after which much of the ground in view is the same, 5 to 20 m from the camera [m]


class OdometryMemory(NamedTuple):
    """Reference frame, its corners, the last motions, and the camera's noise."""

    reference: StereoFrame | None = None
    corners: Points | None = None
    belief: Belief = Belief()
    noise: float = 0.0  # of the camera, once it was seen [grey levels]
    consistency: SelfConsistency = SelfConsistency()


class CircularOdometry:
    """Stereo odometry from frame to frame with sub-pixel tracks (after VISO2-S)."""

    def __init__(self, calibration: StereoCalibration, *, seed: int = 0) -> None:
        """An odometry for this rig; ``seed`` and a frame's tick fix the draws of RANSAC.

        Raises:
            ValueError: if the left camera is not above the ground.
        """
        self._calibration = above_ground(calibration)
        self._seed = seed

    def init(self) -> OdometryMemory:
        """Memory before the first frame."""
        return OdometryMemory()

    def step(self, memory: OdometryMemory, frame: StereoFrame) -> tuple[OdometryMemory, Motion | None]:
        """Memory with the frame in it, and the motion since the frame before; None for the first frame.

        A frame without texture (dark, blinded) is lost and skipped: the next motion starts again at the frame before,
        unless that is too old. A repeated frame is lost and skipped as well. After an implausible jump of velocity the
        odometry is lost until the next motion confirms it.
        """
        frame, reference, before = match_exposures(self._calibration, frame), memory.reference, memory.belief
        if reference is None or memory.corners is None:
            return OdometryMemory(frame, detect_corners(frame.left, per_bucket=PER_BUCKET)), None
        if is_repeated(reference.left, frame.left, memory.noise, before.last):
            return memory, lost_motion(frame.tick, reference.tick)
        corners = detect_corners(frame.left, per_bucket=PER_BUCKET)
        motion = self.motion(reference, memory.corners, frame, before.newest)
        if motion.health is Health.LOST and is_skipped(len(corners), motion, before.newest):
            return memory, motion
        belief, motion = believed(before, motion)
        lost = motion.health is Health.LOST
        noise = memory.noise if lost or memory.noise else visible_noise(reference.left, frame.left)
        consistency, motion = stated(memory.consistency, motion, self._calibration.focal_length)
        return OdometryMemory(frame, corners, belief, noise, consistency), motion

    def motion(self, reference: StereoFrame, corners: Points, frame: StereoFrame, last: Motion | None) -> Motion:
        """Motion since the reference frame with its corners, near the motion predicted from the last velocity.

        If there is none near the prediction, any motion is accepted, searched from rest and marked as degraded. The
        covariance counts features as independent. Frames whose exposures differ are compared once more at the points
        that were tracked.
        """
        exposed, limited = match_over_time(reference, frame)
        if exposed is reference:
            return self._searched(reference, corners, frame, last)
        in_both = detect_corners(exposed.left, per_bucket=PER_BUCKET)  # those that are not clipped in either image
        motion = self._searched(exposed, in_both, limited, last)
        if motion.health is Health.LOST:
            return motion
        exposed, limited = match_over_time(reference, frame, motion.tracks)
        if exposed is reference:
            return self._searched(reference, corners, frame, last)
        again = self._searched(exposed, in_both, limited, last)
        return motion if again.health is Health.LOST else again

    def _searched(self, reference: StereoFrame, corners: Points, frame: StereoFrame, last: Motion | None) -> Motion:
        """Motion between frames of equal exposures, searched near the prediction and then from rest."""
        guesses = [(np.eye(4), np.inf)]
        if last is not None:
            ticks = frame.tick - reference.tick
            predicted = stretched(last.X_PC, ticks / (last.tick - last.previous_tick))
            guesses.insert(0, (predicted, search_radius(ticks)))
        for guess, reach in guesses:
            motion = self._measured(guess, reach, reference, corners, frame)
            if motion.health is Health.DEGRADED:  # a wrong guess costs matches
                again = self._measured(motion.X_PC, reach, reference, corners, frame)
                motion = again if again.inliers > motion.inliers else motion
            if motion.health is not Health.LOST:
                break
        unpredicted = last is not None and reach == np.inf
        return replace(motion, health=Health.DEGRADED) if unpredicted and motion.health is Health.OK else motion

    def _measured(
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


def is_skipped(corners: int, lost: Motion, last: Motion | None) -> bool:
    """True if a frame on which the odometry was lost is skipped: it has few corners, and the frame before is near.

    Near is what is recent, or what the last motion, continued, has left behind by a short way only.
    """
    ticks = lost.tick - lost.previous_tick
    if corners >= ENOUGH_MATCHES:
        return False
    if ticks < LONGEST_SPAN:
        return True
    if last is None:
        return False
    travel = np.linalg.norm(last.X_PC[:3, 3]) * ticks / (last.tick - last.previous_tick)
    return bool(travel < _SHARED_VIEW)


def search_radius(ticks: int) -> float:
    """Largest distance of a motion over ``ticks`` from the motion predicted at the last velocity [m]."""
    return LARGEST_ACCELERATION * (ticks * TICK) ** 2
