"""Pictures of the standard manoeuvres, each as the text of an SVG element."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from scenarios.assembly.adapters import outlines
from scenarios.report.drawing import ESTIMATED, GREY, INK, TRUE, WIDTH, drawn
from scenarios.results.swept_path import placed
from scenarios.standards.lane_change import PEAK
from scenarios.standards.manoeuvre import Manoeuvre
from scenarios.standards.motion import lateral_acceleration, point_path, poses
from scenarios.standards.tilt import threshold
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_SWEPT: Final = "#cfe0f1"
_UNITS: Final = ("#1f5fa8", "#e0761a", "#2a9d8f", "#8e5ea2", "#b3261e", "#6b7a2a")  # apart for colour-blind readers
_TALLEST: Final = 7.0  # [in]
_FLAT: Final = 2.9  # height of a picture over time [in]


def pictures(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Iterator[str]:
    """The pictures of a manoeuvre; none of one that ended before anything had moved."""
    if len(manoeuvre.log) < 2:
        return
    if manoeuvre.key in ("turn", "roundabout"):
        yield plan(vehicle, manoeuvre)
    elif manoeuvre.key == "lane_change":
        yield paths(vehicle, manoeuvre, (45.0, 330.0))
        yield accelerations(vehicle, manoeuvre)
    elif manoeuvre.key == "straight":
        yield paths(vehicle, manoeuvre, None)
    elif manoeuvre.key == "pulse":
        yield yaw_rates(vehicle, manoeuvre)
    else:
        yield load_transfers(vehicle, manoeuvre)


def plan(vehicle: Vehicle, manoeuvre: Manoeuvre) -> str:
    """From above: what the bodies sweep, the combination at some moments, and the path it was driven along."""
    moved = [poses(manoeuvre.log, unit.name) for unit in vehicle.units]
    swept = [placed(body.corners, pose) for body, pose in zip(outlines(vehicle), moved, strict=True)]
    everything = np.concatenate([corners.reshape(-1, 2) for corners in swept])
    low, high = everything.min(axis=0) - 2.0, everything.max(axis=0) + 2.0
    height = min(WIDTH * float((high[1] - low[1]) / (high[0] - low[0])) + 0.9, _TALLEST)
    travelled = _travelled(moved[0])
    with drawn(manoeuvre.key, height) as (figure, ax):
        rows = np.searchsorted(travelled, np.arange(0.0, travelled[-1], 0.2))
        moments = np.minimum(np.searchsorted(travelled, np.linspace(0.0, travelled[-1], 6)), len(travelled) - 1)
        for corners in swept:
            ax.add_collection(PolyCollection(list(corners[rows]), facecolor=_SWEPT, edgecolor=_SWEPT, linewidth=0.4))
            ax.add_collection(
                PolyCollection(list(corners[moments]), facecolor="none", edgecolor=INK, linewidth=0.9, zorder=3)
            )
        ax.plot([], [], color=_SWEPT, linewidth=7, label="swept by the bodies")
        if manoeuvre.course is not None:
            ax.plot(*manoeuvre.course.T, color=ESTIMATED, linewidth=1.3, label="path of the guided point", zorder=4)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
        _legend(ax)
    return figure.svg


def paths(vehicle: Vehicle, manoeuvre: Manoeuvre, span: tuple[float, float] | None) -> str:
    """Lateral place of the first and the last axle over the way along the road, stretched."""
    first, last = vehicle.units[0], vehicle.units[-1]
    front = point_path(manoeuvre.log, first.name, first.steered_axles[0].x)
    rear = point_path(manoeuvre.log, last.name, last.axles[-1].x)
    with drawn(f"{manoeuvre.key}-paths", _FLAT) as (figure, ax):
        ax.plot(*front.T, color=TRUE, label="front axle", zorder=4)
        ax.plot(*rear.T, color=ESTIMATED, label=f"last axle ({last.name})", zorder=5)
        if manoeuvre.course is not None:
            ax.plot(*manoeuvre.course.T, color=INK, linewidth=0.9, dashes=(5, 4), label="prescribed", zorder=6)
        ax.set(xlim=span or (0.0, float(front[-1, 0])), xlabel="along the road [m]", ylabel="to the left [m]")
        _legend(ax)
    return figure.svg


def accelerations(vehicle: Vehicle, manoeuvre: Manoeuvre) -> str:
    """Lateral acceleration of the front axle and of every unit's centre of gravity over time."""
    log = manoeuvre.log
    tractor = vehicle.units[0]
    with drawn(f"{manoeuvre.key}-accelerations", _FLAT) as (figure, ax):
        front = lateral_acceleration(log, tractor.name, tractor.steered_axles[0].x)
        ax.plot(log["time"], front, color=INK, linewidth=1.1, label="front axle", zorder=5)
        for unit, colour in zip(vehicle.units[1:], _UNITS[1:], strict=False):
            ax.plot(log["time"], lateral_acceleration(log, unit.name, unit.cg_x), color=colour, label=unit.name)
        for bound in (-PEAK, PEAK):
            ax.axhline(bound, color=GREY, linewidth=0.8, dashes=(6, 3))
        ax.plot([], [], color=GREY, linewidth=0.8, dashes=(6, 3), label="0.15 g")
        _over_time(ax, log["time"][log["time"] <= 10.0], "lateral acceleration [m/s²]")
    return figure.svg


def yaw_rates(vehicle: Vehicle, manoeuvre: Manoeuvre) -> str:
    """Yaw rate of every unit over time."""
    log = manoeuvre.log
    with drawn(manoeuvre.key, _FLAT) as (figure, ax):
        for unit, colour in zip(vehicle.units, _UNITS, strict=False):
            ax.plot(log["time"], np.degrees(log[f"yaw_rate_{unit.name}"]), color=colour, label=unit.name)
        _over_time(ax, log["time"][log["time"] <= 8.0], "yaw rate [°/s]")
    return figure.svg


def load_transfers(vehicle: Vehicle, manoeuvre: Manoeuvre) -> str:
    """Load transfer of every unit over the slope of the tilting table."""
    log = manoeuvre.log
    with drawn(manoeuvre.key, _FLAT) as (figure, ax):
        for unit, colour in zip(vehicle.units, _UNITS, strict=False):
            transfer = np.abs(log[f"load_transfer_{unit.name}"])
            ax.plot(log["slope"], transfer, color=colour, label=unit.name)
            ax.plot([log["slope"][-1], threshold(log, unit.name)], [transfer[-1], 1.0], ":", color=colour)
        ax.axhline(1.0, color=GREY, linewidth=0.8, dashes=(6, 3), label="one side carries nothing")
        ax.set(xlim=(0.0, 1.05 * max(threshold(log, unit.name) for unit in vehicle.units)), ylim=(0.0, 1.08))
        ax.set(xlabel="slope of the table [-], which is the lateral acceleration in g", ylabel="load transfer [-]")
        _legend(ax)
    return figure.svg


def _travelled(pose: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))])


def _over_time(ax: Axes, time: FloatArray, label: str) -> None:
    ax.set(xlim=(0.0, float(time[-1])), xlabel="time [s]", ylabel=label)
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    _legend(ax)


def _legend(ax: Axes) -> None:
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, borderaxespad=0.2, handlelength=1.6)
