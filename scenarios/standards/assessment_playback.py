"""The playback of an assessment: one manoeuvre at a time is chosen and played."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.player.playback import SERIES, Chart, Curve, Line, Playback, PlayedRun, Reading, Trail
from scenarios.player.trailer import unit_body
from scenarios.results.log import Column, Log, Signal
from scenarios.standards.assessment import Assessment, AssessmentMatrix
from scenarios.standards.manoeuvre import Manoeuvre
from scenarios.standards.motion import articulation, lateral_acceleration
from vehicle.combination.description import Vehicle

_DEGREES: Final = 180.0 / np.pi
_KEPT: Final = ("x_", "y_", "psi_", "v_x_", "yaw_rate_", "roll_", "pitch_", "steer_")  # signals of a page


def assessment_playback(matrix: AssessmentMatrix) -> Playback | None:
    """Everything that a page shows of the manoeuvres over time; None if nothing moved."""
    several = len(matrix.cases) > 1
    runs = [
        _played(case, manoeuvre, f"{manoeuvre.title}{f' · {name}' if several else ''}")
        for case, name in zip(matrix.cases, matrix.names, strict=True)
        for manoeuvre in case.manoeuvres
        if len(manoeuvre.log) > 1 and f"x_{matrix.vehicle.units[0].name}" in manoeuvre.log
    ]
    if not runs:
        return None
    return Playback(
        title=matrix.vehicle.name,
        runs=tuple(runs),
        together=False,
        charts=tuple(_charts(matrix.vehicle, runs)),
        readings=tuple(_readings(matrix.vehicle)),
    )


def _played(case: Assessment, manoeuvre: Manoeuvre, name: str) -> PlayedRun:
    vehicle, log = case.vehicle, _shown_log(case.vehicle, manoeuvre.log)
    bodies = outlines(vehicle)
    last = vehicle.units[-1]
    return PlayedRun(
        name=name,
        log=log,
        bodies=tuple(unit_body(unit, log) for unit in bodies),
        trails=(
            Trail("path of the front axle", "true", 0, (bodies[0].axles[0], 0.0)),
            Trail(f"path of the last axle ({last.name})", "estimated", len(bodies) - 1, (bodies[-1].axles[-1], 0.0)),
        ),
        lines=() if manoeuvre.course is None else (Line("prescribed path", "grey", manoeuvre.course),),
    )


def _shown_log(vehicle: Vehicle, log: Log) -> Log:
    """Motion and steering of the log, with articulations and lateral accelerations."""
    kept = [signal for signal in log.signals if signal.name == "time" or signal.name.startswith(_KEPT)]
    return Log.of([*((signal, log[signal.name]) for signal in kept), *_derived(vehicle, log)])


def _derived(vehicle: Vehicle, log: Log) -> Iterator[Column]:
    names = [unit.name for unit in vehicle.units]
    for k, (ahead, behind) in enumerate(itertools.pairwise(names), start=1):
        if f"articulation_{k}" not in log:
            yield (
                Signal(f"articulation_{k}", "rad", f"yaw of {ahead} minus yaw of {behind}"),
                articulation(log, ahead, behind),
            )
    for unit in vehicle.units:
        if f"lateral_acceleration_{unit.name}" not in log:
            meaning = f"{unit.name}: of the centre of gravity over the ground, + left"
            values = lateral_acceleration(log, unit.name, unit.cg_x)
            yield Signal(f"lateral_acceleration_{unit.name}", "m/s2", meaning), values


def _charts(vehicle: Vehicle, runs: Sequence[PlayedRun]) -> Iterator[Chart]:
    names = {name for run in runs for name in run.log.names}
    units = [unit.name for unit in vehicle.units]
    steer = sorted(name for name in names if name.startswith("steer_") and "command" not in name)
    for title, unit, shown, scale in (
        ("Steer angles of the road wheels, + left", "°", steer, _DEGREES),
        ("Lateral acceleration, + left", "m/s²", [f"lateral_acceleration_{name}" for name in units], 1.0),
        ("Yaw rate, + left", "°/s", [f"yaw_rate_{name}" for name in units], _DEGREES),
        ("Articulation angle", "°", [f"articulation_{k}" for k in range(1, len(units))], _DEGREES),
        ("Roll", "°", [f"roll_{name}" for name in units if f"roll_{name}" in names], _DEGREES),
        ("Speed", "km/h", [f"v_x_{units[0]}"], 3.6),
    ):
        curves = tuple(Curve(name, _label(name), SERIES[k % len(SERIES)], scale=scale) for k, name in enumerate(shown))
        if curves:
            yield Chart(title, unit, curves, 2)


def _label(name: str) -> str:
    for prefix in ("lateral_acceleration_", "yaw_rate_", "articulation_", "steer_", "roll_", "v_x_"):
        if name.startswith(prefix):
            return name.removeprefix(prefix).replace("_", " ")
    return name


def _readings(vehicle: Vehicle) -> Iterator[Reading]:
    first, last = vehicle.units[0].name, vehicle.units[-1].name
    yield Reading("speed", f"v_x_{first}", "km/h", 3.6, 1)
    yield Reading("front axle steer", f"steer_{first}", "°", _DEGREES, 2)
    yield Reading(f"lateral acceleration, {first}", f"lateral_acceleration_{first}", "m/s²", 1.0, 2)
    yield Reading(f"lateral acceleration, {last}", f"lateral_acceleration_{last}", "m/s²", 1.0, 2)
    yield Reading("articulation", "articulation_1", "°", _DEGREES, 2)
