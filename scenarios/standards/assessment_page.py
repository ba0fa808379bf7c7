"""The report of an assessment."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from scenarios.assembly.adapters import outlines
from scenarios.report import plots
from scenarios.report.page import Cell, Column, Figure, Page, Row, Section, Table, outcome_verdict, software_section
from scenarios.results.manifest import versions
from scenarios.results.swept_path import placed
from scenarios.standards.assessment import Assessment
from scenarios.standards.lane_change import PEAK
from scenarios.standards.levels import Judgement
from scenarios.standards.manoeuvre import Manoeuvre
from scenarios.standards.motion import lateral_acceleration, point_path, poses
from scenarios.standards.quantities import BY_NAME
from scenarios.standards.tilt import threshold
from vehicle.combination.description import Vehicle
from vehicle.polyline import arc_length, rows_every

_MOMENTS = 6  # at which the combination is plots.drawn in a plan view
_TOGETHER: Final = "\N{NO-BREAK SPACE}"
_LEVELS: Final = (
    "The level of each standard that the combination reaches. Limits marked “from memory” were not checked against the "
    "text of the standard: look them up before you rely on them."
)


def assessment_page(assessment: Assessment) -> str:
    """The page as HTML."""
    vehicle = assessment.vehicle
    facts = [vehicle.summary, f"{vehicle.mass / 1e3:.1f} t", f"{vehicle.length:.2f} m"]
    if any(unit.steered_axles for unit in vehicle.units[1:]):
        facts.append(f"trailer steering: {assessment.trailer_steering}")
    return Page(
        title=f"{vehicle.name} · assessment",
        heading=f"{vehicle.name} in standard manoeuvres",
        subtitle=" · ".join(facts),
        sections=list(_sections(assessment)),
    ).html()


def bounds_text(judgement: Judgement) -> str:
    """The bounds of a criterion in one line, in the units shown, with levels as L1, L2 and so on."""
    quantity = BY_NAME[judgement.criterion.quantity]
    sign = "≤" if judgement.criterion.at_most else "≥"
    bounds = [f"{level.replace('level ', 'L')} {quantity.text(bound)}".strip() for level, bound in judgement.bounds]
    return f"{sign}{_TOGETHER}" + " · ".join(bound.replace(" ", _TOGETHER) for bound in bounds)


def _sections(assessment: Assessment) -> Iterator[Section]:
    yield Section("Levels", _LEVELS, [_levels(assessment)])
    for manoeuvre in assessment.manoeuvres:
        yield Section(
            manoeuvre.title,
            manoeuvre.how,
            [*_figures(assessment.vehicle, manoeuvre), _measured(assessment, manoeuvre)],
            outcome_verdict(manoeuvre.outcome),
        )
    yield software_section(versions())


def _levels(assessment: Assessment) -> Table:
    columns = [Column("name"), Column("number", "measured"), Column("text", "reached")]
    rows: list[Row] = []
    for judgement in assessment.judgements:
        criterion, quantity = judgement.criterion, BY_NAME[judgement.criterion.quantity]
        bad = judgement.reached in ("none", "missed", "not measured")
        rows.append(
            [
                quantity.label,
                quantity.text(judgement.measured),
                Cell(judgement.reached, "bad" if bad else "good"),
                bounds_text(judgement),
                f"{criterion.standard} ({criterion.source})",
            ]
        )
    return Table([*columns, Column("note", "limits"), Column("note", "standard")], rows)


def _measured(assessment: Assessment, manoeuvre: Manoeuvre) -> Table:
    """A table of the measured quantities, compared with linear theory where there is one."""
    theory = {name: assessment.linear[name] for name in manoeuvre.figures if name in assessment.linear}
    rows: list[Row] = []
    for name, value in manoeuvre.figures.items():
        quantity = BY_NAME[name]
        if math.isfinite(value) or manoeuvre.outcome != "completed":
            linear = [quantity.text(theory[name]) if name in theory else ""] if theory else []
            rows.append([quantity.label, quantity.text(value), *linear, quantity.meaning])
    numbers = [Column("number", "measured"), Column("number", "linear theory")] if theory else [Column("number")]
    return Table([Column("name"), *numbers, Column("note")], rows)


def _figures(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Iterator[Figure]:
    """The figures of a manoeuvre; none if it ended before anything had moved."""
    if len(manoeuvre.log) < 2:
        return
    if manoeuvre.key in ("turn", "roundabout"):
        yield _plan(vehicle, manoeuvre)
    elif manoeuvre.key == "lane_change":
        yield _paths(vehicle, manoeuvre, (45.0, 330.0))
        yield _accelerations(vehicle, manoeuvre)
    elif manoeuvre.key == "straight":
        yield _paths(vehicle, manoeuvre, None)
    elif manoeuvre.key == "pulse":
        yield _yaw_rates(vehicle, manoeuvre)
    else:
        yield _load_transfers(vehicle, manoeuvre)


def _plan(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Figure:
    """Swept path from above, the combination at some moments, and the path of the guided point."""
    moved = [poses(manoeuvre.log, unit.name) for unit in vehicle.units]
    swept = [placed(body.corners, pose) for body, pose in zip(outlines(vehicle), moved, strict=True)]
    path = moved[0][:, :2]
    along = arc_length(path)
    with plots.plan_drawn(manoeuvre.key, swept, tallest=7.0) as (drawing, ax):
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


def _paths(vehicle: Vehicle, manoeuvre: Manoeuvre, span: tuple[float, float] | None) -> Figure:
    """Lateral positions of the first and the last axle over the position along the road, stretched."""
    first, last = vehicle.units[0], vehicle.units[-1]
    front = point_path(manoeuvre.log, first.name, first.steered_axles[0].x)
    rear = point_path(manoeuvre.log, last.name, last.axles[-1].x)
    with plots.drawn(f"{manoeuvre.key}-paths") as (drawing, ax):
        ax.plot(*front.T, color=plots.TRUE, label="front axle", zorder=4)
        ax.plot(*rear.T, color=plots.ESTIMATED, label=f"last axle ({last.name})", zorder=5)
        if manoeuvre.course is not None:
            ax.plot(
                *manoeuvre.course.T, color=plots.INK, linewidth=0.9, dashes=(5, 4), label="prescribed path", zorder=6
            )
        ax.set(xlim=span or (0.0, float(front[-1, 0])), xlabel="along the road [m]", ylabel="lateral [m], + left")
    return drawing.content


def _accelerations(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Figure:
    """Lateral acceleration of the front axle and of every trailer's centre of gravity over time."""
    log, tractor = manoeuvre.log, vehicle.units[0]
    with plots.drawn(f"{manoeuvre.key}-accelerations") as (drawing, ax):
        front = lateral_acceleration(log, tractor.name, tractor.steered_axles[0].x)
        ax.plot(log["time"], front, color=plots.INK, linewidth=1.1, label="front axle", zorder=5)
        for unit, colour in zip(vehicle.units[1:], plots.SERIES[1:], strict=False):
            ax.plot(log["time"], lateral_acceleration(log, unit.name, unit.cg_x), color=colour, label=unit.name)
        plots.limit_lines(ax, PEAK, "0.15 g", colour=plots.GREY)
        plots.over_time(ax, log["time"][log["time"] <= 10.0], "lateral acceleration [m/s²]")
    return drawing.content


