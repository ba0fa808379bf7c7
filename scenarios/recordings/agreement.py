"""Agreement of an odometry with itself on a recording, for the summary."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from estimators.calibration.right_rotation import straightened
from estimators.calibration.self_calibrated_motion import SelfCalibratedMotion
from estimators.odometry.agreement import agreement
from estimators.protocol import Odometry
from scenarios.recordings.estimation import Estimation
from scenarios.recordings.images import Dropped, stream
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame


def agreement_numbers(
    estimation: Estimation, kind: Callable[[StereoCalibration], Odometry[Any]]
) -> dict[str, float | None]:
    """RMS differences of motions in stated standard deviations, over all components; null without common motions.

    All images are read again.
    """
    result = agreement(estimation.recording.calibration, straight_frames(estimation), kind)
    rms = {"halves_rms_sigma": result.halves, "backwards_rms_sigma": result.backwards}
    values = {name: float(np.sqrt(np.mean(np.square(value)))) for name, value in rms.items()}
    return {name: round(value, 3) if math.isfinite(value) else None for name, value in values.items()}


def straight_frames(estimation: Estimation, most: int | None = None) -> list[StereoFrame]:
    """Frames of the estimation, at ``most`` the first ones; right images by the rotation that it ended with."""
    recording = estimation.recording
    files = recording.sequence.frames[: len(estimation.frames)][:most]
    return [
        _straight(estimation, recording.rectified(frame))
        for _, frame in stream(files, recording.size)
        if not isinstance(frame, Dropped)
    ]


def _straight(estimation: Estimation, frame: StereoFrame) -> StereoFrame:
    motion = estimation.frames[-1].motion
    if not isinstance(motion, SelfCalibratedMotion):
        return frame
    rotation = motion.right_rotation.matrix()
    return replace(frame, right=straightened(estimation.recording.calibration, frame.right, rotation))
