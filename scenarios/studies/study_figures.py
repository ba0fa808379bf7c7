"""Figures of a study: what each of its points drove, and how a number goes with what was varied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from scenarios.options.scenario import load_scenario
from scenarios.report.drawing import GREY, INK, drawn
from scenarios.results.log import read_log
from scenarios.studies.case import Outcome, Settings
from scenarios.studies.pool import kept_signals
from scenarios.studies.table import Quantity, Row
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

# apart for colour-blind readers, after Okabe and Ito
_COLOURS: Final = ("#e0761a", "#1f5fa8", "#12935f", "#c2459c", "#7a5195", "#b8860b", "#4fa3d1", "#a33b2b", "#5b6673")
_MOST_LINES: Final = len(_COLOURS)
_DECADES: Final = 20.0  # of a quantity in one figure, beyond which its axis is logarithmic


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """One run as a line in a figure."""

    title: str
    hitch: FloatArray  # (n, 2) [m]
    follow_point: FloatArray  # (n, 2) [m]
    way: FloatArray  # (n,) of the hitch [m]
    off_tracking: FloatArray  # (n,) [m], NaN where there is none


def drives_of(outcomes: Sequence[Outcome], cells: Path) -> list[Drive]:
    """The first seed's runs that differ in their first axes alone: one for each law and off-tracking."""
    first = outcomes[0].case
    named = [key for key in ("trailer_steering", "off_tracking") if key in dict(first.axes)]
    alike = [
        outcome
        for outcome in outcomes
        if outcome.case.seed == first.seed
        and [pair for pair in outcome.case.axes if pair[0] not in named]
        == [pair for pair in first.axes if pair[0] not in named]
        and not str(outcome.numbers["outcome"]).startswith("failed")
    ]
    telling = [key for key in named if len({dict(outcome.case.axes)[key] for outcome in alike}) > 1]
    return [_drive(outcome, cells, telling) for outcome in alike[:_MOST_LINES]]


def _drive(outcome: Outcome, cells: Path, telling: Sequence[str]) -> Drive:
    log = read_log(kept_signals(cells, outcome.case))
    scenario = load_scenario(outcome.case.scenario, outcome.case.settings)
    trailer = load_vehicle(scenario.vehicle).units[-1]
    x, y, psi = (log[f"{part}_{trailer.name}"] for part in ("x", "y", "psi"))
    hitch, back = np.column_stack([x, y]), trailer.follow_x or 0.0
    return Drive(
        title=" · ".join(value for key, value in outcome.case.axes if key in telling) or outcome.case.title,
        hitch=hitch,
        follow_point=hitch + back * np.column_stack([np.cos(psi), np.sin(psi)]),
        way=np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(hitch, axis=0).T))]),
        off_tracking=log["off_tracking_true"],
    )


def plan(drives: Sequence[Drive]) -> str:
    """SVG: the way of the hitch, and of the follow point under each law."""
    with drawn("study plan", 4.6) as (drawing, axes):
        axes.plot(*drives[0].hitch.T, color=INK, linewidth=2.4, label="hitch")
        for drive, colour in zip(drives, _COLOURS, strict=False):
            axes.plot(*drive.follow_point.T, color=colour, label=f"follow point, {drive.title}")
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawing.svg


def off_tracking(drives: Sequence[Drive]) -> str:
    """SVG: true off-tracking over the way of the hitch."""
    with drawn("study off-tracking", 3.4) as (drawing, axes):
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        for drive, colour in zip(drives, _COLOURS, strict=False):
            axes.plot(drive.way, drive.off_tracking, color=colour, label=drive.title)
        axes.set_xlabel("way of the hitch [m]")
        axes.set_ylabel("off-tracking [m], + hitch path left")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawing.svg


def numeric_axis(rows: Sequence[Row]) -> str | None:
    """The first axis with several values that are all numbers; None if there is none."""
    for key, _ in rows[0].axes if rows else ():
        values = {dict(row.axes)[key] for row in rows}
        if len(values) > 1 and all(_is_number(value) for value in values):
            return key
    return None


def trend(rows: Sequence[Row], axis: str, quantity: Quantity) -> str:
    """SVG: a quantity over a numeric axis, a line for every point on the others."""
    lines: dict[Settings, list[tuple[float, float]]] = {}
    for row in rows:
        value = row.numbers[quantity.path]
        if value is not None:
            others = tuple(pair for pair in row.axes if pair[0] != axis)
            lines.setdefault(others, []).append((float(dict(row.axes)[axis]), value))
    varied = {key for key, _ in rows[0].axes if len({dict(row.axes)[key] for row in rows}) > 1}
    with drawn(f"study {axis} {quantity.path}", 3.4) as (drawing, axes):
        for k, (others, points) in enumerate(lines.items()):
            label = " · ".join(value for key, value in others if key in varied) or quantity.label
            style = ("-", "--", ":", "-.")[k // _MOST_LINES % 4]
            axes.plot(
                *zip(*sorted(points), strict=True), style, marker="o", color=_COLOURS[k % _MOST_LINES], label=label
            )
        axes.set_xlabel(axis)
        axes.set_ylabel(f"{quantity.meaning} [{quantity.unit}]", fontsize=8.5)
        values = [value for points in lines.values() for _, value in points]
        if min(values) > 0.0 and max(values) > _DECADES * min(values):
            axes.set_yscale("log")  # or the good ones all lie on the axis
        else:
            axes.set_ylim(bottom=0.0)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return drawing.svg


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