def _yaw_rates(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Figure:
    """Yaw rate of every unit over time."""
    log = manoeuvre.log
    with plots.drawn(manoeuvre.key) as (drawing, ax):
        for unit, colour in zip(vehicle.units, plots.SERIES, strict=False):
            ax.plot(log["time"], np.degrees(log[f"yaw_rate_{unit.name}"]), color=colour, label=unit.name)
        plots.over_time(ax, log["time"][log["time"] <= 8.0], "yaw rate [°/s]")
    return drawing.content


def _load_transfers(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Figure:
    """Load transfer of every unit over the slope of the tilt table."""
    log = manoeuvre.log
    with plots.drawn(manoeuvre.key) as (drawing, ax):
        for unit, colour in zip(vehicle.units, plots.SERIES, strict=False):
            transfer = np.abs(log[f"load_transfer_{unit.name}"])
            ax.plot(log["slope"], transfer, color=colour, label=unit.name)
            ax.plot([log["slope"][-1], threshold(log, unit.name)], [transfer[-1], 1.0], ":", color=colour)
        ax.axhline(1.0, color=plots.GREY, linewidth=0.8, dashes=(6, 3), label="one side carries nothing")
        ax.set(xlim=(0.0, 1.05 * max(threshold(log, unit.name) for unit in vehicle.units)), ylim=(0.0, 1.08))
        ax.set(xlabel="slope of the table [-] = lateral acceleration in g", ylabel="load transfer [-]")
    return drawing.content
