"""Summary of an off-tracking estimation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.odometry.self_consistency import INDEPENDENT
from scenarios.recordings.drift import KITTI_EVERY, KITTI_LENGTHS, drift
from scenarios.recordings.estimation import Estimation
from scenarios.recordings.motion_errors import motion_errors, motions_found
from scenarios.results import metrics
from scenarios.results.calibration_warnings import calibration_warnings
from scenarios.results.log import LOST, Log
from vehicle.clock import TICK
from vehicle.frames import FloatArray


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
