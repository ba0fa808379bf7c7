"""Errors of single motions against the recorded poses."""

from __future__ import annotations

import numpy as np

from estimators.estimates import Health, Motion
from estimators.rigid_motion import rotation_vector
from scenarios.recordings.estimation import Estimation
from vehicle.frames import FloatArray, inverse


def motions_found(estimation: Estimation) -> list[Motion]:
    """Motions that were not lost."""
    motions = [frame.motion for frame in estimation.frames if frame.motion is not None]
    return [motion for motion in motions if motion.health is not Health.LOST]


def motion_errors(estimation: Estimation) -> FloatArray:
    """Errors (n, 6) of single motions by the recorded poses, in stated standard deviations; none without poses."""
    poses = estimation.recording.poses
    if poses is None:
        return np.empty((0, 6))
    pose = {frame.files.tick: X for frame, X in zip(estimation.frames, poses, strict=False)}
    ratios = []
    for motion in motions_found(estimation):
        X_true = inverse(pose[motion.previous_tick]) @ pose[motion.tick]
        turn = rotation_vector(X_true[:3, :3] @ motion.X_PC[:3, :3].T)
        error = np.concatenate([turn, X_true[:3, 3] - motion.X_PC[:3, 3]])
        ratios.append(error / np.sqrt(np.diag(motion.covariance)))
    return np.array(ratios).reshape(-1, 6)
