"""Camera motions as the path gets them after their comparison with dead reckoning, and motions in their place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimators.estimates import Health
from estimators.off_tracking.buffer import BodyMotion, BufferMemory
from estimators.off_tracking.dead_reckoning import Reckoned
from estimators.rigid_motion import rotation_vector
from vehicle.frames import FloatArray, inverse, so3_exp, transform

PLANAR = [2, 3, 4]  # yaw, x and y of a rotation vector and a translation
# What dead reckoning leaves out, 1 sigma: roll and pitch of the body on an uneven road, and its heave.
_OUT_OF_PLANE = np.diag([0.01, 0.01, 0.0, 0.0, 0.0, 0.05]) ** 2  # [rad], [m]


def from_reference(path: BufferMemory, motion: BodyMotion, reference: int) -> BodyMotion | None:
    """The motion from the reference instead, through a keyframe that is as old; None if there is none."""
    anchor = motion.anchor
    if motion.previous_tick == reference or anchor is None or anchor.tick > reference:
        return None
    X_OS = {sample.tick: sample.X_OS for sample in path.samples}
    if anchor.tick not in X_OS or reference not in X_OS:
        return None
    X_PA = inverse(X_OS[reference]) @ X_OS[anchor.tick]
    R = np.kron(np.eye(2), X_PA[:3, :3])
    covariance = R @ anchor.covariance @ R.T
    return replace(motion, previous_tick=reference, X_PC=X_PA @ anchor.X_AC, covariance=covariance)


def weighted(
    motion: BodyMotion, reckoned: Reckoned, innovation: FloatArray, innovation_covariance: FloatArray
) -> BodyMotion:
    """The motion with its yaw, x and y weighted with those of dead reckoning, by their covariances (3, 3)."""
    P = reckoned.covariance
    gain = np.linalg.solve(innovation_covariance, P).T
    turn, x, y = (reckoned.pose + gain @ innovation).tolist()
    own = float(rotation_vector(motion.X_PC[:3, :3])[2])
    X_PC = transform(so3_exp(np.array([0.0, 0.0, turn - own])) @ motion.X_PC[:3, :3], np.array([x, y, 0.0]))
    X_PC[2, 3] = motion.X_PC[2, 3]
    covariance = np.diag(np.diag(motion.covariance))
    covariance[np.ix_(PLANAR, PLANAR)] = P - gain @ P
    return replace(motion, X_PC=X_PC, covariance=0.5 * (covariance + covariance.T))


def doubted(motion: BodyMotion, misfit: float) -> BodyMotion:
    """The motion, degraded, with its covariances multiplied by the misfit."""
    anchor = motion.anchor
    if anchor is not None:
        anchor = replace(anchor, covariance=misfit * anchor.covariance)
    return replace(motion, covariance=misfit * motion.covariance, health=Health.DEGRADED, anchor=anchor)


def spatial(covariance: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a motion from that of its yaw, x and y."""
    spatial = _OUT_OF_PLANE.copy()
    spatial[np.ix_(PLANAR, PLANAR)] = covariance
    return spatial


def lost_motion(path: BufferMemory, tick: int) -> BodyMotion:
    """A motion without information from the newest sample of the path."""
    return BodyMotion(
        tick=tick,
        previous_tick=path.samples[0].tick,
        X_PC=np.eye(4),
        covariance=np.diag(np.full(6, np.inf)),
        health=Health.LOST,
    )
