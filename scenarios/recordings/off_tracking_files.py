"""Result directory of an off-tracking estimation: trajectories, tables, summary, report and video."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scenarios.progress import Progress, no_progress
from scenarios.recordings.estimation import Estimation
from scenarios.recordings.table import csv_text, estimate_log
from scenarios.recordings.trajectory import kitti_text, tum_text
from scenarios.results.log import write_log
from scenarios.results.manifest import versions
from scenarios.results.run_directory import appearing_at_once, mark_interrupted


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
    from scenarios.recordings.recording_page import report_page  # matplotlib takes a second to import
    from scenarios.recordings.recording_video import write_video
    from scenarios.recordings.summary import summary

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
