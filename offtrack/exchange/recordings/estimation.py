"""Estimates of the off-tracking in a stereo recording: the estimator, and its output frame by frame."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import Odometry, OffTrackingEstimator, OffTrackingSource, TrailerContext
from estimators.estimates import Health, Motion, OffTracking
from estimators.off_tracking.reference import ReferenceOffTracking
from estimators.off_tracking.viso_ot import VisoOt
from offtrack.exchange.recordings.stereo_reader import Recording, camera_poses
from offtrack.exchange.recordings.stereo_sequence import Dropped, FrameFiles, stream
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, check_made, constructed, resolve
from scenarios.options.scenario import Scenario
from scenarios.progress import Progress, no_progress
from scenarios.randomness import stream as random_stream
from sensors.messages import BodyPose
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.frames import FloatArray, inverse
from vehicle.option import Parameter, check_options, declared_options


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


VISO_OT: Final = "viso_ot"
DATA_SHEET: Final = str(Scenario.model_fields["vehicle"].default)
_IMAGES: Final = "stereo_camera"


class Chosen(NamedTuple):
    """Names and options of the parts, as a user gives them."""

    estimator: str = VISO_OT
    odometry: str = str(Scenario.model_fields["odometry"].default)
    self_calibration: bool = True
    vehicle: str | None = None  # data sheet for an estimator of the user's own; None: ``DATA_SHEET``, and said
    options: Mapping[str, Parameter] = {}  # of the estimator


def off_tracking_source(recording: Recording, chosen: Chosen) -> tuple[OffTrackingSource, Recording]:
    """The estimator, and the recording with what was assumed for it.

    Raises:
        ValueError: one line, if a part is unknown, needs other messages than images, or an option does not fit.
    """
    odometry = _odometry(recording, chosen)
    part: type[OffTrackingEstimator] = resolve("--estimator", chosen.estimator, OFF_TRACKING, in_scenario=False)
    if part.sensor != _IMAGES:
        raise ValueError(
            f"--estimator {chosen.estimator}: needs the sensor {part.sensor}: a recording holds the images of a stereo "
            "camera only"
        )
    if chosen.estimator == VISO_OT:
        source: OffTrackingSource = VisoOt(
            recording.calibration,
            recording.follow_distance,
            odometry,
            parameters=VisoOt.Parameters.of(chosen.options, VISO_OT),
            path_height=recording.roll_axis_height,
            direction_std=recording.direction_std,
        )
        return source, recording
    check_options(declared_options(part), chosen.options, "estimator")
    vehicle = _data_sheet(recording, chosen.vehicle or DATA_SHEET)
    if chosen.vehicle is None:
        assumed = (*recording.assumed, f"data sheet for the estimator: {DATA_SHEET} (--vehicle)")
        recording = replace(recording, assumed=assumed)
    context = TrailerContext(
        vehicle=vehicle,
        unit=len(vehicle.units) - 1,
        follow_distance=recording.follow_distance,
        calibration=recording.calibration,
        odometry=odometry,
        rng=random_stream(0, chosen.estimator),
        options=chosen.options,
        sensor=None,
    )
    source = constructed("--estimator", chosen.estimator, lambda: part.of(context))
    check_made("--estimator", chosen.estimator, source, ("init", "step"))
    return source, recording


def _odometry(recording: Recording, chosen: Chosen) -> Odometry[Any]:
    kind = resolve("--odometry", chosen.odometry, ODOMETRY)
    motions = constructed("--odometry", chosen.odometry, lambda: kind(recording.calibration))
    return SelfCalibratedOdometry(recording.calibration, motions, correcting=chosen.self_calibration)


def _data_sheet(recording: Recording, name: str) -> Vehicle:
    """A vehicle's data sheet, whose last trailer rolls about the recording's axis.

    Raises:
        ValueError: one line, if there is no such vehicle, or it tows nothing.
    """
    vehicle = load_vehicle(name)
    if len(vehicle.units) < 2:
        raise ValueError(f"--vehicle {name}: tows no trailer")
    last = vehicle.units[-1].model_copy(update={"roll_axis_height": recording.roll_axis_height})
    return vehicle.model_copy(update={"units": (*vehicle.units[:-1], last)})
