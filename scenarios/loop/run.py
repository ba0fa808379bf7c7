"""Run a scenario of a trailer or rover from start to finish."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.assembly.rover import assemble_rover
from scenarios.assembly.trailer import LOG_PERIOD, Assembly, assemble, trailer_stream
from scenarios.hil.link import Link
from scenarios.hil.record import RECORD_NAME
from scenarios.loop.combination import SteeredTrailer, TrailerSession
from scenarios.loop.pacer import Pacer
from scenarios.loop.referee import lift_warnings
from scenarios.loop.rover import RoverSession
from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import Scenario
from scenarios.progress import Progress, no_progress
from scenarios.recordings.rover_writer import RoverRecordingWriter
from scenarios.recordings.stereo_writer import RecordingWriter
from scenarios.results.actuator_warnings import actuator_warnings
from scenarios.results.calibration_warnings import calibration_warnings
from scenarios.results.friction_picture import friction_picture
from scenarios.results.log import Log
from scenarios.results.outside import Outside
from scenarios.results.reference_unit import ReferenceOffTracking
from scenarios.results.rover import RoverResult, TraceFrame
from scenarios.results.rover_signals import rover_log
from scenarios.results.run_inputs import RunInputs, run_inputs
from scenarios.results.run_result import CameraFrame, JudgedTrailer, MountedCamera, RunResult
from scenarios.results.signal_warnings import signal_warnings
from scenarios.results.steer_warnings import SteeredAxle, steer_warnings
from scenarios.results.trailer_signals import TrailerTrack, run_log
from vehicle.clock import TICK
from vehicle.combination.data_sheet import data_sheet
from vehicle.frames import FloatArray

ResultT = TypeVar("ResultT", RunResult, RoverResult)
Watch = Callable[[Callable[[], RunResult | RoverResult]], None]  # takes the result so far from what it is given

_SPACING = 0.02  # distance between points of a rover's path in figures [m]


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


def rover_result(session: RoverSession, seed: int, inputs: RunInputs) -> RoverResult:
    """Result of a rover's run as far as it has come."""
    parts = session.parts
    scenario = parts.scenario
    return RoverResult(
        scenario=scenario.name,
        scenario_toml=scenario.to_toml(),
        seed=seed,
        outcome=session.outcome or "unfinished",
        log=rover_log(parts.rig, session.rows, session.estimates, parts.path, faults=bool(scenario.faults)),
        rover=parts.rover.name,
        path=parts.path.points(_SPACING),
        rig=parts.rig,
        timing=session.stopwatch.timing(session.tick * TICK),
        frames=tuple(TraceFrame(tick=tick, jpeg=jpeg) for tick, jpeg in session.pictures.frames),
        manifest={"frames_sha256": session.pictures.sha256 if parts.view else "none"},
        traceback=session.traceback,
        inputs=inputs,
    )


def _recorder(parts: Assembly, directory: Path) -> RecordingWriter:
    if parts.cameras is None:
        raise ValueError("there is no camera to record")
    last = parts.trailers[-1]
    return RecordingWriter(directory, parts.cameras.calibrated, last.geometry.follow_distance, last.path_height)


def trailer_result(session: TrailerSession, inputs: RunInputs, *, reference: bool = True) -> RunResult:
    """Result of a trailer's run as far as it has come; without the ``reference`` unit's signals it takes a fifth."""
    parts = session.parts
    vehicle = parts.vehicle
    outside = session.bench.report() if session.bench else None
    scenario, inputs = with_record(parts.scenario, inputs, outside)
    with_unit = reference and scenario.reference_unit
    tracks = [_track(session, trailer, with_unit=with_unit) for trailer in session.trailers]
    log = run_log(session.rows, tracks, vehicle)
    return RunResult(
        scenario=scenario.name,
        scenario_toml=scenario.to_toml(),
        seed=parts.seed,
        outcome=session.outcome or "unfinished",
        log=log,
        units=outlines(vehicle),
        trailers=tuple(
            JudgedTrailer(
                name=trailer.name,
                follow_distance=trailer.geometry.follow_distance,
                n_steered=trailer.n_steered,
                max_steer=trailer.geometry.max_steer or None,
            )
            for trailer in parts.trailers
        ),
        road=parts.course.centreline,
        road_half_width=parts.course.road_half_width,
        friction=friction_picture(parts.surface, parts.course.centreline),
        road_known=parts.trace is None,
        circle_centre=parts.course.surface_centre,
        arcs=parts.course.arcs,
        path_deviation=parts.course.deviation,
        timing=session.stopwatch.timing(session.tick * TICK),
        frames=_camera_frames(session),
        cameras=tuple(
            MountedCamera(trailer.unit, trailer.sensing.cameras.calibration)
            for trailer in parts.trailers
            if trailer.sensing.cameras
        ),
        manifest={
            "opengl_renderer": parts.views.renderer_name,
            "frames_sha256": session.pictures.sha256 if parts.cameras else "none",
        },
        warnings=(
            *filter(None, (session.reason,)),
            *parts.remarks,
            *data_sheet(vehicle).warnings,
            *_steer_warnings(parts, log),
            *_camera_warnings(session),
            *_signal_warnings(session),
            *lift_warnings(vehicle, log),
        ),
        traceback=session.traceback,
        inputs=inputs,
        outside=outside,
    )


def with_record(scenario: Scenario, inputs: RunInputs, outside: Outside | None) -> tuple[Scenario, RunInputs]:
    """The scenario that repeats the demands from outside, with their record among its inputs."""
    if outside is None or not outside.record:
        return scenario, inputs
    options = scenario.outside.model_copy(update={"record": RECORD_NAME})
    files = {**inputs.files, RECORD_NAME: outside.record.encode()}
    return scenario.model_copy(update={"outside": options}), replace(inputs, files=files)


