"""Figures and playback of an assessment's manoeuvres."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from offtrack.reports import plots
from offtrack.reports.page import Figure
from offtrack.reports.player.playback import SERIES, Chart, Curve, Line, Playback, PlayedRun, Reading, Trail
from offtrack.reports.player.run_playback import unit_body
from offtrack.studies.standards import random_steer, steady_circle
from offtrack.studies.standards.assessment import Assessment, AssessmentMatrix
from offtrack.studies.standards.lane_change import PEAK
from offtrack.studies.standards.proving_ground import Manoeuvre, articulation, lateral_acceleration, point_path, poses
from offtrack.studies.standards.static_rollover import threshold
from scenarios.assembly.adapters import outlines
from scenarios.results.log import Column, Log, Signal
from scenarios.results.swept_path import placed
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.foundation.polyline import arc_length, rows_every

_MOMENTS: Final = 6  # at which the combination is drawn in a plan view
_OF_WHOLE_DRIVES: Final = ("random_steer",)
_CHANGE: Final = (45.0, 330.0)  # of the lane change along the road [m]


def figures(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Iterator[Figure]:
    """The figures of a manoeuvre; none if it ended before anything had moved. ``name`` is unique on the page."""
    if len(manoeuvre.log) >= 2 and (manoeuvre.outcome == "completed" or manoeuvre.key not in _OF_WHOLE_DRIVES):
        yield from (draw(vehicle, manoeuvre, name) for draw in _FIGURES.get(manoeuvre.key, ()))


def _plan(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Swept path from above, the combination at some moments, and the path of the guided point."""
    moved = [poses(manoeuvre.log, unit.name) for unit in vehicle.units]
    swept = [placed(body.corners, pose) for body, pose in zip(outlines(vehicle), moved, strict=True)]
    path = moved[0][:, :2]
    along = arc_length(path)
    with plots.plan_drawn(name, swept, tallest=7.0) as (drawing, ax):
        rows = rows_every(path, 0.2)
        plots.swept_bodies(ax, [corners[rows] for corners in swept])
        moments = np.minimum(np.searchsorted(along, np.linspace(0.0, along[-1], _MOMENTS)), len(along) - 1)
        for corners in swept:
            plots.outlines(ax, corners[moments])
        if manoeuvre.course is not None:
            ax.plot(
                *manoeuvre.course.T, color=plots.ESTIMATED, linewidth=1.3, label="path of the guided point", zorder=4
            )
    return drawing.content


def _paths(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str, span: tuple[float, float] | None = None) -> Figure:
    """Lateral positions of the first and the last axle over the position along the road, stretched."""
    first, last = vehicle.units[0], vehicle.units[-1]
    front = point_path(manoeuvre.log, first.name, first.steered_axles[0].x)
    rear = point_path(manoeuvre.log, last.name, last.axles[-1].x)
    with plots.drawn(f"{name}-paths") as (drawing, ax):
        ax.plot(*front.T, color=plots.TRUE, label="front axle", zorder=4)
        ax.plot(*rear.T, color=plots.ESTIMATED, label=f"last axle ({last.name})", zorder=5)
        if manoeuvre.course is not None:
            ax.plot(
                *manoeuvre.course.T, color=plots.INK, linewidth=0.9, dashes=(5, 4), label="prescribed path", zorder=6
            )
        ax.set(xlim=span or (0.0, float(front[-1, 0])), xlabel="along the road [m]", ylabel="lateral [m], + left")
    return drawing.content


