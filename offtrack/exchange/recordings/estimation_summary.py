"""Summary of an off-tracking estimation: errors, drift, agreement of the odometry with itself, timing.

Geiger 2012: A. Geiger, P. Lenz, R. Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite",
CVPR 2012. Subsequences of 100, 200, … 800 m start at every tenth frame. For each, the relative pose of the estimate is
compared with the true one. The errors of translation and rotation are divided by the length and averaged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.calibration.epipolar import straightened
from estimators.context import Odometry
from estimators.estimates import Health, Motion
from estimators.odometry.agreement import agreement
from estimators.odometry.covariance import INDEPENDENT
from estimators.rigid_motion import rotation_vector
from offtrack.exchange.recordings.estimation import Estimation
from offtrack.exchange.recordings.stereo_sequence import Dropped, stream
from scenarios.results import metrics
from scenarios.results.log import LOST, Log
from scenarios.results.run_warnings import calibration_warnings
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
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


def motions_found(estimation: Estimation) -> list[Motion]:
    """Motions that were not lost."""
    motions = [frame.motion for frame in estimation.frames if frame.motion is not None]
    return [motion for motion in motions if motion.health is not Health.LOST]


def motion_errors(estimation: Estimation) -> FloatArray:
    """Errors (n, 6) of single motions by the recorded poses, in stated standard deviations; none without poses."""
    poses = estimation.recording.poses
    if poses is None:
        return np.empty((0, 6))
    pose = {frame.files.tick: X for frame, X in zip(estimation.frames, poses, strict=False)}
    ratios = []
    for motion in motions_found(estimation):
        X_true = inverse(pose[motion.previous_tick]) @ pose[motion.tick]
        turn = rotation_vector(X_true[:3, :3] @ motion.X_PC[:3, :3].T)
        error = np.concatenate([turn, X_true[:3, 3] - motion.X_PC[:3, 3]])
        ratios.append(error / np.sqrt(np.diag(motion.covariance)))
    return np.array(ratios).reshape(-1, 6)


def summary(estimation: Estimation, log: Log, odometry: str) -> dict[str, Any]:
    """Summary for JSON; null where a number does not apply or could not be measured."""
    recording = estimation.recording
    return {
        "outcome": estimation.outcome,
        "recording": str(recording.sequence.directory),
        "follow_distance_m": recording.follow_distance,
        "frames": _frames(estimation, log),
        "off_tracking": _off_tracking(log),
        "odometry": {"name": odometry, **_odometry(estimation, log)},
        "kitti": _drift(estimation),
        "self_calibration": _self_calibration(log),
        "timing": _timing(estimation, log),
        "dropped_frames": [{"frame": k, "reason": f.dropped} for k, f in enumerate(estimation.frames) if f.dropped],
        "warnings": list(warnings(estimation)),
        "assumed": list(recording.assumed),
        "notes": [*recording.notes, *_no_motions(estimation)],
    }


def _no_motions(estimation: Estimation) -> list[str]:
    """A note on estimates without motions of the cameras."""
    if estimation.states_motions or not any(frame.off_tracking for frame in estimation.frames):
        return []
    return ["the estimator states no motions of the cameras: there is no trajectory"]


def warnings(estimation: Estimation) -> tuple[str, ...]:
    """What is doubtful about the cameras, a line each."""
    motions = [frame.motion for frame in estimation.frames]
    return calibration_warnings(motions, "leave out --no-self-calibration")


def error_of_estimate(log: Log) -> FloatArray:
    """Estimated off-tracking minus that of the recorded poses, (n,) [m]; NaN where one is missing."""
    return metrics.estimate_error(log["off_tracking"], log["off_tracking_poses"], log["health"])


def _frames(estimation: Estimation, log: Log) -> dict[str, float | int | None]:
    total, dropped = len(log), int(log["dropped"].sum())
    return {
        "total": len(estimation.recording.sequence.frames),
        "used": total - dropped,
        "dropped": dropped,
        "duration_s": _number(estimation.frames[-1].files.tick * TICK if total else 0.0),
    }


def _off_tracking(log: Log) -> dict[str, float | int | None]:
    value, error, std = log["off_tracking"], error_of_estimate(log), log["off_tracking_std"]
    return {
        "rms_m": _number(metrics.rms(value)),
        "max_m": _number(metrics.peak(value)),
        "std_mean_m": _number(metrics.mean(std)),
        "valid_fraction": _number(_valid_fraction(log)),
        "estimate_error_rms_m": _number(metrics.rms(error)),
        "estimate_error_max_m": _number(metrics.peak(error)),
        "within_2_5_sigma": _number(metrics.within_sigmas(error, std)),
        "nees_mean": _number(metrics.nees(error, std)),
    }


def _valid_fraction(log: Log) -> float:
    """Share of frames with a usable off-tracking since the first one; dropped frames count as unusable."""
    usable = log["health"] < LOST
    first = int(np.argmax(usable)) if usable.any() else len(usable)
    return float(np.mean(usable[first:])) if first < len(usable) else math.nan


def _odometry(estimation: Estimation, log: Log) -> dict[str, float | int | None]:
    steps = np.hypot(*np.diff(np.column_stack([log["x"], log["y"]]), axis=0).T) if len(log) > 1 else np.zeros(1)
    own = _drift(estimation, (estimation.recording.follow_distance,), every=1)
    return {
        "matches_mean": _number(metrics.mean(log["matches"])),
        "inliers_mean": _number(metrics.mean(log["inliers"])),
        "degraded_frames": int(np.sum(log["odometry_health"] == 1.0)),
        "lost_frames": int(np.sum(log["odometry_health"] >= LOST)),
        "distance_m": _number(float(steps.sum())),
        "drift_percent": own["drift_percent"],
        "drift_deg_per_m": own["drift_deg_per_m"],
        "motion_nees_mean": _number(metrics.mean(np.square(motion_errors(estimation)))),
        "halves_ratio": _number(_halves_ratio(estimation)),
    }


def _halves_ratio(estimation: Estimation) -> float:
    """RMS difference of motions from halves of the features, relative to that of independent errors."""
    halves = np.array([motion.halves for motion in motions_found(estimation) if motion.halves is not None])
    return metrics.rms(halves) / math.sqrt(INDEPENDENT)


def _drift(
    estimation: Estimation, lengths: Sequence[float] = KITTI_LENGTHS, every: int = KITTI_EVERY
) -> dict[str, Any]:
    """Drift figures of the benchmark, and the lengths [m] of the subsequences that fit into the path."""
    true = estimation.recording.poses
    result = None if true is None else drift(true[: len(estimation.X_C0C)], estimation.X_C0C, lengths, every)
    if result is None:
        return {"drift_percent": None, "drift_deg_per_m": None, "lengths_m": [], "subsequences": 0}
    return {
        "drift_percent": _number(100.0 * result.translation),
        "drift_deg_per_m": round(math.degrees(result.rotation), 9),
        "lengths_m": list(result.lengths),
        "subsequences": result.subsequences,
    }


def _self_calibration(log: Log) -> dict[str, float | int | None]:
    """Last estimate of the right camera's rotation [deg] and delay [ms]; empty without one."""
    rotation: dict[str, float | int | None] = {}
    for name in ("roll", "yaw", "pitch"):
        for end in ("", "_std"):
            values = log[f"right_{name}{end}"] if f"right_{name}" in log else np.empty(0)
            known = values[np.isfinite(values)]
            if known.size:
                rotation[f"{name}{end}_deg"] = _number(math.degrees(known[-1]))
    for end in ("", "_std"):
        values = log[f"right_delay{end}"] if f"right_delay{end}" in log else np.empty(0)
        known = values[np.isfinite(values)]
        if known.size:
            rotation[f"delay{end}_ms"] = _number(1e3 * known[-1])
    return rotation


def _timing(estimation: Estimation, log: Log) -> dict[str, float | int | None]:
    used = max(1, len(log) - int(log["dropped"].sum()))
    return {
        "wall_s": _number(estimation.wall_s),
        "odometry_s": _number(estimation.odometry_s),
        "odometry_ms_per_frame": _number(1e3 * estimation.odometry_s / used),
    }


def _number(value: float) -> float | None:
    """Value rounded to six decimals, or None for NaN and infinity."""
    return round(float(value), 6) if math.isfinite(value) else None


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