def _steer_warnings(parts: Assembly, log: Log) -> tuple[str, ...]:
    vehicle, tractor = parts.vehicle, parts.vehicle.units[0].name
    axles = [
        SteeredAxle(
            signal=signal,
            name=f"{unit.name}, axle {k}",
            limit=unit.steering.limit * abs(axle.steer_ratio),
            rate_limit=unit.steering.rate_limit * abs(axle.steer_ratio),
        )
        for unit, outline in zip(vehicle.units, outlines(vehicle), strict=True)
        for k, (axle, signal) in enumerate(zip(unit.axles, outline.steer_signals, strict=True), start=1)
        if signal is not None and unit.steering is not None
    ]
    if f"x_{tractor}" not in log:
        return ()
    return steer_warnings(
        log, axles, parts.course.centreline, np.column_stack([log[f"x_{tractor}"], log[f"y_{tractor}"]])
    )


def _camera_warnings(session: TrailerSession) -> tuple[str, ...]:
    """Warnings about the cameras of all trailers."""
    return tuple(
        f"{trailer.trailer.name}: {line}"
        for trailer in session.trailers
        for line in calibration_warnings((e.motion for e in trailer.estimates), "set rig.self_calibration=true")
    )


def _signal_warnings(session: TrailerSession) -> tuple[str, ...]:
    """Warnings about signals and steering actuators of all trailers."""
    return tuple(
        f"{trailer.trailer.name}{line}"
        for trailer in session.trailers
        for line in (
            *(f": {line}" for line in signal_warnings(trailer.findings)),
            *(f", {line}" for line in actuator_warnings(trailer.actuator_findings)),
        )
    )


def _track(session: TrailerSession, trailer: SteeredTrailer, *, with_unit: bool) -> TrailerTrack:
    """A trailer's estimates, and the reference unit on it if there is one."""
    watched, cameras = trailer.trailer, trailer.trailer.sensing.cameras
    return TrailerTrack(
        name=watched.name,
        unit=watched.unit,
        follow_distance=watched.geometry.follow_distance,
        path_height=watched.path_height,
        steers_ahead=watched.steers_ahead,
        n_steered=watched.n_steered,
        estimates=trailer.estimates,
        X_SC=cameras.calibration.X_SC if cameras else None,
        reference=_reference(session, trailer) if with_unit else None,
        fallback=_fallback(session, trailer) if session.parts.scenario.faults else None,
        distrusted=_distrusted(session, trailer) if session.parts.scenario.faults else None,
        axles_at_fault=_axles_at_fault(session, trailer) if session.parts.scenario.faults else None,
    )


def _fallback(session: TrailerSession, trailer: SteeredTrailer) -> FloatArray:
    """1 in rows in which the fallback steers the trailer, 0 in others."""
    ticks = [tick for tick, _ in trailer.handovers]
    states = np.array([0.0, *(float(by_fallback) for _, by_fallback in trailer.handovers)])
    return _in_rows(session, ticks, states)


def _distrusted(session: TrailerSession, trailer: SteeredTrailer) -> FloatArray:
    """Number of signals that the guard of a trailer's law holds to be at fault in each row."""
    findings = sorted(trailer.findings, key=lambda finding: finding.tick)
    counts = np.cumsum([0.0, *(1.0 if finding.at_fault else -1.0 for finding in findings)])
    ticks = [finding.tick for finding in findings]
    return _in_rows(session, ticks, counts)


def _axles_at_fault(session: TrailerSession, trailer: SteeredTrailer) -> FloatArray:
    """Number of axles that do not follow their demands, as the supervision of a trailer's law holds, in each row."""
    counts, findings = np.zeros(len(session.rows)), trailer.actuator_findings
    for axles in dict.fromkeys(finding.axles for finding in findings):
        own = [finding for finding in findings if finding.axles == axles]
        states = np.array([0.0, *(float(len(axles) * (finding.kind != "sound")) for finding in own)])
        ticks = [finding.tick for finding in own]
        counts += _in_rows(session, ticks, states)
    return counts


def _in_rows(session: TrailerSession, ticks: Sequence[int], states: FloatArray) -> FloatArray:
    """State in each row: the first of ``states`` (n + 1,), and from each of the n ``ticks`` on the next one."""
    return states[np.searchsorted(ticks, LOG_PERIOD * np.arange(len(session.rows)), side="right")]


def _reference(session: TrailerSession, trailer: SteeredTrailer) -> ReferenceOffTracking:
    parts, watched = session.parts, trailer.trailer
    return ReferenceOffTracking(
        unit=watched.unit,
        follow_distance=watched.geometry.follow_distance,
        path_height=watched.path_height,
        rng=trailer_stream(parts.seed, parts.vehicle, watched.unit, "reference unit"),
    )


def _camera_frames(session: TrailerSession) -> tuple[CameraFrame, ...]:
    frames = session.pictures.frames
    shown = {tick for tick, _ in frames}
    motions = {
        estimate.motion.tick: estimate.motion
        for estimate in session.trailers[-1].estimates
        if estimate.motion and estimate.motion.tick in shown
    }
    none = np.empty((0, 4), dtype=np.float32)
    return tuple(
        CameraFrame(
            tick=tick,
            jpeg=jpeg,
            tracks=motions[tick].tracks if tick in motions else none,
            matches=motions[tick].matches if tick in motions else 0,
            inliers=motions[tick].inliers if tick in motions else 0,
        )
        for tick, jpeg in frames
    )
