"""One run from start to finish: assemble, loop, and gather what it has to tell."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.assembly.board_calibration import Told
from scenarios.assembly.trailer import Assembly, assemble
from scenarios.loop.session import Session
from scenarios.options.scenario import Scenario
from scenarios.randomness import stream
from scenarios.recordings.stereo_writer import RecordingWriter
from scenarios.results.log import Log, Signal
from scenarios.results.reference_unit import reference_off_tracking
from scenarios.results.run import CameraFrame, RunResult, TrailerAhead
from scenarios.results.trailer_signals import run_log, with_trailer_ahead
from vehicle.clock import TICK

Progress = Callable[[float, float], None]  # share done, simulated seconds so far


def run(
    scenario: Scenario,
    seed: int,
    *,
    keep_frames: bool = False,
    record: Path | None = None,
    progress: Progress | None = None,
    calibrating: Told | None = None,
) -> RunResult:
    """The result of the scenario's closed-loop run; an interrupt ends it early and keeps what there is.

    Args:
        scenario: what to run.
        seed: decides world and noise; the same seed on the same machine gives bitwise the same log and images.
        keep_frames: keep what the left camera saw, for a video and the report.
        record: folder to write the stereo images to, as a KITTI-style sequence.
        progress: told the share of the course that is done.
        calibrating: told how many pictures of calibration boards are done, of how many.

    Raises:
        ValueError: one line, if something of the scenario does not fit.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    with ExitStack() as cleanup:
        recording = record is not None
        parts = assemble(scenario, seed, keep_colour=keep_frames, record=recording, calibrating=calibrating)
        if parts.cameras:
            cleanup.callback(parts.cameras.renderer.close)
        recorder = cleanup.enter_context(_recorder(parts, record)) if record else None
        session = Session(parts, keep_frames=keep_frames, recorder=recorder)
        cleanup.callback(session.close)
        drive(session, progress)
        return _result(session)


class Driven(Protocol):
    """A run in progress, of whatever drives."""

    outcome: str | None  # None while the run goes on
    tick: int

    @property
    def progress(self) -> float:
        """How much of the course is done, 0 to 1."""

    def advance(self) -> None:
        """One round of the loop."""


def drive(session: Driven, progress: Progress | None) -> None:
    """Goes on until there is an outcome; an interrupt is one."""
    try:
        while session.outcome is None:
            session.advance()
            if progress:
                progress(session.progress, session.tick * TICK)
    except KeyboardInterrupt:
        session.outcome = "interrupted"


def _recorder(parts: Assembly, directory: Path) -> RecordingWriter:
    if parts.cameras is None:
        raise ValueError("there is no camera to record")
    return RecordingWriter(directory, parts.cameras.calibrated, parts.trailer.follow_distance)


def _result(session: Session) -> RunResult:
    parts = session.parts
    log = run_log(
        session.rows,
        session.estimates,
        units=[unit.name for unit in parts.vehicle.units],
        trailer_unit=parts.trailer_unit,
        follow_distance=parts.trailer.follow_distance,
        steers_ahead=parts.trailers[-1].steers_ahead,
        X_SC=parts.cameras.calibration.X_SC if parts.cameras else None,
    )
    for place, trailer in enumerate(parts.trailers[:-1]):
        log = with_trailer_ahead(
            log,
            session.rows,
            session.trailers[place].estimates,
            place=place,
            unit=trailer.name,
            follow_distance=trailer.geometry.follow_distance,
            steers_ahead=trailer.steers_ahead,
        )
    if parts.scenario.reference_unit:
        log = _with_reference(log, session)
    return RunResult(
        scenario=parts.scenario.name,
        scenario_toml=parts.scenario.to_toml(),
        seed=parts.seed,
        outcome=session.outcome or "unfinished",
        log=log,
        units=outlines(parts.vehicle),
        follow_distance=parts.trailer.follow_distance,
        road=parts.course.centreline,
        road_half_width=parts.course.road_half_width,
        circle_centre=parts.course.surface_centre,
        timing=session.stopwatch.timing(session.tick * TICK),
        frames=_camera_frames(session),
        manifest={
            "opengl_renderer": parts.cameras.renderer.name if parts.cameras else "none",
            "frames_sha256": session.images_sha256 if parts.cameras else "none",
        },
        trailer_steer_limit=parts.trailer.max_steer or None,
        trailers_ahead=tuple(
            TrailerAhead(name=trailer.name, follow_distance=trailer.geometry.follow_distance)
            for trailer in parts.trailers[:-1]
        ),
    )


def _with_reference(log: Log, session: Session) -> Log:
    parts = session.parts
    values = reference_off_tracking(
        [row.truth for row in session.rows],
        unit=parts.trailer_unit,
        follow_distance=parts.trailer.follow_distance,
        rng=stream(parts.seed, "reference unit"),
    )
    return log.with_signal(Signal("off_tracking_reference", "m", "as a GNSS-aided inertial unit has it"), values)


def _camera_frames(session: Session) -> tuple[CameraFrame, ...]:
    motions = {estimate.motion.tick: estimate.motion for estimate in session.estimates if estimate.motion}
    none = np.empty((0, 4), dtype=np.float32)
    return tuple(
        CameraFrame(
            tick=tick,
            jpeg=jpeg,
            tracks=motions[tick].tracks if tick in motions else none,
            matches=motions[tick].matches if tick in motions else 0,
            inliers=motions[tick].inliers if tick in motions else 0,
        )
        for tick, jpeg in session.frames
    )
