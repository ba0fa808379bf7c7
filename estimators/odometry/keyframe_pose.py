"""The pose of a pair against the keyframes: tracks, RANSAC with the prediction as a hypothesis, joint adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.keyframe_tracking import Tracks, tracked
from estimators.odometry.keyframes import Keyframe
from estimators.odometry.pose import Sightings, own_covariance, refined
from estimators.odometry.ransac import consensus
from estimators.rigid_motion import UncertainMotion
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray, inverse

_FEWEST_INLIERS = 25  # fewer may agree by chance
_TRACKED = 0.3  # least share of the points looked for; with fewer the prediction was wrong, or the view is another


class Located(NamedTuple):
    """Where the pair was, measured from the newest keyframe N."""

    measured: UncertainMotion  # X_NC, covariance along the axes of N
    own: FloatArray  # (6, 6) the part of the covariance that this pair alone brings in, not the keyframes
    tracks: Tracks
    agreeing: NDArray[np.bool_]  # (n,) tracks that the pose rests on


def located(
    calibration: StereoCalibration,
    keyframes: Sequence[Keyframe],
    frame: StereoFrame,
    X_OC: FloatArray,
    reach: float,
    rng: np.random.Generator,
) -> Located | None:
    """The pose near the predicted ``X_OC``, not farther than ``reach`` [m]; None if too few points say so."""
    tracks = tracked(calibration, keyframes, frame, X_OC)
    needed = max(_FEWEST_INLIERS, int(_TRACKED * len(tracks.found)))
    found = np.flatnonzero(tracks.found)
    if len(found) < needed:
        return None
    seen = Sightings(*(of_all[found] for of_all in tracks.seen))
    agreed = consensus(calibration, seen.points, seen.z, inverse(keyframes[0].X_OK) @ X_OC, reach, rng)
    if np.count_nonzero(agreed.inliers) < needed:
        return None
    solution = refined(calibration, seen, agreed.X_PC, agreed.inliers)
    if not solution.converged or np.count_nonzero(solution.inliers) < needed:
        return None
    agreeing = np.zeros(len(tracks.found), np.bool_)
    agreeing[found[solution.inliers]] = True
    own = own_covariance(calibration, seen, solution)
    return Located(UncertainMotion(solution.X_PC, solution.covariance), own, tracks, agreeing)
