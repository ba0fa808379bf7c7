"""Agreement of an odometry with itself: halves of the images, and forwards against backwards in time.

Both need no truth. Estimates from the left and the right halves of the images have independent noise, so they differ by
what their standard deviations state, if these are right. Backwards in time the images are the same, but errors that
depend on the direction of travel change their sign; the common noise makes differences smaller than stated.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from estimators.context import Odometry
from estimators.estimates import Health, Motion
from estimators.rigid_motion import inverted, rotation_vector
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

_SETTLED = 5  # motions after which averages over frames mean something


class Agreement(NamedTuple):
    """RMS differences (6,) of single motions, by component, in stated standard deviations; NaN without any."""

    halves: FloatArray
    backwards: FloatArray


def agreement(
    calibration: StereoCalibration,
    frames: Sequence[StereoFrame],
    kind: Callable[[StereoCalibration], Odometry[Any]],
) -> Agreement:
    """Agreement of the odometries that ``kind`` constructs, on rectified frames; as long as three odometries."""
    if not frames:
        return Agreement(np.full(6, np.nan), np.full(6, np.nan))
    left, right = (_motions(kind(halved(calibration, side)), _halves(frames, side)) for side in (0, 1))
    forward, backward = (_motions(kind(calibration), part) for part in (frames, backwards(frames)))
    return Agreement(_rms(left, right), _rms(forward, [_turned(motion, frames[-1].tick) for motion in backward]))


def halved(calibration: StereoCalibration, side: int) -> StereoCalibration:
    """Calibration of the left (0) or right (1) halves of both images."""
    width = calibration.width // 2
    return replace(calibration, width=width, cx=calibration.cx - side * (calibration.width - width))


def backwards(frames: Sequence[StereoFrame]) -> list[StereoFrame]:
    """Frames in the opposite order, at the same intervals, from tick 0 on."""
    return [replace(frame, tick=frames[-1].tick - frame.tick) for frame in reversed(frames)]


def _halves(frames: Sequence[StereoFrame], side: int) -> list[StereoFrame]:
    whole = frames[0].left.shape[1]
    columns = slice(whole // 2) if side == 0 else slice(whole - whole // 2, whole)
    return [
        replace(frame, left=frame.left[:, columns].copy(), right=frame.right[:, columns].copy(), colour=None)
        for frame in frames
    ]


def _motions(odometry: Odometry[Any], frames: Sequence[StereoFrame]) -> list[Motion]:
    """Motions that were not lost, without the first ones."""
    memory, motions = odometry.init(), []
    for frame in frames:
        memory, motion = odometry.step(memory, frame)
        if motion is not None:
            motions.append(motion)
    return [motion for motion in motions[_SETTLED:] if motion.health is not Health.LOST]


def _turned(motion: Motion, last: int) -> Motion:
    """Motion of frames backwards in time, as one of the frames forwards, which end at the tick ``last``."""
    X, covariance, _ = inverted(motion.uncertain)
    tick, previous_tick = last - motion.previous_tick, last - motion.tick
    return replace(motion, tick=tick, previous_tick=previous_tick, X_PC=X, covariance=covariance)


def _rms(motions: Sequence[Motion], others: Sequence[Motion]) -> FloatArray:
    """RMS difference (6,) of motions between the same frames, in standard deviations."""
    by_ticks = {(motion.previous_tick, motion.tick): motion for motion in others}
    ratios = []
    for motion in motions:
        other = by_ticks.get((motion.previous_tick, motion.tick))
        if other is not None:
            turn = rotation_vector(motion.X_PC[:3, :3] @ other.X_PC[:3, :3].T)
            difference = np.concatenate([turn, motion.X_PC[:3, 3] - other.X_PC[:3, 3]])
            ratios.append(difference / np.sqrt(np.diag(motion.covariance + other.covariance)))
    return np.sqrt(np.mean(np.square(ratios), axis=0)) if ratios else np.full(6, np.nan)
