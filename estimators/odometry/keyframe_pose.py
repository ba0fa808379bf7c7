"""Pose of a stereo pair relative to keyframes: tracking, RANSAC with the prediction as a hypothesis, refinement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.keyframe_tracking import Tracks, tracked
from estimators.odometry.keyframes import Keyframe
from estimators.odometry.pose import Observations, own_covariance, refined
from estimators.odometry.ransac import consensus
from estimators.rigid_motion import UncertainMotion
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray, inverse

_FEWEST_INLIERS = 25  # fewer may agree by chance
_TRACKED = 0.3  # least share of tracked points; with fewer the prediction is wrong or the view has changed


class Located(NamedTuple):
    """Pose of the pair, measured from the newest keyframe N."""

    measured: UncertainMotion  # X_NC, covariance along the axes of N
    own: FloatArray  # (6, 6) part of the covariance that comes from this pair, not from the keyframes
    tracks: Tracks
    agreeing: NDArray[np.bool_]  # (n,) inliers of the pose


def located(
    calibration: StereoCalibration,
    keyframes: Sequence[Keyframe],
    frame: StereoFrame,
    X_OC: FloatArray,
    reach: float,
    rng: np.random.Generator,
) -> Located | None:
    """Pose within ``reach`` [m] of the predicted ``X_OC``; None if too few points agree."""
    tracks = tracked(calibration, keyframes, frame, X_OC)
    needed = max(_FEWEST_INLIERS, int(_TRACKED * len(tracks.found)))
    found = np.flatnonzero(tracks.found)
    if len(found) < needed:
        return None
    observed = Observations(*(of_all[found] for of_all in tracks.observations))
    agreed = consensus(calibration, observed.points, observed.z, inverse(keyframes[0].X_OK) @ X_OC, reach, rng)
    if np.count_nonzero(agreed.inliers) < needed:
        return None
    solution = refined(calibration, observed, agreed.X_PC, agreed.inliers)
    if not solution.converged or np.count_nonzero(solution.inliers) < needed:
        return None
    agreeing = np.zeros(len(tracks.found), np.bool_)
    agreeing[found[solution.inliers]] = True
    own = own_covariance(calibration, observed, solution)
    return Located(UncertainMotion(solution.X_PC, solution.covariance), own, tracks, agreeing)
