"""Stereo odometry from frame to frame, by circular matching.

Follows the steps of VISO2-S as de Saxe 2018, section 2.1, lists them (corners, circular matching, buckets, RANSAC,
Gauss-Newton on the reprojection error), with sub-pixel tracks. In place of the Kalman filter, the motion at the last
velocity is the initial guess: a filter would smooth the increments whose sum is wanted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.context import above_ground
from estimators.estimates import Health, Motion, lost_motion
from estimators.odometry.covariance import SelfConsistency, stated
from estimators.odometry.exposure import alike, both_alike
from estimators.odometry.image_points import Matches, Points, detect_corners, match
from estimators.odometry.plausibility import LARGEST_ACCELERATION, Belief, judged
from estimators.odometry.pose import Observations, Solution, consensus, point_covariance, refined
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
        frame, reference = alike(self._calibration, frame), memory.reference
        if reference is None or memory.corners is None:
            return OdometryMemory(frame, detect_corners(frame.left, per_bucket=PER_BUCKET)), None
        if is_repeated(reference.left, frame.left, memory.noise, memory.belief.last):
            return memory, lost_motion(frame.tick, reference.tick)
        corners = detect_corners(frame.left, per_bucket=PER_BUCKET)
        motion = self.motion(reference, memory.corners, frame, memory.belief.newest)
        if motion.health is Health.LOST and is_skipped(len(corners), motion, memory.belief.newest):
            return memory, motion
        belief, motion = judged(memory.belief, motion)
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
        exposed, limited = both_alike(reference, frame)
        if exposed is reference:
            return self._motion(reference, corners, frame, last)
        in_both = detect_corners(exposed.left, per_bucket=PER_BUCKET)  # those that are not clipped in either image
        motion = self._motion(exposed, in_both, limited, last)
        if motion.health is Health.LOST:
            return motion
        exposed, limited = both_alike(reference, frame, motion.tracks)
        if exposed is reference:
            return self._motion(reference, corners, frame, last)
        again = self._motion(exposed, in_both, limited, last)
        return motion if again.health is Health.LOST else again

    def _motion(self, reference: StereoFrame, corners: Points, frame: StereoFrame, last: Motion | None) -> Motion:
        """Motion between frames of equal exposures."""
        if last is None:
            return self._rematched(np.eye(4), np.inf, reference, corners, frame)
        ticks = frame.tick - reference.tick
        guess = stretched(last.X_PC, ticks / (last.tick - last.previous_tick))
        motion = self._rematched(guess, search_radius(ticks), reference, corners, frame)
        if motion.health is not Health.LOST:
            return motion
        motion = self._rematched(np.eye(4), np.inf, reference, corners, frame)
        return replace(motion, health=Health.DEGRADED) if motion.health is Health.OK else motion

    def _rematched(
        self, guess: FloatArray, reach: float, reference: StereoFrame, corners: Points, frame: StereoFrame
    ) -> Motion:
        """Motion near the guess; a degraded one becomes the next guess, as a wrong guess costs matches."""
        first = self._motion_near(guess, reach, reference, corners, frame)
        if first.health is not Health.DEGRADED:
            return first
        second = self._motion_near(first.X_PC, reach, reference, corners, frame)
        return second if second.inliers > first.inliers else first

    def _motion_near(
        self, guess: FloatArray, reach: float, reference: StereoFrame, corners: Points, frame: StereoFrame
    ) -> Motion:
        matches = match(self._calibration, reference, corners, frame, guess)
        solution = None
        if len(matches.current) >= _FEWEST_INLIERS:
            rng = np.random.default_rng([self._seed, frame.tick])
            points = triangulate(self._calibration, matches.previous)
            agreed = consensus(self._calibration, points, matches.current, guess, reach, rng)
            if np.count_nonzero(agreed.inliers) >= _FEWEST_INLIERS:
                covariance = point_covariance(self._calibration, points, _SHARE)
                variance = np.broadcast_to(_SHARE, points.shape)
                observations = Observations(points, covariance, matches.current, variance)
                solution = refined(self._calibration, observations, agreed.X_PC, agreed.inliers)
        return _message(reference.tick, frame.tick, matches, solution)


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


def _message(previous_tick: int, tick: int, matches: Matches, solution: Solution | None) -> Motion:
    """Motion message with its health; lost without a solution that has enough inliers."""
    inliers = np.zeros(len(matches.current), np.bool_) if solution is None else solution.inliers
    agreeing = int(np.count_nonzero(inliers))
    X_PC, covariance, health = np.eye(4), np.diag(np.full(6, np.inf)), Health.LOST
    if solution is not None and solution.converged and agreeing >= _FEWEST_INLIERS:
        X_PC, covariance = solution.X_PC, solution.covariance
        doubtful = len(inliers) < ENOUGH_MATCHES or agreeing < _AGREEING * len(inliers)
        health = Health.DEGRADED if doubtful else Health.OK
    tracks = np.column_stack([matches.previous[:, :2], matches.current[:, :2]])[inliers]
    return Motion(
        tick=tick,
        previous_tick=previous_tick,
        X_PC=X_PC,
        covariance=covariance,
        matches=len(inliers),
        inliers=agreeing,
        health=health,
        tracks=tracks.astype(np.float32),
        halves=None if solution is None else solution.differences,
    )
