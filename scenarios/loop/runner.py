"""Run a scenario of a trailer or rover from start to finish."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from offtrack.exchange.recordings.writers import RecordingWriter, RoverRecordingWriter
from scenarios.assembly.rover_run import assemble_rover
from scenarios.assembly.trailer_run import Assembly, assemble
from scenarios.loop.demands import Link
from scenarios.loop.result import rover_result, trailer_result
from scenarios.loop.rover_session import RoverSession
from scenarios.loop.timing import Pacer
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.rover_scenario import RoverScenario
from scenarios.options.scenario import Scenario
from scenarios.progress import Progress, no_progress
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_inputs import run_inputs
from scenarios.results.trailer_result import RunResult

ResultT = TypeVar("ResultT", RunResult, RoverResult)
Watch = Callable[[Callable[[], RunResult | RoverResult]], None]  # takes the result so far from what it is given


def run_any(
    scenario: Scenario | RoverScenario,
    seed: int,
    *,
    keep_frames: bool = False,
    record: Path | None = None,
    progress: Progress = no_progress,
    calibration_progress: Progress = no_progress,
    pacer: Pacer | None = None,
    links: Sequence[Link] = (),
    watch: Watch | None = None,
) -> RunResult | RoverResult:
    """Run a trailer's or a rover's scenario; see :func:`run` and :func:`run_rover`."""
    if isinstance(scenario, RoverScenario):
        if links:
            raise ValueError(f"--{links[0].name}: signals and demands are those of trailers; a rover has none")
        return run_rover(
            scenario, seed, keep_frames=keep_frames, record=record, progress=progress, pacer=pacer, watch=watch
        )
    return run(
        scenario,
        seed,
        keep_frames=keep_frames,
        record=record,
        progress=progress,
        calibration_progress=calibration_progress,
        pacer=pacer,
        links=links,
        watch=watch,
    )


def run(
    scenario: Scenario,
    seed: int,
    *,
    keep_frames: bool = False,
    record: Path | None = None,
    progress: Progress = no_progress,
    calibration_progress: Progress = no_progress,
    pacer: Pacer | None = None,
    links: Sequence[Link] = (),
    watch: Watch | None = None,
) -> RunResult:
    """Run a trailer's scenario in the closed loop; an interrupt or an exception ends it early; results so far are kept.

    Args:
        scenario: the scenario.
        seed: decides world and noise; the same seed on the same machine gives bitwise the same log and images.
        keep_frames: keep pictures of the left camera for the video and the report.
        record: folder for the stereo images, written as a KITTI-style sequence.
        progress: receives the completed share of the course.
        calibration_progress: receives the number of finished pictures of calibration boards, and their total.
        pacer: keeps the run to wall time; cameras are rendered while the loop goes on.
        links: to a bench, which gets the signals and steers what ``outside.demands`` says.
        watch: is called between two steps with a function that makes the result so far.

    Raises:
        ValueError: one line, if the scenario is not consistent.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    inputs = run_inputs(scenario.model_dump(exclude_none=True))
    renderer: Executor | None = None
    with ExitStack() as cleanup:
        opened = partial(assemble, scenario, seed, keep_colour=keep_frames, record=record is not None)
        if pacer is None:
            parts = cleanup.enter_context(closing(opened(progress=calibration_progress)))
        else:  # OpenGL's objects belong to the thread that made them
            renderer = cleanup.enter_context(ThreadPoolExecutor(max_workers=1, thread_name_prefix="renderer"))
            parts = renderer.submit(opened).result()
            cleanup.callback(renderer.submit, parts.close)
        recorder = cleanup.enter_context(_recorder(parts, record)) if record else None
        session = cleanup.enter_context(
            TrailerSession(
                parts,
                keep_frames=keep_frames,
                recorder=recorder,
                renderer=renderer,
                links=links,
                is_paced=pacer is not None,
            )
        )
        progress = _watched(progress, watch, partial(trailer_result, session, inputs, reference=False))
        if pacer is None:
            session.run(progress)
        else:
            session.run_paced(pacer, progress)
            session.finish_pictures()
        if recorder:
            recorder.end(interrupted=session.outcome == "interrupted")
        return with_pace(trailer_result(session, inputs), pacer)


def run_rover(
    scenario: RoverScenario,
    seed: int,
    *,
    keep_frames: bool = False,
    record: Path | None = None,
    progress: Progress = no_progress,
    pacer: Pacer | None = None,
    watch: Watch | None = None,
) -> RoverResult:
    """Run a rover's scenario in the closed loop like :func:`run`; ``record`` gets images, readings and calibration.

    A rover's camera sees the sand that the wheels have just shaped, so the loop renders it also where it is paced.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    inputs = run_inputs(scenario.model_dump(exclude_none=True))
    with ExitStack() as cleanup:
        parts = cleanup.enter_context(closing(assemble_rover(scenario, seed, record=record is not None)))
        recorder = cleanup.enter_context(RoverRecordingWriter(record, parts.rig)) if record else None
        session = cleanup.enter_context(RoverSession(parts, keep_frames=keep_frames, recorder=recorder))
        progress = _watched(progress, watch, partial(rover_result, session, seed, inputs))
        if pacer is None:
            session.run(progress)
        else:
            session.run_paced(pacer, progress)
        if recorder:
            recorder.end(interrupted=session.outcome == "interrupted")
        return with_pace(rover_result(session, seed, inputs), pacer)


def _recorder(parts: Assembly, directory: Path) -> RecordingWriter:
    if parts.cameras is None:
        raise ValueError("there is no camera to record")
    last = parts.trailers[-1]
    return RecordingWriter(directory, parts.cameras.calibrated, last.geometry.follow_distance, last.path_height)


def _watched(progress: Progress, watch: Watch | None, result: Callable[[], RunResult | RoverResult]) -> Progress:
    """The progress callback, which asks the watch too."""
    if watch is None:
        return progress

    def both(done: float, total: float, note: str = "", /) -> None:
        watch(result)
        progress(done, total, note)

    return both


def with_pace(result: ResultT, pacer: Pacer | None) -> ResultT:
    """The result with the report of the pacer, if there was one."""
    return result if pacer is None else replace(result, paced=pacer.report())
