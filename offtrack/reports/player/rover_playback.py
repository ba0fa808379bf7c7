"""The playback of a rover's run."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from offtrack.reports.player.playback import (
    SERIES,
    Body,
    Chart,
    Curve,
    Line,
    Picture,
    Playback,
    PlayedRun,
    Reading,
    Trail,
    Wheel,
    fault_spans,
    health_spans,
)
from scenarios.results.rover_result import RoverResult, trace_lines
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_DEGREES = 180.0 / np.pi
_BESIDE = 0.6  # the body is as wide as this share of the distance between its wheels
_HEIGHTS = 0.16, 0.42  # of the body in the 3-D view [m], for drawings only


def rover_playback(result: RoverResult) -> Playback:
    """Everything that a page shows of the run over time."""
    return Playback(
        title=result.scenario,
        runs=(played_rover(result),),
        charts=tuple(_charts(result)),
        readings=tuple(_readings(result)),
        nearest=400.0,
    )


def played_rover(result: RoverResult, name: str = "") -> PlayedRun:
    """The run with its body, paths and pictures; by default under the scenario's name."""
    rig = result.rig
    x, y = (np.array([getattr(wheel, axis) for wheel in rig.wheels]) for axis in "xy")
    ends = np.array([[x.max(), 1.0], [x.max(), -1.0], [x.min(), -1.0], [x.min(), 1.0]])
    outline: FloatArray = ends * [1.0, _BESIDE * float(np.abs(y).max())]
    wheels = tuple(Wheel(w.x, w.y, 2.0 * rig.wheel_radius, rig.wheel_width, f"steer_{w.name}") for w in rig.wheels)
    trails = (
        Trail("path driven", "true", signals=("x", "y")),
        Trail("dead reckoning by wheels and compass", "grey", signals=("x_wheels", "y_wheels")),
        Trail("corrected by the slip angle", "estimated", signals=("x_corrected", "y_corrected")),
    )
    return PlayedRun(
        name=name or result.scenario,
        log=result.log,
        bodies=(Body(name=result.rover, outline=outline, wheels=wheels, pose=("x", "y", "psi"), heights=_HEIGHTS),),
        trails=tuple(trail for trail in trails if np.isfinite(result.log[trail.signals[0]]).any()),
        spans=tuple(chain(health_spans(result.log, "health"), fault_spans(result.scenario_toml, result.log))),
        pictures=list(_pictures(result)),
        lines=(Line("path to follow", "grey", result.path),),
    )


def _pictures(result: RoverResult) -> Iterator[Picture]:
    for frame in result.frames:
        true, estimate = trace_lines(result, frame.tick)
        lines = [true] if estimate is None else [true, estimate]
        strokes = np.concatenate([np.hstack([line[:-1], line[1:]]) for line in lines])
        yield Picture(frame.tick * TICK, frame.jpeg, strokes.astype(np.float32), lines=(len(true) - 1,) * len(lines))


def _charts(result: RoverResult) -> Iterator[Chart]:
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


def _readings(result: RoverResult) -> Iterator[Reading]:
    watched = result.rig.wheels[result.rig.watched].name
    yield Reading("true slip angle", "slip_angle_true", "°", _DEGREES, 2, "true")
    yield Reading("estimated", "slip_angle_estimate", "°", _DEGREES, 2, "estimated")
    yield Reading("distance from the path", "cross_track_true", "mm", 1e3, 0)
    yield Reading("speed", "v_x", "m/s", 1.0, 3)
    yield Reading(f"slip ratio, {watched.replace('_', ' ')}", f"slip_ratio_{watched}", "%", 100.0, 0)
    yield Reading(f"sinkage, {watched.replace('_', ' ')}", f"sinkage_{watched}", "mm", 1e3, 1)
