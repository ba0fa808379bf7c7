"""Result directory of an off-tracking estimation: trajectories, table, summary, report and video."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.estimates import Health
from offtrack.exchange.recordings.estimation import Estimation, FrameEstimate
from offtrack.exchange.recordings.stereo_reader import kitti_text, tum_text
from scenarios.progress import Progress, no_progress
from scenarios.results.log import HEALTH, HEALTH_WORDS, Log, Signal, write_log
from scenarios.results.run_directory import appearing_at_once, mark_interrupted
from scenarios.results.run_summary import versions

_SIGNALS: Final = (
    Signal("frame", "-", "number of the frame, counted from 0"),
    Signal("time", "s", "time of the frame as recorded"),
    Signal("dropped", "-", "1 where the frame could not be used"),
    Signal("off_tracking", "m", "lateral distance of the hitch's path from the follow point, + left"),
    Signal("off_tracking_std", "m", "standard deviation of off_tracking"),
    Signal("health", "-", "health of the off-tracking: 0 ok, 1 degraded, 2 lost"),
    Signal("matches", "-", "features matched"),
    Signal("inliers", "-", "matches that agree with the motion"),
    Signal("odometry_health", "-", "health of the motion since the previous frame: 0 ok, 1 degraded, 2 lost"),
    Signal("x", "m", "position of the hitch along the x axis of the first trailer frame, by the odometry"),
    Signal("y", "m", "position of the hitch along the y axis of the first trailer frame"),
    Signal("psi", "rad", "yaw of the trailer since the first frame, continuous"),
    Signal("v_x", "m/s", "velocity of the hitch along the trailer"),
    Signal("v_y", "m/s", "velocity of the hitch across the trailer, + left"),
    Signal("yaw_rate", "rad/s", "yaw rate of the trailer"),
    Signal("off_tracking_poses", "m", "off-tracking computed from the recording's poses"),
)
_ROTATION: Final = (
    Signal("right_roll", "rad", "rotation of the right camera since its calibration, about its optical axis"),
    Signal("right_yaw", "rad", "rotation of the right camera about its y axis (down)"),
    Signal("right_pitch", "rad", "rotation of the right camera about its x axis (right)"),
    Signal("right_roll_std", "rad", "standard deviation of right_roll"),
    Signal("right_yaw_std", "rad", "standard deviation of right_yaw"),
    Signal("right_pitch_std", "rad", "standard deviation of right_pitch"),
    Signal("right_delay", "s", "time by which the right image is taken after the left one"),
    Signal("right_delay_std", "s", "standard deviation of right_delay"),
)
_COLUMNS: Final = {
    "m": "_m",
    "s": "_s",
    "rad": "_rad",
    "m/s": "_m_s",
    "rad/s": "_rad_s",
    "-": "",
}  # suffixes of CSV columns


def estimate_log(estimation: Estimation) -> Log:
    """One row per frame, with the right camera's rotation if it was estimated; NaN where there is no value."""
    poses = estimation.X_S0S
    psi = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    rows = [
        [k, frame.files.time, float(bool(frame.dropped)), *_estimated(frame), x, y, turn, *_motion(frame), reference]
        for k, (frame, (x, y), turn, reference) in enumerate(
            zip(estimation.frames, poses[:, :2, 3], psi, estimation.reference, strict=True)
        )
    ]
    log = Log(_SIGNALS, np.array(rows, dtype=np.float64).reshape(-1, len(_SIGNALS)))
    if not any(isinstance(frame.motion, SelfCalibratedMotion) for frame in estimation.frames):
        return log
    rotations = np.array([_rotation(frame) for frame in estimation.frames])
    return Log((*_SIGNALS, *_ROTATION), np.column_stack([log.rows, rotations]))


