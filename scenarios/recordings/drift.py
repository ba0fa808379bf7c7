"""Drift of an odometry as defined by the KITTI odometry benchmark.

Geiger 2012: A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite",
CVPR 2012. Subsequences of 100, 200, … 800 m start at every tenth frame. For each, the relative pose of the estimate is
compared with the true one. The errors of translation and rotation are divided by the length and averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.rigid_motion import rotation_vector
from vehicle.frames import FloatArray, inverse

KITTI_LENGTHS: Final = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)  # [m]
KITTI_EVERY: Final = 10  # frames between the starts of subsequences


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Mean errors over all subsequences."""

    translation: float  # error over length [-]
    rotation: float  # [rad/m]
    lengths: tuple[float, ...]  # of the subsequences that occurred [m]
    subsequences: int


def drift(
    true: FloatArray, estimated: FloatArray, lengths: Sequence[float] = KITTI_LENGTHS, every: int = KITTI_EVERY
) -> Drift | None:
    """Drift of estimated poses (n, 4, 4) against true ones; None if the path is shorter than every length.

    Both are poses of the same body at the same frames. Their world frames may differ.
    """
    steps = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    errors = []
    for first in range(0, len(true), every):
        for length in lengths:
            last = int(np.searchsorted(distance, distance[first] + length, side="right"))
            if last < len(true):
                errors.append((length, *_errors(true, estimated, first, last, length)))
    if not errors:
        return None
    table = np.array(errors)
    return Drift(
        translation=float(table[:, 1].mean()),
        rotation=float(table[:, 2].mean()),
        lengths=tuple(float(length) for length in np.unique(table[:, 0])),
        subsequences=len(table),
    )


def _errors(true: FloatArray, estimated: FloatArray, first: int, last: int, length: float) -> tuple[float, float]:
    """Translation error [-] and rotation error [rad/m] of one subsequence."""
    X_true = inverse(true[first]) @ true[last]
    X_estimated = inverse(estimated[first]) @ estimated[last]
    X_error = inverse(X_estimated) @ X_true
    turn = float(np.linalg.norm(rotation_vector(X_error[:3, :3])))
    return float(np.linalg.norm(X_error[:3, 3])) / length, turn / length
