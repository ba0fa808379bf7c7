"""Result of a run as far as it has come, with the tracks of its trailers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.assembly.trailer_run import LOG_PERIOD, Assembly, trailer_stream
from scenarios.loop.demands import RECORD_NAME
from scenarios.loop.referee import lift_warnings
from scenarios.loop.rover_session import RoverSession
from scenarios.loop.trailer_session import SteeredTrailer, TrailerSession
from scenarios.options.scenario import Scenario
from scenarios.results.log import Log
from scenarios.results.rover_result import RoverResult, TraceFrame, rover_log
from scenarios.results.run_inputs import RunInputs
from scenarios.results.run_warnings import (
    SteeredAxle,
    actuator_warnings,
    calibration_warnings,
    signal_warnings,
    steer_warnings,
)
from scenarios.results.summary_numbers import Outside
from scenarios.results.trailer_result import CameraFrame, JudgedTrailer, MountedCamera, RunResult, friction_picture
from scenarios.results.trailer_signals import ReferenceOffTracking, TrailerTrack, run_log
from vehicle.clock import TICK
from vehicle.combination.data_sheet import data_sheet
from vehicle.frames import FloatArray


def track_of(session: TrailerSession, trailer: SteeredTrailer, *, with_unit: bool) -> TrailerTrack:
    """A trailer's estimates, and the reference unit on it if there is one."""
    watched, cameras = trailer.trailer, trailer.trailer.sensing.cameras
    n, has_faults = len(session.rows), bool(session.parts.scenario.faults)
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
        fallback=_fallback(trailer, n) if has_faults else None,
        distrusted=_distrusted(trailer, n) if has_faults else None,
        axles_at_fault=_axles_at_fault(trailer, n) if has_faults else None,
    )


def _reference(session: TrailerSession, trailer: SteeredTrailer) -> ReferenceOffTracking:
    parts, watched = session.parts, trailer.trailer
    return ReferenceOffTracking(
        unit=watched.unit,
        follow_distance=watched.geometry.follow_distance,
        path_height=watched.path_height,
        rng=trailer_stream(parts.seed, parts.vehicle, watched.unit, "reference unit"),
    )


def _fallback(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """1 in rows in which the fallback steers the trailer, 0 in others."""
    ticks = [tick for tick, _ in trailer.handovers]
    states = np.array([0.0, *(float(by_fallback) for _, by_fallback in trailer.handovers)])
    return _in_rows(n_rows, ticks, states)


def _distrusted(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """Number of signals that the guard of a trailer's law holds to be at fault in each row."""
    findings = sorted(trailer.findings, key=lambda finding: finding.tick)
    counts = np.cumsum([0.0, *(1.0 if finding.at_fault else -1.0 for finding in findings)])
    ticks = [finding.tick for finding in findings]
    return _in_rows(n_rows, ticks, counts)


def _axles_at_fault(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """Number of axles that do not follow their demands, as the supervision of a trailer's law holds, in each row."""
    counts, findings = np.zeros(n_rows), trailer.actuator_findings
    for axles in dict.fromkeys(finding.axles for finding in findings):
        own = [finding for finding in findings if finding.axles == axles]
        states = np.array([0.0, *(float(len(axles) * (finding.kind != "sound")) for finding in own)])
        ticks = [finding.tick for finding in own]
        counts += _in_rows(n_rows, ticks, states)
    return counts


def _in_rows(n_rows: int, ticks: Sequence[int], states: FloatArray) -> FloatArray:
    """State in each row: the first of ``states`` (n + 1,), and from each of the n ``ticks`` on the next one."""
    return states[np.searchsorted(ticks, LOG_PERIOD * np.arange(n_rows), side="right")]


_SPACING = 0.02  # distance between points of a rover's path in figures [m]


def trailer_result(session: TrailerSession, inputs: RunInputs, *, reference: bool = True) -> RunResult:
    """Result of a trailer's run as far as it has come; without the ``reference`` unit's signals it takes a fifth."""
    parts = session.parts
    vehicle = parts.vehicle
    outside = session.bench.report() if session.bench else None
    scenario, inputs = with_record(parts.scenario, inputs, outside)
    with_unit = reference and scenario.reference_unit
    tracks = [track_of(session, trailer, with_unit=with_unit) for trailer in session.trailers]
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
