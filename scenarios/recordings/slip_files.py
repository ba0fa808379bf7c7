"""The directory of a slip estimation: table, summary, report and video."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

from scenarios.progress import Progress, no_progress
from scenarios.recordings.slip_estimation import ROW_WORDS, SlipEstimation, slip_summary
from scenarios.recordings.slip_page import report_page
from scenarios.recordings.slip_video import write_video
from scenarios.results.log import Log, write_log
from scenarios.results.run_directory import appearing_at_once, mark_interrupted


def write_slip_estimation(
    estimation: SlipEstimation, directory: Path, *, video: bool, progress: Progress = no_progress
) -> dict[str, Any]:
    """Writes everything and returns the summary; ``progress`` counts the frames of the video.

    Raises:
        ValueError: if the directory can not take it.
    """
    numbers = slip_summary(estimation)
    with appearing_at_once(directory) as folder:
        (folder / "slip.csv").write_text(csv_text(estimation.log), encoding="utf-8")
        write_log(estimation.log, folder / "slip.parquet")
        (folder / "report.html").write_text(report_page(estimation, numbers), encoding="utf-8")
        if video and len(estimation.log) > 1:
            try:
                write_video(estimation, folder / "video", progress=progress)
            except KeyboardInterrupt:
                numbers["outcome"] = "interrupted"
        (folder / "summary.json").write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        if numbers["outcome"] == "interrupted":
            mark_interrupted(folder)
    return numbers


def csv_text(log: Log) -> str:
    """The table as CSV: angles in degrees, empty where there is no value, health in words."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    ends = {"rad": "_deg", "m": "_m", "s": "_s", "-": ""}
    writer.writerow([signal.name + ends[signal.unit] for signal in log.signals])
    for row in range(len(log)):
        cells = []
        for signal in log.signals:
            value = float(log[signal.name][row])
            if signal.name == "health":
                cells.append(ROW_WORDS[value])
            elif not math.isfinite(value):
                cells.append("")
            else:
                cells.append(f"{math.degrees(value) if signal.unit == 'rad' else value:.6g}")
        writer.writerow(cells)
    return file.getvalue()
