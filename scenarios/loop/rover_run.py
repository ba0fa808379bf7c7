"""A rover's run from start to finish: assemble, loop, and gather what it has to tell."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from scenarios.assembly.rover import assemble_rover
from scenarios.loop.rover_session import RoverSession, cross_track
from scenarios.loop.run import Progress, drive
from scenarios.options.rover import RoverScenario
from scenarios.recordings.rover_writer import RoverRecordingWriter
from scenarios.results.rover import RoverResult, TraceFrame
from scenarios.results.rover_signals import rover_log
from vehicle.clock import TICK

_SPACING = 0.02  # of the path's points in figures [m]


def run_rover(
    scenario: RoverScenario,
    seed: int,
    *,
    keep_frames: bool = False,
    record: Path | None = None,
    progress: Progress | None = None,
) -> RoverResult:
    """The result of the scenario's closed-loop run; an interrupt ends it early and keeps what there is.

    Args:
        scenario: what to run.
        seed: decides ground and noise; the same seed on the same machine gives bitwise the same log and images.
        keep_frames: keep what the camera saw, for a video and the report.
        record: folder to write images, readings and calibration to.
        progress: told the share of the course that is done.

    Raises:
        ValueError: one line, if something of the scenario does not fit.
    """
    with ExitStack() as cleanup:
        parts = assemble_rover(scenario, seed, record=record is not None)
        recorder = cleanup.enter_context(RoverRecordingWriter(record, parts.rig)) if record else None
        session = RoverSession(parts, keep_frames=keep_frames, recorder=recorder)
        cleanup.callback(session.close)
        drive(session, progress)
        return _result(session)


def _result(session: RoverSession) -> RoverResult:
    parts = session.parts
    return RoverResult(
        scenario=parts.scenario.name,
        scenario_toml=parts.scenario.to_toml(),
        seed=parts.seed,
        outcome=session.outcome or "unfinished",
        log=rover_log(parts.rig, session.rows, [cross_track(parts, row) for row in session.rows], session.estimates),
        rover=parts.rover.name,
        path=parts.path.points(_SPACING),
        rig=parts.rig,
        timing=session.stopwatch.timing(session.tick * TICK),
        frames=tuple(TraceFrame(tick=tick, jpeg=jpeg) for tick, jpeg in session.frames),
        manifest={"frames_sha256": session.images_sha256 if parts.camera else "none"},
    )
