"""Writer of run directories.

A run directory holds ``scenario.toml`` (runs again identically), ``manifest.json`` (versions, seed, hashes),
``signals.parquet`` (SI, units in the schema), ``summary.json``, ``report.html``, a video, and after an exception
``traceback.txt``.
"""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from offtrack.reports.kinds import KINDS
from scenarios.progress import Progress, no_progress
from scenarios.results.log import write_log
from scenarios.results.run_directory import added_as_a_whole, appearing_at_once, mark_complete, mark_interrupted
from scenarios.results.run_inputs import write_inputs
from scenarios.results.run_summary import Result, manifest


def write_run(result: Result, directory: Path, *, video: bool = True, progress: Progress = no_progress) -> Path:
    """Write the run directory and return it; ``progress`` counts the frames of the video.

    Scenario, signals, manifest and summary are there before report and video are drawn, and stay if that fails.

    Raises:
        ValueError: if the directory can not take a run, see ``run_directory.check_run_directory``; or if the report or
            the video can not be drawn: all other files are written then.
        KeyboardInterrupt: if the drawing was interrupted; all that was finished is written.
    """
    numbers, kind = result.summary(), KINDS[result.kind]
    with appearing_at_once(directory) as folder:
        scenario_toml = write_inputs(result.scenario_toml, result.inputs, folder)
        (folder / "scenario.toml").write_text(scenario_toml, encoding="utf-8")
        write_log(result.log, folder / "signals.parquet")
        write_json(folder / "manifest.json", manifest(result))
        write_json(folder / "summary.json", numbers)
        if result.traceback:
            (folder / "traceback.txt").write_text(result.traceback, encoding="utf-8", errors="replace")
        mark_interrupted(folder)  # until all is drawn
    failures = list[str]()
    with _lost_alone("report", failures), added_as_a_whole(directory) as folder:
        (folder / "report.html").write_text(kind.html(result, numbers), encoding="utf-8")
    if video and len(result.log) > 1:
        with _lost_alone("video", failures), added_as_a_whole(directory) as folder:
            kind.write_video(result, folder / "video", progress)
    if result.outcome != "interrupted":
        mark_complete(directory)
    if failures:
        what = " and ".join(failure.partition("\n")[0] for failure in failures)
        tracebacks = "\n".join([result.traceback, *failures]).strip() + "\n"
        with added_as_a_whole(directory) as folder:
            (folder / "traceback.txt").write_text(tracebacks, encoding="utf-8", errors="replace")
        raise ValueError(f"{what}; all else is in {directory}, and traceback.txt tells more")
    return directory


@contextmanager
def _lost_alone(what: str, failures: list[str]) -> Iterator[None]:
    """Note an exception, as a line and its traceback, and go on: a drawing is less than the run."""
    try:
        yield
    except Exception as error:
        line = " ".join(f"the {what} could not be drawn: {type(error).__name__}: {error}".split())
        failures.append(f"{line}\n{traceback.format_exc()}")


def finish_results(folder: Path, numbers: dict[str, Any], draw: Callable[[Path], object] | None) -> None:
    """Draw the video of an estimation and write its summary; an interrupt of the video keeps everything else."""
    if draw is not None:
        try:
            draw(folder / "video")
        except KeyboardInterrupt:
            numbers["outcome"] = "interrupted"
    write_json(folder / "summary.json", numbers)
    if numbers["outcome"] == "interrupted":
        mark_interrupted(folder)


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a table as JSON."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
