"""Drives of a trailer's body as motions from frame to frame, and the off-tracking buffer that follows them."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from estimators.estimates import Anchor, Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from vehicle.frames import FloatArray, Pose2, inverse, rotation_zyx, so3_exp, transform

FRAME = 100  # [ticks]
# As VISO2 states them on rendered frames: 0.08 mrad of yaw, 1.8 mm along and 2.9 mm across at the hitch.
NOISE = np.diag([0.2e-3, 0.2e-3, 0.08e-3, 1.8e-3, 2.9e-3, 2e-3])


def body(pose: Pose2, pitch: float = 0.0, roll: float = 0.0) -> FloatArray:
    return transform(rotation_zyx(pose.psi, pitch, roll), np.array([pose.x, pose.y, 0.0]))


def winding(t: float) -> Pose2:
    """A hitch path of varying curvature with a slip that varies as well; t is x [m]."""
    heading = math.atan(0.3 * math.cos(t / 8.0) * 2.0)
    return Pose2(t, 4.8 * math.sin(t / 8.0), heading - 0.15 - 0.1 * math.sin(t / 5.0))


def motion(
    first: int, second: int, X_PC: FloatArray, health: Health = Health.OK, covariance: FloatArray | None = None
) -> BodyMotion:
    """Motion between two frames; exact without a covariance."""
    if health is Health.LOST:
        return BodyMotion.lost(FRAME * second, FRAME * first)
    stated = np.zeros((6, 6)) if covariance is None else covariance
    return BodyMotion(tick=FRAME * second, previous_tick=FRAME * first, X_PC=X_PC, covariance=stated, health=health)


def disturbed(X: FloatArray, error: FloatArray) -> FloatArray:
    """Motion with an error (6,) along the axes that it starts from."""
    return transform(so3_exp(error[:3]) @ X[:3, :3], X[:3, 3] + error[3:])


def anchored_motions(
    poses: Sequence[FloatArray],
    keyframe_of: Callable[[int], int],
    error: Callable[[], FloatArray],
    covariance: FloatArray,
    *,
    anchored: bool = True,
) -> list[BodyMotion]:
    """Motions of which each was measured from its keyframe, with an error (6,) of the covariance (6, 6)."""
    found, motions = [poses[0]], []
    for k in range(1, len(poses)):
        key = keyframe_of(k)
        X_AC = disturbed(inverse(poses[key]) @ poses[k], error())
        found.append(found[key] @ X_AC)
        between = motion(k - 1, k, inverse(found[k - 1]) @ found[k], covariance=covariance)
        if anchored:
            anchor = Anchor(tick=FRAME * key, X_AC=X_AC, covariance=covariance)
            between = replace(between, covariance=2.0 * covariance, anchor=anchor)
        motions.append(between)
    return motions


def followed(buffer: OffTrackingBuffer, motions: Iterable[BodyMotion]) -> tuple[BufferMemory, list[OffTracking]]:
    """Memory of a buffer after the motions, and its estimates."""
    memory, results = buffer.init(), []
    for one in motions:
        memory, result = buffer.step(memory, one)
        results.append(result)
    return memory, results
