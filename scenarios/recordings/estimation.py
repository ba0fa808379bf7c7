"""Estimates of the off-tracking in a recorded sequence, frame by frame."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.context import OffTrackingSource
from estimators.estimates import Health, Motion, OffTracking
from estimators.off_tracking.reference import ReferenceOffTracking
from scenarios.progress import Progress, no_progress
from scenarios.recordings.images import Dropped, stream
from scenarios.recordings.sequence import FrameFiles
from scenarios.recordings.stereo_reader import Recording
from scenarios.recordings.trajectory import camera_poses
from sensors.messages import BodyPose
from vehicle.frames import FloatArray, inverse


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameEstimate:
    """Estimate from one frame."""

    files: FrameFiles
    dropped: str = ""  # reason why the frame could not be used; empty if it was used
    off_tracking: OffTracking | None = None  # None for the first frame and for dropped ones
    motion: Motion | None = None

    @property
    def tracks(self) -> NDArray[np.float32]:
        """Features in the previous and the current left image, (m, 4) [px]."""
        return self.motion.tracks if self.motion else np.empty((0, 4), dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimation:
    """Estimates from a recording, up to its end or an interrupt."""

    recording: Recording
    outcome: str  # "completed" or "interrupted"
    frames: tuple[FrameEstimate, ...]
    X_C0C: FloatArray  # (n, 4, 4) poses of the left camera relative to the first frame
    reference: FloatArray  # (n,) off-tracking computed from the recording's poses [m]; NaN where unknown
    wall_s: float
    odometry_s: float

    @property
    def states_motions(self) -> bool:
        """True if the estimator stated motions of the cameras."""
        return any(frame.motion for frame in self.frames)

    @property
    def X_S0S(self) -> FloatArray:
        """Poses (n, 4, 4) of the trailer relative to the first frame, by the odometry."""
        return body_poses(self.recording, self.X_C0C)

    @property
    def true_X_S0S(self) -> FloatArray | None:
        """Poses (n, 4, 4) of the trailer relative to the first frame, as recorded; None if unknown."""
        poses = self.recording.poses
        return None if poses is None else body_poses(self.recording, poses[: len(self.frames)])


def estimate(recording: Recording, source: OffTrackingSource, progress: Progress = no_progress) -> Estimation:
    """Estimate the off-tracking at every frame; an interrupt ends this early and keeps the frames so far.

    Raises:
        ValueError: one line, if no frame can be used.
    """
    frames: list[FrameEstimate] = []
    begin, odometry_s, outcome = time.perf_counter(), 0.0, "completed"
    memory = source.init()
    try:
        for files, frame in stream(recording.sequence.frames, recording.size):
            if isinstance(frame, Dropped):
                frames.append(FrameEstimate(files=files, dropped=frame.reason))
            else:
                start = time.perf_counter()
                memory, result = source.step(memory, recording.rectified(frame))
                odometry_s += time.perf_counter() - start
                frames.append(_frame(files, result))
            done, total = len(frames), len(recording.sequence.frames)
            progress(done, total, f"frame {done} of {total}")
    except KeyboardInterrupt:
        outcome = "interrupted"
    if frames and all(frame.dropped for frame in frames):
        raise ValueError(f"{recording.sequence.directory}: no frame can be used. First reason: {frames[0].dropped}")
    return Estimation(
        recording=recording,
        outcome=outcome,
        frames=tuple(frames),
        X_C0C=camera_poses([f.files.tick for f in frames], [f.motion for f in frames if f.motion]),
        reference=_reference(recording, len(frames)),
        wall_s=time.perf_counter() - begin,
        odometry_s=odometry_s,
    )


def _frame(files: FrameFiles, result: Any) -> FrameEstimate:
    if result is None:
        return FrameEstimate(files=files)
    if isinstance(result, OffTracking):  # of the user's own estimator
        return FrameEstimate(files=files, off_tracking=result)
    return FrameEstimate(files=files, off_tracking=result.off_tracking, motion=result.motion)


def body_poses(recording: Recording, X_C0C: FloatArray) -> FloatArray:
    """Poses X_S0S (n, 4, 4) of the trailer from the poses of its left camera."""
    X_SC = recording.calibration.X_SC
    poses: FloatArray = X_SC @ X_C0C @ inverse(X_SC)
    return poses


def _reference(recording: Recording, count: int) -> FloatArray:
    """Off-tracking (n,) [m] that follows from the recorded poses."""
    values = np.full(count, np.nan)
    if recording.poses is None:
        return values
    buffer = ReferenceOffTracking(recording.follow_distance, path_height=recording.roll_axis_height)
    memory = buffer.init()
    poses = body_poses(recording, recording.poses[:count])
    for k, (files, X_WB) in enumerate(zip(recording.sequence.frames[:count], poses, strict=True)):
        memory, off_tracking = buffer.step(memory, BodyPose(tick=files.tick, X_WB=X_WB))
        if off_tracking is not None and off_tracking.health is not Health.LOST:
            values[k] = off_tracking.value
    return values
