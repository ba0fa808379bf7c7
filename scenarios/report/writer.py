"""Writer of run directories.

A run directory holds ``scenario.toml`` (runs again identically), ``manifest.json`` (versions, seed, hashes),
``signals.parquet`` (SI, units in the schema), ``summary.json``, ``report.html``, a video, and after an exception
``traceback.txt``.
"""

from __future__ import annotations

import json
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
        ValueError: if the directory can not take a run, see ``run_directory.check_run_directory``; or if the report or
            the video can not be drawn: all other files are written then.
        KeyboardInterrupt: if the video was interrupted; all other files are written.
    """
    numbers, interrupt, failures = summary(result), None, list[str]()
    with appearing_at_once(directory) as folder:
        (folder / "scenario.toml").write_text(result.scenario_toml, encoding="utf-8")
        write_log(result.log, folder / "signals.parquet")
        _write_json(folder / "manifest.json", manifest(result))
        _write_json(folder / "summary.json", numbers)
        with _lost_alone("report", failures):
            _write_report(result, numbers, folder)
        try:
            with _lost_alone("video", failures):
                if video and len(result.log) > 1:
                    _write_video(result, folder, progress)
        except KeyboardInterrupt as error:
            interrupt = error
        if tracebacks := "\n".join([result.traceback, *failures]).strip():
            (folder / "traceback.txt").write_text(tracebacks + "\n", encoding="utf-8", errors="replace")
        if interrupt or result.outcome == "interrupted":
            mark_interrupted(folder)
    if interrupt:
        raise interrupt
    if failures:
        what = " and ".join(failure.partition("\n")[0] for failure in failures)
        raise ValueError(f"{what}; all else is in {directory}, and traceback.txt tells more")
    return directory


@contextmanager
def _lost_alone(what: str, failures: list[str]) -> Iterator[None]:
    """Note an exception, as a line and its traceback, and go on: a drawing is less than the run. A full disk is not."""
    try:
        yield
    except OSError:
        raise
    except Exception as error:
        line = " ".join(f"the {what} could not be drawn: {type(error).__name__}: {error}".split())
        failures.append(f"{line}\n{traceback.format_exc()}")


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
