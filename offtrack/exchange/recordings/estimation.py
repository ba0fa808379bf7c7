"""Estimates of the off-tracking in a stereo recording, frame by frame, and their summary; and of live images.

Geiger 2012: A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite",
CVPR 2012. Subsequences of 100, 200, … 800 m start at every tenth frame. For each, the relative pose of the estimate is
compared with the true one. The errors of translation and rotation are divided by the length and averaged.
"""

import json
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.calibration.epipolar import straightened
from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import Odometry, OffTrackingEstimator, OffTrackingSource, TrailerContext
from estimators.estimates import Health, Motion, OffTracking
from estimators.odometry.agreement import agreement
from estimators.odometry.covariance import INDEPENDENT
from estimators.off_tracking.reference import ReferenceOffTracking
from estimators.off_tracking.viso_ot import VisoOt
from estimators.rigid_motion import rotation_vector
from offtrack.exchange.recordings.layouts.live import Streams
from offtrack.exchange.recordings.stereo_reader import Recording, camera_poses
from offtrack.exchange.recordings.stereo_sequence import Dropped, FrameFiles, stream
from offtrack.reports.player.encoding import ON_PAGE
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, check_made, constructed, resolve
from scenarios.options.scenario import Scenario
from scenarios.options.scenario import stream as random_stream
from scenarios.progress import Progress, no_progress
from scenarios.results import metrics
from scenarios.results.log import LOST, Log
from scenarios.results.run_summary import number
from scenarios.results.run_warnings import calibration_warnings, doubt_warnings
from sensors.camera.rig import StereoCalibration
from sensors.messages import BodyPose, StereoFrame
from vehicle.clock import TICK
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray, inverse
from vehicle.option import Parameter, check_options, declared_options

_MOST_PICTURES: Final = 240  # on the page


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameEstimate:
    """Estimate from one frame."""

    files: FrameFiles
    dropped: str = ""  # reason why the frame could not be used; empty if it was used
    off_tracking: OffTracking | None = None  # None for the first frame and for dropped ones
    motion: Motion | None = None
    jpeg: bytes = b""  # left image, as large as on the page; empty for most frames of long recordings

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