def _estimated(frame: FrameEstimate) -> tuple[float, ...]:
    e, motion = frame.off_tracking, frame.motion
    if e is None:
        return (math.nan,) * 6
    value, std = (math.nan, math.nan) if e.health is Health.LOST else (e.value, e.std)
    if motion is None:
        return (value, std, HEALTH[e.health], math.nan, math.nan, math.nan)
    return (value, std, HEALTH[e.health], motion.matches, motion.inliers, HEALTH[motion.health])


def _motion(frame: FrameEstimate) -> tuple[float, ...]:
    e = frame.off_tracking
    return (e.v_x, e.v_y, e.yaw_rate) if e is not None else (math.nan,) * 3


def _rotation(frame: FrameEstimate) -> tuple[float, ...]:
    if not isinstance(frame.motion, SelfCalibratedMotion):
        return (math.nan,) * len(_ROTATION)
    motion = frame.motion
    return (*motion.right_rotation, *motion.right_rotation_std, motion.right_delay, motion.right_delay_std)


def csv_text(log: Log) -> str:
    """The table as CSV: column names end in the unit, missing values are empty, health is in words."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    shown = [signal for signal in log.signals if signal.name != "dropped"]
    writer.writerow([signal.name + _COLUMNS[signal.unit] for signal in shown])
    dropped = log["dropped"] > 0.0
    for k in range(len(log)):
        writer.writerow(list(_cells(log, k, bool(dropped[k]), shown)))
    return file.getvalue()


def _cells(log: Log, row: int, dropped: bool, shown: list[Signal]) -> Iterator[str]:
    for signal in shown:
        value = float(log[signal.name][row])
        if signal.name in ("health", "odometry_health"):
            yield "dropped" if dropped else HEALTH_WORDS.get(value, "")
        elif not math.isfinite(value):
            yield ""
        elif signal.unit == "-":
            yield f"{value:.0f}"
        else:
            yield f"{value:.6f}" if signal.unit != "rad" else f"{value:.8f}"


def write_estimation(
    estimation: Estimation,
    odometry: str,
    directory: Path,
    *,
    video: bool,
    estimator: str = "viso_ot",
    agreement: dict[str, float | None] | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write all results and return the summary; ``progress`` counts the frames of the video.

    ``agreement`` of the odometry with itself goes into the summary, if it was computed.

    An interrupt while the video is drawn keeps all other results and the part of the video that is finished.

    Raises:
        ValueError: if the directory exists and is not empty.
    """
    from offtrack.exchange.recordings.estimation_summary import summary
    from offtrack.exchange.recordings.recording_page import report_page  # matplotlib takes a second to import
    from offtrack.exchange.recordings.recording_pictures import write_video

    log = estimate_log(estimation)
    numbers = {**summary(estimation, log, odometry), "estimator": estimator, "agreement": agreement or {}}
    with appearing_at_once(directory) as folder:
        used = [k for k, frame in enumerate(estimation.frames) if not frame.dropped]
        times = [estimation.frames[k].files.time for k in used]
        if estimation.states_motions or not estimation.frames:
            (folder / "trajectory_tum.txt").write_text(tum_text(times, estimation.X_C0C[used]), encoding="utf-8")
            (folder / "trajectory_kitti.txt").write_text(kitti_text(estimation.X_C0C), encoding="utf-8")
        (folder / "off_tracking.csv").write_text(csv_text(log), encoding="utf-8")
        write_log(log, folder / "off_tracking.parquet")
        (folder / "report.html").write_text(report_page(estimation, log, numbers), encoding="utf-8")
        if video and len(log) > 1:
            try:
                write_video(estimation, log, folder / "video", progress=progress)
            except KeyboardInterrupt:
                numbers["outcome"] = "interrupted"
        manifest = {
            "recording": numbers["recording"],
            "estimator": estimator,
            "odometry": odometry,
            "versions": versions(),
        }
        (folder / "summary.json").write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        if numbers["outcome"] == "interrupted":
            mark_interrupted(folder)
    return numbers
