"""Playbacks of runs: of a trailer's and of a rover's."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from offtrack.reports.player.playback import (
    SERIES,
    Body,
    Camera,
    Chart,
    Curve,
    EstimatedPath,
    Line,
    Picture,
    Playback,
    PlayedRun,
    Reading,
    Road,
    Trail,
    Wheel,
    fault_spans,
    health_spans,
)
from scenarios.results.log import Log
from scenarios.results.rover_result import RoverResult, trace_lines
from scenarios.results.swept_path import UnitOutline
from scenarios.results.trailer_result import CameraFrame, RunResult
from vehicle.clock import TICK
from vehicle.foundation.polyline import sides
from vehicle.frames import FloatArray

_TYRE = (1.0, 0.34)  # length and width of a 385/65 R 22.5 from above, for drawings only [m]
_FLOOR, _CAB, _BOX = 0.6, 3.1, 4.0  # heights in the 3-D view [m], for drawings only
_DEGREES = 180.0 / np.pi


def trailer_playback(result: RunResult) -> Playback:
    """Everything that a page shows of the run over time."""
    last, follow = len(result.units) - 1, (-result.follow_distance, 0.0)
    estimated = EstimatedPath(
        f"estimated path of the {result.leader}", last, follow, "off_tracking_estimate", "off_tracking_std", "health"
    )
    run = PlayedRun(
        name=result.scenario,
        log=result.log,
        bodies=tuple(unit_body(unit, result.log) for unit in result.units),
        trails=(
            Trail(f"path of the {result.leader}", "true", last),
            Trail("path of the follow point", "estimated", last, follow),
        ),
        estimated=estimated if np.isfinite(result.signal("health")).any() else None,
        spans=(*health_spans(result.log, "health"), *fault_spans(result.scenario_toml, result.log)),
        pictures=[_picture(frame) for frame in result.frames],
        cameras=tuple(
            Camera(unit, c.X_SC, 0.5 * c.width / c.focal_length, 0.5 * c.height / c.focal_length)
            for unit, c in result.cameras
        ),
    )
    return Playback(
        title=result.scenario,
        runs=(run,),
        road=Road(*sides(result.road, result.road_half_width)) if len(result.road) > 1 else None,
        friction=result.friction,
        charts=tuple(_trailer_charts(result)),
        readings=tuple(_readings(result)),
    )


def unit_body(unit: UnitOutline, log: Log) -> Body:
    """The body of a unit."""
    tilt = (f"roll_{unit.name}", f"pitch_{unit.name}")
    steer = unit.steer_signals or (None,) * len(unit.axles)
    wheels = tuple(
        Wheel(x, side * track, *_TYRE, steer=signal if signal and signal in log else "")
        for x, track, signal in zip(unit.axles, unit.tracks, steer, strict=True)
        for side in (0.5, -0.5)
    )
    return Body(
        name=unit.name,
        outline=unit.corners,
        wheels=wheels,
        pose=(f"x_{unit.name}", f"y_{unit.name}", f"psi_{unit.name}"),
        tilt=tilt if tilt[0] in log and tilt[1] in log else None,
        heights=(_FLOOR, _CAB if unit.name == "tractor" else _BOX),
    )


def _picture(frame: CameraFrame) -> Picture:
    caption = f"{frame.inliers} inliers of {frame.matches} matches" if frame.matches else ""
    return Picture(frame.tick * TICK, frame.jpeg, frame.tracks, caption)


def _trailer_charts(result: RunResult) -> Iterator[Chart]:
    """Charts of the signals that the run has."""
    has_estimate = np.isfinite(result.signal("health")).any()
    true = Curve("off_tracking_true", "true", "true")
    estimated = (
        Curve("off_tracking_std", "±2 σ", "estimated", "band", base="off_tracking_estimate"),
        Curve("off_tracking_estimate", "estimated", "estimated", "dots"),
    )
    yield Chart(
        f"Off-tracking, + when the path of the {result.leader} lies left",
        "m",
        (*estimated, true) if has_estimate else (true,),
    )
    if has_estimate:
        error = Curve("off_tracking_estimate", "error", "estimated", "dots", 1e3, less="off_tracking_true")
        band = Curve("off_tracking_std", "±2 σ", "estimated", "band", 1e3)
        yield Chart("Error of the estimate", "mm", (band, error), 1)
    limit = result.trailer_steer_limit
    steer = tuple(_steer(result))
    yield Chart("Steer angles of the road wheels, + left", "°", steer, 2, None if limit is None else _DEGREES * limit)
    if len(result.units) > 1:
        yield Chart("Articulation angle", "°", tuple(_each(result, "articulation_", "joint", _DEGREES)), 2)
    speeds = tuple(
        Curve(f"v_x_{unit.name}", unit.name, colour, scale=3.6)
        for unit, colour in zip(result.units[:1], SERIES, strict=False)
    )
    yield Chart("Speed", "km/h", speeds, 1)
    yield Chart("Lateral acceleration, + left", "m/s²", tuple(_units(result, "lateral_acceleration_")), 2)
    yield Chart("Load transfer: ±1 when one side is in the air", "-", tuple(_units(result, "load_transfer_")), 2)
    used = Curve("friction_used_max", "largest of all tyres", "fifth")
    yield Chart("Share of the friction in use", "-", (used,), 2)
    if np.isfinite(result.signal("matches")).any():
        matches = Curve("matches", "matches", "grey", "dots"), Curve("inliers", "inliers", "true", "dots")
        yield Chart("Features per frame", "-", matches, 0)


def _steer(result: RunResult) -> Iterator[Curve]:
    pairs = zip(result.steer_signals(), result.steer_signals(demands=True), strict=True)
    for k, (name, demand) in enumerate(pairs):
        colour = SERIES[k % len(SERIES)]
        yield Curve(name, f"{result.steered_name} {k + 1}", colour, scale=_DEGREES)
        yield Curve(demand, f"demand {k + 1}", colour, "dashed", _DEGREES)
    if "steer_tractor" in result.log:
        yield Curve("steer_tractor", "front axle", "grey", scale=_DEGREES)


def _each(result: RunResult, prefix: str, label: str, scale: float) -> Iterator[Curve]:
    names = [name for name in result.log.names if name.startswith(prefix)]
    for k, name in enumerate(names):
        suffix = f" {name.removeprefix(prefix)}" if len(names) > 1 else ""
        yield Curve(name, label + suffix, SERIES[k % len(SERIES)], scale=scale)


def _units(result: RunResult, prefix: str) -> Iterator[Curve]:
    for k, unit in enumerate(result.units):
        if prefix + unit.name in result.log:
            yield Curve(prefix + unit.name, unit.name, SERIES[k % len(SERIES)])


def _readings(result: RunResult) -> Iterator[Reading]:
    yield Reading("speed", f"v_x_{result.units[0].name}", "km/h", 3.6, 1)
    yield Reading("true off-tracking", "off_tracking_true", "m", 1.0, 3, "true")
    if np.isfinite(result.signal("health")).any():
        yield Reading("estimated", "off_tracking_estimate", "m", 1.0, 3, "estimated")
        yield Reading("its σ", "off_tracking_std", "mm", 1e3, 1, "estimated")
    if names := result.steer_signals():
        yield Reading("rear axle steer", names[-1], "°", _DEGREES, 1)
    if "articulation_1" in result.log:
        yield Reading("articulation", "articulation_1", "°", _DEGREES, 1)
    if "lateral_acceleration_tractor" in result.log:
        yield Reading("lateral acceleration", "lateral_acceleration_tractor", "m/s²", 1.0, 2)
    yield Reading("friction in use", "friction_used_max", "%", 100.0, 0)


_BESIDE = 0.6  # the body is as wide as this share of the distance between its wheels
_HEIGHTS = 0.16, 0.42  # of the body in the 3-D view [m], for drawings only


def rover_playback(result: RoverResult) -> Playback:
    """Everything that a page shows of the run over time."""
    rig = result.rig
    x, y = (np.array([getattr(wheel, axis) for wheel in rig.wheels]) for axis in "xy")
    ends = np.array([[x.max(), 1.0], [x.max(), -1.0], [x.min(), -1.0], [x.min(), 1.0]])
    outline: FloatArray = ends * [1.0, _BESIDE * float(np.abs(y).max())]
    steer = (f"steer_{wheel.name}" for wheel in rig.wheels)
    wheels = tuple(
        Wheel(wheel.x, wheel.y, 2.0 * rig.wheel_radius, rig.wheel_width, name if name in result.log else "")
        for wheel, name in zip(rig.wheels, steer, strict=True)
    )
    trails = (
        Trail("path driven", "true", signals=("x", "y")),
        Trail("dead reckoning by wheels and compass", "grey", signals=("x_wheels", "y_wheels")),
        Trail("corrected by the slip angle", "estimated", signals=("x_corrected", "y_corrected")),
    )
    run = PlayedRun(
        name=result.scenario,
        log=result.log,
        bodies=(Body(name=result.rover, outline=outline, wheels=wheels, pose=("x", "y", "psi"), heights=_HEIGHTS),),
        trails=tuple(trail for trail in trails if np.isfinite(result.log[trail.signals[0]]).any()),
        spans=(*health_spans(result.log, "health"), *fault_spans(result.scenario_toml, result.log)),
        pictures=list(_rover_pictures(result)),
        lines=(Line("path to follow", "grey", result.path),),
    )
    charts, readings = tuple(_rover_charts(result)), tuple(_rover_readings(result))
    return Playback(title=result.scenario, runs=(run,), charts=charts, readings=readings, nearest=400.0)


def _rover_pictures(result: RoverResult) -> Iterator[Picture]:
    for frame in result.frames:
        true, estimate = trace_lines(result, frame.tick)
        lines = [true] if estimate is None else [true, estimate]
        strokes = np.concatenate([np.hstack([line[:-1], line[1:]]) for line in lines])
        yield Picture(frame.tick * TICK, frame.jpeg, strokes.astype(np.float32), lines=(len(true) - 1,) * len(lines))


def _rover_charts(result: RoverResult) -> Iterator[Chart]:
    slip = (
        Curve("slip_angle_std", "±2 σ", "estimated", "band", _DEGREES, base="slip_angle_estimate"),
        Curve("slip_angle_laser", "laser and compass", "grey", scale=_DEGREES),
        Curve("slip_angle_estimate", "estimated", "estimated", "dots", _DEGREES),
        Curve("slip_angle_lagged", "estimated 2 s later", "third", "dots", _DEGREES),
        Curve("slip_angle_true", "true", "true", scale=_DEGREES),
    )
    yield Chart("Slip angle, + left", "°", slip, 2)
    error = Curve("slip_angle_estimate", "error", "estimated", "dots", _DEGREES, less="slip_angle_true")
    yield Chart(
        "Error of the estimate", "°", (Curve("slip_angle_std", "±2 σ", "estimated", "band", _DEGREES), error), 2
    )
    yield Chart(
        "Distance from the path, + left", "mm", (Curve("cross_track_true", "of the body", "true", scale=1e3),), 0
    )
    for title, unit, prefix, scale in (
        ("Slip ratio of the wheels", "-", "slip_ratio_", 1.0),
        ("Sinkage of the wheels", "mm", "sinkage_", 1e3),
        ("Steer angles of the wheels", "°", "steer_", _DEGREES),
    ):
        curves = tuple(
            Curve(prefix + wheel.name, wheel.name.replace("_", " "), SERIES[k % len(SERIES)], scale=scale)
            for k, wheel in enumerate(result.rig.wheels)
        )
        yield Chart(title, unit, curves, 2)


def _rover_readings(result: RoverResult) -> Iterator[Reading]:
    watched = result.rig.wheels[result.rig.watched].name
    yield Reading("true slip angle", "slip_angle_true", "°", _DEGREES, 2, "true")
    yield Reading("estimated", "slip_angle_estimate", "°", _DEGREES, 2, "estimated")
    yield Reading("distance from the path", "cross_track_true", "mm", 1e3, 0)
    yield Reading("speed", "v_x", "m/s", 1.0, 3)
    yield Reading(f"slip ratio, {watched.replace('_', ' ')}", f"slip_ratio_{watched}", "%", 100.0, 0)
    yield Reading(f"sinkage, {watched.replace('_', ' ')}", f"sinkage_{watched}", "mm", 1e3, 1)