def estimate(recording: Recording, source: OffTrackingSource, progress: Progress = no_progress) -> Estimation:
    """Estimate the off-tracking at every frame; an interrupt ends this early and keeps the frames so far.

    Raises:
        ValueError: one line, if no frame can be used.
    """
    frames: list[FrameEstimate] = []
    begin, odometry_s, outcome = time.perf_counter(), 0.0, "completed"
    total = len(recording.sequence.frames)
    every = -(-total // _MOST_PICTURES)
    memory = source.init()
    try:
        for files, frame in stream(recording.sequence.frames, recording.size, recording.seen):
            if isinstance(frame, Dropped):
                frames.append(FrameEstimate(files=files, dropped=frame.reason))
            else:
                start = time.perf_counter()
                frame = recording.rectified(frame)
                memory, result = source.step(memory, frame)
                odometry_s += time.perf_counter() - start
                jpeg = b"" if len(frames) % every else ON_PAGE.jpeg(frame.left)
                off_tracking, motion = _parts(result)
                frames.append(FrameEstimate(files=files, off_tracking=off_tracking, motion=motion, jpeg=jpeg))
            progress(len(frames), total, f"frame {len(frames)} of {total}")
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


def estimate_live(streams: Streams, recording: Recording, source: OffTrackingSource, out: TextIO) -> dict[str, Any]:
    """Write a line of JSON for every pair, until an interrupt; return the summary.

    A pair that is missing, or of another size than the recording's, is a lost estimate.
    """
    memory, begin, counts = source.init(), time.monotonic(), Counter[str]()
    with suppress(KeyboardInterrupt, BrokenPipeError):
        while True:
            pair = streams.read()
            tick = round((time.monotonic() - begin) / TICK)
            line: dict[str, Any] = {"time_s": round(tick * TICK, 3), "health": Health.LOST.name.lower()}
            if isinstance(pair, str):
                line["reason"] = pair
            elif any(image.shape != recording.size[::-1] for image in pair):
                line["reason"] = f"images are not of {recording.size[0]}x{recording.size[1]} px"
            else:
                frame = recording.rectified(StereoFrame(tick=tick, left=pair[0], right=pair[1]))
                memory, result = source.step(memory, frame)
                found, _ = _parts(result)
                if found is None:
                    line["reason"] = "first image"
                else:
                    line["health"] = found.health.name.lower()
                    if found.health is not Health.LOST and math.isfinite(found.value):
                        line |= {"off_tracking_m": round(found.value, 6), "std_m": round(found.std, 6)}
            counts[line["health"]] += 1
            out.write(json.dumps(line) + "\n")
            out.flush()
    duration = time.monotonic() - begin
    pairs = sum(counts.values())
    return {"duration_s": round(duration, 3), "pairs": pairs, "pairs_per_s": round(pairs / duration, 2), **counts}


def _parts(result: Any) -> tuple[OffTracking | None, Motion | None]:
    """Off-tracking and motion; an estimator of the user's own may state no motion."""
    return getattr(result, "off_tracking", result), getattr(result, "motion", None)


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


_LARGEST_ROTATION: Final = math.radians(1.0)  # of a right camera on a rigid mount, against its calibration
_LONGEST_GAP: Final = 1.0  # time without motion in which the velocity is believed to last [s]
_FASTEST: Final = 70.0  # speed of a vehicle with a trailer, and some more [m/s]
_FAR_OFF, _FAR_OFF_LEAST = 0.15, 0.05  # error of motions, of their length [-] and at least [m], of other poses
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
    kind = resolve("--odometry", chosen.odometry, ODOMETRY)
    motions = constructed("--odometry", chosen.odometry, lambda: kind(recording.calibration))
    odometry: Odometry[Any] = SelfCalibratedOdometry(recording.calibration, motions, correcting=chosen.self_calibration)
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
    vehicle = load_vehicle(chosen.vehicle or DATA_SHEET)
    if len(vehicle.units) < 2:
        raise ValueError(f"--vehicle {chosen.vehicle}: tows no trailer")
    last = vehicle.units[-1].model_copy(update={"roll_axis_height": recording.roll_axis_height})
    if chosen.vehicle is None:
        assumed = (*recording.assumed, f"data sheet for the estimator: {DATA_SHEET} (--vehicle)")
        recording = replace(recording, assumed=assumed)
    context = TrailerContext(
        vehicle=vehicle.model_copy(update={"units": (*vehicle.units[:-1], last)}),
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


KITTI_LENGTHS: Final = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)  # [m]
KITTI_EVERY: Final = 10  # frames between the starts of subsequences


class Drift(NamedTuple):
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
                X_true, X_estimated = (inverse(poses[first]) @ poses[last] for poses in (true, estimated))
                X_error = inverse(X_estimated) @ X_true
                turn = np.linalg.norm(rotation_vector(X_error[:3, :3]))
                errors.append((length, np.linalg.norm(X_error[:3, 3]) / length, turn / length))
    if not errors:
        return None
    table = np.array(errors)
    of_lengths = tuple(float(length) for length in np.unique(table[:, 0]))
    return Drift(float(table[:, 1].mean()), float(table[:, 2].mean()), of_lengths, len(table))


def motions_found(estimation: Estimation) -> list[Motion]:
    """Motions that were not lost."""
    motions = [frame.motion for frame in estimation.frames if frame.motion is not None]
    return [motion for motion in motions if motion.health is not Health.LOST]


def _true_motions(estimation: Estimation) -> list[tuple[Motion, FloatArray]]:
    """Motions that were not lost, each with that by the recorded poses; none without poses."""
    poses = estimation.recording.poses
    if poses is None:
        return []
    pose = {frame.files.tick: X for frame, X in zip(estimation.frames, poses, strict=False)}
    return [(motion, inverse(pose[motion.previous_tick]) @ pose[motion.tick]) for motion in motions_found(estimation)]


def motion_errors(estimation: Estimation) -> FloatArray:
    """Errors (n, 6) of single motions by the recorded poses, in stated standard deviations; none without poses."""
    ratios = []
    for motion, X_true in _true_motions(estimation):
        turn = rotation_vector(X_true[:3, :3] @ motion.X_PC[:3, :3].T)
        error = np.concatenate([turn, X_true[:3, 3] - motion.X_PC[:3, 3]])
        ratios.append(error / np.sqrt(np.diag(motion.covariance)))
    return np.array(ratios).reshape(-1, 6)


def summary(estimation: Estimation, log: Log, odometry: str) -> dict[str, Any]:
    """Summary for JSON; null where a number does not apply or could not be measured."""
    recording, notes = estimation.recording, list(estimation.recording.notes)
    if not estimation.states_motions and any(frame.off_tracking for frame in estimation.frames):
        notes.append("the estimator states no motions of the cameras: there is no trajectory")
    dropped = [{"frame": k, "reason": f.dropped} for k, f in enumerate(estimation.frames) if f.dropped]
    used = len(log) - len(dropped)
    return {
        "outcome": estimation.outcome,
        "recording": recording.source,
        "follow_distance_m": recording.follow_distance,
        "frames": {
            "total": len(recording.sequence.frames),
            "used": used,
            "dropped": len(dropped),
            "duration_s": number(estimation.frames[-1].files.tick * TICK if len(log) else 0.0),
        },
        "off_tracking": _off_tracking(estimation, log),
        "odometry": {"name": odometry, **_odometry(estimation, log)},
        "kitti": _drift(estimation),
        "self_calibration": _self_calibration(log),
        "timing": {
            "wall_s": number(estimation.wall_s),
            "odometry_s": number(estimation.odometry_s),
            "odometry_ms_per_frame": number(1e3 * estimation.odometry_s / max(1, used)),
        },
        "dropped_frames": dropped,
        "warnings": list(warnings(estimation)),
        "assumed": list(recording.assumed),
        "notes": notes,
    }


def warnings(estimation: Estimation) -> tuple[str, ...]:
    """What is doubtful about the recording, a line each; the worst first."""
    return (
        *_lost_warnings(estimation),
        *estimation.recording.warnings,
        *calibration_warnings((frame.motion for frame in estimation.frames), "leave out --no-self-calibration"),
        *_rotation_warnings(estimation),
        *_plausibility_warnings(estimation),
        *doubt_warnings(frame.off_tracking for frame in estimation.frames if frame.off_tracking),
    )


def _rotation_warnings(estimation: Estimation) -> list[str]:
    """A warning if the self-calibration ended with a rotation that a rigid mount does not allow."""
    motion = next((frame.motion for frame in reversed(estimation.frames) if frame.motion is not None), None)
    if not isinstance(motion, SelfCalibratedMotion) or motion.miscalibrated:
        return []
    angle = float(np.linalg.norm(motion.right_rotation))
    if angle < _LARGEST_ROTATION:
        return []
    return [
        f"the right camera is turned by {math.degrees(angle):.1f} deg against its calibration, more than a rigid mount "
        f"gives way ({math.degrees(_LARGEST_ROTATION):g} deg): it was corrected, but is the calibration theirs?"
    ]


def _plausibility_warnings(estimation: Estimation) -> list[str]:
    """Warnings if times or true poses cannot be those of the images."""
    motions = motions_found(estimation)
    if not motions:
        return []
    speed = float(np.median([np.linalg.norm(m.X_PC[:3, 3]) / (m.tick - m.previous_tick) for m in motions])) / TICK
    found = []
    if speed > _FASTEST:
        found.append(f"the cameras move at {speed:.0f} m/s: are the times in seconds, or is --rate too high?")
    if true := _true_motions(estimation):
        errors = [float(np.linalg.norm(X_true[:3, 3] - motion.X_PC[:3, 3])) for motion, X_true in true]
        moved = [float(np.linalg.norm(X_true[:3, 3])) for _, X_true in true]
        if float(np.median(errors)) > max(_FAR_OFF * float(np.median(moved)), _FAR_OFF_LEAST):
            found.append(
                f"motions differ from those of poses.txt by {np.median(errors):.2g} m a frame, of "
                f"{np.median(moved):.2g} m: are they the left camera's at these frames, in this order, and is the "
                "focal length right?"
            )
    return found


def _mostly_lost(estimation: Estimation) -> bool:
    """True if less than half of the frames after the first one gave a motion."""
    return estimation.states_motions and 2 * len(motions_found(estimation)) < len(estimation.frames) - 1


def _lost_warnings(estimation: Estimation) -> list[str]:
    """Warnings if many frames gave no motion, or a degraded one, or none did for long."""
    wanted, found = len(estimation.frames) - 1, motions_found(estimation)
    dropped = [frame.dropped for frame in estimation.frames if frame.dropped]
    degraded = sum(motion.health is Health.DEGRADED for motion in found)
    lines = []
    if _mostly_lost(estimation):
        cause = "calibration of other cameras, repeated images, or frames too far apart?"
        if 2 * len(dropped) >= wanted - len(found):
            cause = f"{len(dropped)} can not be used, first: {dropped[0]}"
        elif estimation.recording.warnings:
            cause = "see the next lines"
        lines += [f"{wanted - len(found)} of {wanted} frames gave no motion, and the distance means nothing: {cause}"]
    if 2 * degraded > len(found):
        lines += [f"{degraded} of {len(found)} motions are degraded, few features agree: is the calibration theirs?"]
    if found:
        ends = np.maximum.accumulate([motion.tick for motion in found])
        gaps = np.append([motion.previous_tick for motion in found[1:]], estimation.frames[-1].files.tick) - ends
        gap, begin = (TICK * float(value[gaps.argmax()]) for value in (gaps, ends))
        if gap > _LONGEST_GAP:
            lines += [f"no motion was found for {gap:.1f} s from {begin:.1f} s on: the path there is a guess"]
    return lines


def _off_tracking(estimation: Estimation, log: Log) -> dict[str, float | int | None]:
    value, std, usable = log["off_tracking"], log["off_tracking_std"], log["health"] < LOST
    error = metrics.estimate_error(value, log["off_tracking_poses"], log["health"])
    by_direction = estimation.recording.direction_std * estimation.recording.follow_distance
    return {
        "rms_m": number(metrics.rms(value)),
        "max_m": number(metrics.peak(value)),
        "std_mean_m": number(metrics.mean(std)),
        "direction_std_m": number(by_direction),
        "motion_std_mean_m": number(metrics.mean(np.sqrt(np.clip(std**2 - by_direction**2, 0.0, None)))),
        # since the first usable one; dropped frames count as unusable
        "valid_fraction": number(float(usable[np.argmax(usable) :].mean()) if usable.any() else math.nan),
        "estimate_error_rms_m": number(metrics.rms(error)),
        "estimate_error_max_m": number(metrics.peak(error)),
        "within_2_5_sigma": number(metrics.within_sigmas(error, std)),
        "nees_mean": number(metrics.nees(error, std)),
    }


def _odometry(estimation: Estimation, log: Log) -> dict[str, float | int | None]:
    steps = np.hypot(*np.diff(np.column_stack([log["x"], log["y"]]), axis=0).T) if len(log) > 1 else np.zeros(1)
    own = _drift(estimation, (estimation.recording.follow_distance,), every=1)
    halves = [motion.halves for motion in motions_found(estimation) if motion.halves is not None]
    return {
        "matches_mean": number(metrics.mean(log["matches"])),
        "inliers_mean": number(metrics.mean(log["inliers"])),
        "degraded_frames": int(np.sum(log["odometry_health"] == 1.0)),
        "lost_frames": int(np.sum(log["odometry_health"] >= LOST)),
        "distance_m": number(float(steps.sum())),
        "drift_percent": own["drift_percent"],
        "drift_deg_per_m": own["drift_deg_per_m"],
        "motion_nees_mean": number(metrics.mean(np.square(motion_errors(estimation)))),
        # RMS difference of motions from halves of the features, relative to that of independent errors
        "halves_ratio": number(metrics.rms(np.array(halves)) / math.sqrt(INDEPENDENT)),
    }


def _drift(
    estimation: Estimation, lengths: Sequence[float] = KITTI_LENGTHS, every: int = KITTI_EVERY
) -> dict[str, Any]:
    """Drift figures of the benchmark, and the lengths [m] of the subsequences that fit into the path."""
    true, result = estimation.recording.poses, None
    if true is not None and not _mostly_lost(estimation):
        result = drift(true[: len(estimation.X_C0C)], estimation.X_C0C, lengths, every)
    if result is None:
        return {"drift_percent": None, "drift_deg_per_m": None, "lengths_m": [], "subsequences": 0}
    return {
        "drift_percent": number(100.0 * result.translation),
        "drift_deg_per_m": round(math.degrees(result.rotation), 9),
        "lengths_m": list(result.lengths),
        "subsequences": result.subsequences,
    }


def _self_calibration(log: Log) -> dict[str, float | int | None]:
    """Last estimate of the right camera's rotation [deg] and delay [ms]; empty without one."""
    found: dict[str, float | int | None] = {}
    for name in ("roll", "yaw", "pitch", "delay") if "right_roll" in log else ():
        unit, scale = ("ms", 1e3) if name == "delay" else ("deg", math.degrees(1.0))
        for end in ("", "_std"):
            known = log[f"right_{name}{end}"][np.isfinite(log[f"right_{name}{end}"])]
            if known.size:
                found[f"{name}{end}_{unit}"] = number(scale * known[-1])
    return found


def agreement_numbers(
    estimation: Estimation, kind: Callable[[StereoCalibration], Odometry[Any]]
) -> dict[str, float | None]:
    """RMS differences of motions in stated standard deviations, over all components; null without common motions.

    All images are read again.
    """
    result = agreement(estimation.recording.calibration, straight_frames(estimation), kind)
    values = [float(np.sqrt(np.mean(np.square(value)))) for value in (result.halves, result.backwards)]
    halves, backwards = (round(value, 3) if math.isfinite(value) else None for value in values)
    return {"halves_rms_sigma": halves, "backwards_rms_sigma": backwards}


def straight_frames(estimation: Estimation, most: int | None = None) -> list[StereoFrame]:
    """Frames of the estimation, at ``most`` the first ones; right images by the rotation that it ended with."""
    recording = estimation.recording
    files = recording.sequence.frames[: len(estimation.frames)][:most]
    read = (frame for _, frame in stream(files, recording.size) if not isinstance(frame, Dropped))
    frames, motion = map(recording.rectified, read), estimation.frames[-1].motion
    if not isinstance(motion, SelfCalibratedMotion):
        return list(frames)
    rotation = motion.right_rotation.matrix()
    return [replace(one, right=straightened(recording.calibration, one.right, rotation)) for one in frames]
