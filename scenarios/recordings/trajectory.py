"""Camera trajectories from the odometry's motions, and the text formats of TUM and KITTI.

Poses are those of the left camera (x right, y down, z ahead) relative to its first frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from estimators.estimates import Health, Motion
from estimators.rigid_motion import chained, stretched
from vehicle.frames import FloatArray, inverse, is_rotation, orthonormalised, transform
from vehicle.user_file import MAX_FRAMES, FileKind, read_text

_FARTHEST = 1e8  # position, in any map [m]


def camera_poses(ticks: Sequence[int], motions: Sequence[Motion]) -> FloatArray:
    """Poses X_C0C (n, 4, 4) of the left camera at these ticks.

    A lost motion is replaced by one at the last velocity, until a later motion that starts before it corrects the pose.
    Poses at ticks without a motion are interpolated at constant velocity; before the first motion and after the last
    one the pose is constant.
    """
    known = _chained(motions)
    ticks_known = np.array(sorted(known), dtype=np.int64)
    poses = np.tile(np.eye(4), (len(ticks), 1, 1))
    for pose, tick in zip(poses, ticks, strict=True):
        if tick in known:
            pose[:] = known[tick]
        elif len(ticks_known) and tick > ticks_known[0]:
            after = int(np.searchsorted(ticks_known, tick))
            before = int(ticks_known[after - 1])
            pose[:] = known[before]
            if after < len(ticks_known):
                ratio = (tick - before) / (int(ticks_known[after]) - before)
                pose[:] = pose @ stretched(inverse(pose) @ known[int(ticks_known[after])], ratio)
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
    """One line ``time x y z q_x q_y q_z q_w`` per pose, in s and m."""
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = np.column_stack([poses[:, :3, 3], quaternions])
    lines = [f"{t:.6f} " + " ".join(f"{value:.9f}" for value in row) for t, row in zip(times, rows, strict=True)]
    return "\n".join(
        ["# time [s], position [m] and quaternion (x y z w) of the left camera in its first pose", *lines, ""]
    )


def kitti_text(poses: FloatArray) -> str:
    """One line per pose: the 12 numbers of its 3x4 matrix, row by row."""
    return "".join(" ".join(f"{value:.12e}" for value in pose[:3].ravel()) + "\n" for pose in poses)


def read_kitti_poses(path: Path, lines: int) -> FloatArray:
    """Read poses (n, 4, 4) from a file with one line of 12 numbers per frame.

    Raises:
        ValueError: one line, if a line has another form, or if the numbers of lines and frames differ.
    """
    text = read_text(path, FileKind.TABLE).splitlines()
    if len(text) > MAX_FRAMES:
        raise ValueError(f"{path} has {len(text)} lines: a recording must have at most {MAX_FRAMES} frames")
    poses = [_pose(path, k, line.split()) for k, line in enumerate(text, start=1) if line.strip()]
    if not lines <= len(poses) <= lines + 1:  # an interrupted recording may have one more
        raise ValueError(f"{path} has {len(poses)} poses for {lines} frames: repair it or remove it")
    return np.array(poses)


def _pose(path: Path, number: int, row: list[str]) -> FloatArray:
    try:
        matrix = np.array([float(value) for value in row]).reshape(3, 4)
    except ValueError:
        raise ValueError(f"{path}, line {number}: a pose is 12 numbers, the 3x4 matrix row by row") from None
    if not np.all(np.abs(matrix) <= _FARTHEST):
        raise ValueError(f"{path}, line {number}: numbers must be finite, positions within {_FARTHEST:g} m")
    if not is_rotation(matrix[:, :3], 1e-2):  # benchmark files are good to 1e-6
        raise ValueError(f"{path}, line {number}: the first three columns are not a rotation")
    return transform(orthonormalised(matrix[:, :3]), matrix[:, 3])
