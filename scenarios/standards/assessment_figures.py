"""Figures of the standard manoeuvres."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Final

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.report import plots
from scenarios.report.page import Figure
from scenarios.results.swept_path import placed
from scenarios.standards import random_steer, steady_circle
from scenarios.standards.lane_change import PEAK
from scenarios.standards.manoeuvre import Manoeuvre
from scenarios.standards.motion import articulation, lateral_acceleration, point_path, poses
from scenarios.standards.tilt import threshold
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.polyline import arc_length, rows_every

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
