"""Writer of run directories.

A run directory holds ``scenario.toml`` (runs again identically), ``manifest.json`` (versions, seed, hashes),
``signals.parquet`` (SI, units in the schema), ``summary.json``, ``report.html``, a video, and ``traceback.txt`` if an
exception ended the run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from scenarios.progress import Progress, no_progress
from scenarios.results.log import write_log
from scenarios.results.manifest import manifest
from scenarios.results.numbers import Summary
from scenarios.results.rover import RoverResult
from scenarios.results.run_directory import appearing_at_once, mark_interrupted
from scenarios.results.run_result import RunResult
from scenarios.results.summary import summary


def write_run(
    result: RunResult | RoverResult, directory: Path, *, video: bool = True, progress: Progress = no_progress
) -> Path:
    """Write the run directory and return it; ``progress`` counts the frames of the video.

    Raises:
        ValueError: if the directory can not take a run, see ``run_directory.check_run_directory``.
        KeyboardInterrupt: if the video was interrupted; all other files are written.
    """
    numbers, interrupt = summary(result), None
    with appearing_at_once(directory) as folder:
        (folder / "scenario.toml").write_text(result.scenario_toml, encoding="utf-8")
        if result.traceback:
            (folder / "traceback.txt").write_text(result.traceback, encoding="utf-8", errors="replace")
        write_log(result.log, folder / "signals.parquet")
        _write_json(folder / "manifest.json", manifest(result))
        _write_report(result, numbers, folder)
        _write_json(folder / "summary.json", numbers)
        try:
            if video and len(result.log) > 1:
                _write_video(result, folder, progress)
        except KeyboardInterrupt as error:
            interrupt = error
        if interrupt or result.outcome == "interrupted":
            mark_interrupted(folder)
    if interrupt:
        raise interrupt
    return directory


def _write_report(result: RunResult | RoverResult, numbers: Summary, folder: Path) -> None:
    # matplotlib takes a second to import, and a run that fails needs none
    if isinstance(result, RunResult):
        from scenarios.report.run_page import report_html

        html = report_html(result, numbers)
    else:
        from scenarios.report.rover_page import rover_report_html

        html = rover_report_html(result, numbers)
    (folder / "report.html").write_text(html, encoding="utf-8")


def _write_video(result: RunResult | RoverResult, folder: Path, progress: Progress) -> None:
    if isinstance(result, RunResult):
        from scenarios.report.run_video import write_video

        write_video(result, folder / "video", progress=progress)
    else:
        from scenarios.report.rover_video import write_rover_video

        write_rover_video(result, folder / "video", progress=progress)


def _write_json(path: Path, content: Mapping[str, object]) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
