"""Camera trajectories: chained from the odometry's motions, and as text in the formats of TUM and KITTI.

Poses are those of the left camera (x right, y down, z ahead) from its first frame on.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from estimators.estimates import Health, Motion
from estimators.rigid_motion import chained, stretched
from vehicle.frames import FloatArray, inverse, orthonormalised, transform


def camera_poses(ticks: Sequence[int], motions: Sequence[Motion]) -> FloatArray:
    """Poses X_C0C (n, 4, 4) of the left camera at these ticks.

    A lost motion is bridged at the last velocity; what a later motion from before it tells takes its place. Ticks
    without a motion lie on the motion at constant velocity between their neighbours; before the first motion and
    after the last one nothing moves.
    """
    known = _chained(motions)
    there = np.array(sorted(known), dtype=np.int64)
    poses = np.tile(np.eye(4), (len(ticks), 1, 1))
    for pose, tick in zip(poses, ticks, strict=True):
        if tick in known:
            pose[:] = known[tick]
        elif len(there) and tick > there[0]:
            after = int(np.searchsorted(there, tick))
            before = int(there[after - 1])
            pose[:] = known[before]
            if after < len(there):
                ratio = (tick - before) / (int(there[after]) - before)
                pose[:] = pose @ stretched(inverse(pose) @ known[int(there[after])], ratio)
    return poses


def _chained(motions: Sequence[Motion]) -> dict[int, FloatArray]:
    """Poses X_C0C by tick."""
    poses: dict[int, FloatArray] = {}
    last: Motion | None = None
    for motion in motions:
        X_PC = motion.X_PC
        if motion.health is not Health.LOST:
            last = motion
        elif last is not None:
            X_PC = stretched(last.X_PC, (motion.tick - motion.previous_tick) / (last.tick - last.previous_tick))
        start = poses.setdefault(motion.previous_tick, np.eye(4) if not poses else poses[max(poses)])
        poses[motion.tick] = chained(start, X_PC)
    return poses


def tum_text(times: Sequence[float], poses: FloatArray) -> str:
    """A line ``time x y z q_x q_y q_z q_w`` for every pose, [s] and [m]."""
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = np.column_stack([poses[:, :3, 3], quaternions])
    lines = [f"{t:.6f} " + " ".join(f"{value:.9f}" for value in row) for t, row in zip(times, rows, strict=True)]
    return "\n".join(
        ["# time [s], position [m] and quaternion (x y z w) of the left camera in its first pose", *lines, ""]
    )


def kitti_text(poses: FloatArray) -> str:
    """A line of the 12 numbers of the 3x4 pose matrix, row by row, for every pose."""
    return "".join(" ".join(f"{value:.12e}" for value in pose[:3].ravel()) + "\n" for pose in poses)


def read_kitti_poses(path: Path, lines: int) -> FloatArray:
    """Poses (n, 4, 4) from a file with one line of 12 numbers a frame.

    Raises:
        ValueError: one line, if the file is no such list, or has not as many lines as there are frames.
    """
    try:
        text = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    rows = [(k, line.split()) for k, line in enumerate(text, start=1) if line.strip()]
    poses = [_pose(path, k, row) for k, row in rows]
    if not lines <= len(poses) <= lines + 1:  # a recording that was cut off may have one too many
        raise ValueError(f"{path} has {len(poses)} poses for {lines} frames: repair it, or move it away")
    return np.array(poses)


def _pose(path: Path, number: int, row: list[str]) -> FloatArray:
    try:
        matrix = np.array([float(value) for value in row]).reshape(3, 4)
    except ValueError:
        raise ValueError(f"{path}, line {number}: a pose is 12 numbers, the 3x4 matrix row by row") from None
    if not np.allclose(matrix[:, :3] @ matrix[:, :3].T, np.eye(3), atol=1e-2):  # benchmark files are good to 1e-6
        raise ValueError(f"{path}, line {number}: the first three columns are no rotation")
    return transform(orthonormalised(matrix[:, :3]), matrix[:, 3])
