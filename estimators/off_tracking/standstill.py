"""Standstill detection: a significance test of the motions against their own uncertainty.

At standstill the noise of an odometry from frame to frame would move the trailer off its path. Motions that are not
significant, singly and in sum, are withheld. As soon as some of them together are significant, the trailer has moved,
and they are released as one motion. So a slow start loses nothing, and a standstill adds no motion and no uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from estimators.rigid_motion import UncertainMotion, composed, rotation_vector
from vehicle.frames import FloatArray

_WINDOW = 15  # consecutive motions that are tested together; detects a creep of a third of a sigma
_GATE = 25.0  # largest squared normalised motion (yaw, x, y) at standstill: noise exceeds it once in 60 000 times
_PLANAR = [2, 3, 4]  # yaw, x and y; roll, pitch and heave are not travel
_LEAST = np.diag([1e-6, 1e-5, 1e-5]) ** 2  # of motions with zero covariance: rounding [rad, m]
_MOST = np.array([0.003, 0.02, 0.02])  # largest motion that can be noise: a tenth of a second at walking pace [rad, m]


class Step(NamedTuple):
    """Motion, and the tick of the keyframe it was measured from, if any."""

    motion: UncertainMotion
    keyframe: int | None


Withheld = tuple[Step, ...]  # oldest first


def released(withheld: Withheld, step: Step) -> tuple[Withheld, UncertainMotion | None]:
    """Withheld motions after one more, and the released motion; None: the trailer stands."""
    noise_alone = _can_be_noise(step.motion)
    if not (noise_alone or withheld):
        return (), step.motion
    steps = (*withheld, step)[-_WINDOW:]
    sums = list(accumulate((s.motion for s in reversed(steps)), lambda newer, older: composed(older, newer)))
    scores = [_score(total, _covariance(steps[-k:], total)) for k, total in enumerate(sums, start=1)]
    if noise_alone and max(scores) < _GATE:
        return steps, None
    return (), sums[int(np.argmax(scores))]


def _can_be_noise(motion: UncertainMotion) -> bool:
    """True if the motion and its standard deviation are both small."""
    std = np.sqrt(np.diag(motion.covariance)[_PLANAR])
    return bool(np.all(np.abs(_planar(motion.X)) < _MOST) and np.all(std < _MOST))


def _covariance(steps: Sequence[Step], total: UncertainMotion) -> FloatArray:
    """Covariance (6, 6) of the total; errors of motions from one keyframe do not accumulate."""
    one_keyframe = steps[0].keyframe is not None and all(step.keyframe == steps[0].keyframe for step in steps)
    if not one_keyframe:
        return total.covariance
    mean: FloatArray = reduce(np.add, (step.motion.covariance for step in steps)) / len(steps)
    return mean


def _score(total: UncertainMotion, covariance: FloatArray) -> float:
    """Squared normalised planar motion."""
    moved = _planar(total.X)
    return float(moved @ np.linalg.solve(covariance[np.ix_(_PLANAR, _PLANAR)] + _LEAST, moved))


def _planar(X: FloatArray) -> FloatArray:
    """Yaw [rad], x and y [m] (3,) of a small motion."""
    return np.array([rotation_vector(X[:3, :3])[2], X[0, 3], X[1, 3]])