def _accelerations(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Lateral acceleration of the front axle and of every trailer's centre of gravity over time."""
    log, tractor = manoeuvre.log, vehicle.units[0]
    with plots.drawn(f"{name}-accelerations") as (drawing, ax):
        front = lateral_acceleration(log, tractor.name, tractor.steered_axles[0].x)
        ax.plot(log["time"], front, color=plots.INK, linewidth=1.1, label="front axle", zorder=5)
        for unit, colour in zip(vehicle.units[1:], plots.SERIES[1:], strict=False):
            ax.plot(log["time"], lateral_acceleration(log, unit.name, unit.cg_x), color=colour, label=unit.name)
        plots.limit_lines(ax, PEAK, "0.15 g", colour=plots.GREY)
        plots.over_time(ax, log["time"][log["time"] <= 10.0], "lateral acceleration [m/s²]")
    return drawing.content


def _yaw_rates(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Yaw rate of every unit over time."""
    log = manoeuvre.log
    with plots.drawn(name) as (drawing, ax):
        for unit, colour in zip(vehicle.units, plots.SERIES, strict=False):
            ax.plot(log["time"], np.degrees(log[f"yaw_rate_{unit.name}"]), color=colour, label=unit.name)
        plots.over_time(ax, log["time"][log["time"] <= 8.0], "yaw rate [°/s]")
    return drawing.content


def _steer_over_acceleration(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Steer angle over lateral acceleration on the circle."""
    acceleration, steer = steady_circle.steer_over_acceleration(vehicle, manoeuvre.log)
    with plots.drawn(name) as (drawing, ax):
        ax.plot(acceleration / GRAVITY, np.degrees(steer), color=plots.TRUE, label="road-wheel angle")
        ax.set(xlim=(0.0, 0.26), xlabel="lateral acceleration [g], into the turn", ylabel="steer angle [°]")
    return drawing.content


def _dwell(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Steer angle, and yaw rate of every unit over time."""
    log = manoeuvre.log
    with plots.drawn(name) as (drawing, ax):
        steer = np.degrees(log["steer_tractor"])
        ax.plot(log["time"], steer, color=plots.INK, linewidth=0.9, dashes=(5, 4), label="road-wheel angle [°]")
        for unit, colour in zip(vehicle.units, plots.SERIES, strict=False):
            ax.plot(log["time"], np.degrees(log[f"yaw_rate_{unit.name}"]), color=colour, label=unit.name)
        plots.over_time(ax, log["time"], "yaw rate [°/s]")
    return drawing.content


def _frequency_response(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Rearward amplification over frequency, measured and by linear theory."""
    response = random_steer.response_of(vehicle, manoeuvre)
    with plots.drawn(name) as (drawing, ax):
        ax.plot(response.frequency, response.theory, color=plots.GREY, linewidth=2.2, label="linear theory")
        ax.plot(response.frequency, response.measured, ".", color=plots.TRUE, markersize=4, label="measured")
        ax.set(xlim=(0.0, float(response.frequency[-1])), ylim=(0.0, None))
        ax.set(xlabel="frequency [Hz]", ylabel="rearward amplification [-]")
    return drawing.content


def _load_transfers(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Load transfer of every unit over the slope of the tilt table."""
    log, tips = manoeuvre.log, manoeuvre.figures["rollover_threshold_g"]
    end = 1.05 * (tips if vehicle.has_springs else max(threshold(log, unit.name) for unit in vehicle.units))
    with plots.drawn(name) as (drawing, ax):
        for unit, colour in zip(vehicle.units, plots.SERIES, strict=False):
            transfer = np.abs(log[f"load_transfer_{unit.name}"])
            ax.plot(log["slope"], transfer, color=colour, label=unit.name)
            if not vehicle.has_springs:
                ax.plot([log["slope"][-1], threshold(log, unit.name)], [transfer[-1], 1.0], ":", color=colour)
        ax.axhline(1.0, color=plots.GREY, linewidth=0.8, dashes=(6, 3), label="one side carries nothing")
        if vehicle.has_springs:
            ax.axvline(tips, color=plots.GREY, linewidth=0.8, label="it tips")
        ax.set(xlim=(0.0, end), ylim=(0.0, 1.08))
        ax.set(xlabel="slope of the table [-] = lateral acceleration in g", ylabel="load transfer [-]")
    return drawing.content


def _rolls(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Load transfer of every unit over the lateral acceleration of the first one."""
    log = manoeuvre.log
    first = vehicle.units[0]
    a_y = np.abs(log[f"v_x_{first.name}"] * log[f"yaw_rate_{first.name}"]) / GRAVITY
    with plots.drawn(name) as (drawing, ax):
        for unit, colour in zip(vehicle.units, plots.SERIES, strict=False):
            ax.plot(a_y, np.abs(log[f"load_transfer_{unit.name}"]), color=colour, label=unit.name)
        ax.axvline(manoeuvre.figures["curve_rollover_g"], color=plots.GREY, linewidth=0.8, label="it tips")
        ax.set(xlim=(0.0, None), ylim=(0.0, 1.08))
        ax.set(xlabel="lateral acceleration of the tractor [g]", ylabel="load transfer [-]")
    return drawing.content


def _speed(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    """Speed, steer angle and articulations over time."""
    log, names = manoeuvre.log, [unit.name for unit in vehicle.units]
    with plots.drawn(f"{name}-speed") as (drawing, ax):
        ax.plot(log["time"], 3.6 * log[f"v_x_{names[0]}"], color=plots.INK, label="speed [km/h]")
        ax.plot(log["time"], np.degrees(log["steer_tractor"]), color=plots.GREY, label="road-wheel angle [°]")
        for pair, colour in zip(pairwise(names), plots.SERIES, strict=False):
            angle = np.degrees(articulation(log, *pair))
            ax.plot(log["time"], angle, color=colour, label=f"articulation, {pair[1]} [°]")
        plots.over_time(ax, log["time"], "speed [km/h], angles [°]")
    return drawing.content


def _change_paths(vehicle: Vehicle, manoeuvre: Manoeuvre, name: str) -> Figure:
    return _paths(vehicle, manoeuvre, name, _CHANGE)


_Draw = Callable[[Vehicle, Manoeuvre, str], Figure]
_FIGURES: Final[dict[str, tuple[_Draw, ...]]] = {
    **dict.fromkeys(("turn", "roundabout", "aashto_turn", "ctsw_turn"), (_plan,)),
    "lane_change": (_change_paths, _accelerations),
    "straight": (_paths,),
    "pulse": (_yaw_rates,),
    "steady_circle": (_steer_over_acceleration,),
    "sine_with_dwell": (_dwell,),
    "random_steer": (_frequency_response,),
    "tilt": (_load_transfers,),
    "closing_curve": (_rolls,),
    **dict.fromkeys(("braking", "braking_slippery", "longitudinal"), (_speed,)),
    **dict.fromkeys(("braking_split", "braking_in_turn"), (_speed, _plan)),
}


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
