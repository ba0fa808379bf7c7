"""A combination on one sheet: drawn to scale from the side and from above, with its loads, reach and handling."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from scenarios.report.drawing import INK
from scenarios.vehicle_sheet.views import BELOW_GROUND, DIMENSION, Sheet, plan_view, side_view
from vehicle.combination.data_sheet import DataSheet, Handling
from vehicle.combination.description import GRAVITY, Vehicle

_WIDTH: Final = 15.0  # [in] of the sheet
_MARGIN: Final = 1.0  # left and right of the drawing, for lettering [in]
_LARGEST_SCALE: Final = 0.85  # [in/m], so that a short truck does not fill the sheet
_TITLE, _GAP, _ROW, _BORDER = 0.72, 0.35, 0.175, 0.14  # [in]
_KEY: Final = "lengths in m   steered: blue, in the plan at the lock of a left turn   driven: dark hub   lifted: grey"
_STYLE: Any = {"svg.fonttype": "none", "svg.hashsalt": "vehicle", "font.size": 9.0}  # matplotlib's types change
Rows = list[tuple[str, ...]]


def draw_sheet(
    vehicle: Vehicle, facts: DataSheet, handling: Handling | None, directory: Path, *, note: str = ""
) -> tuple[Path, Path]:
    """Draws the sheet into the directory as SVG and as PNG, a ``note`` in its corner, and returns their paths."""
    with matplotlib.rc_context(_STYLE):
        figure = _sheet(vehicle, facts, handling, note)
        paths = directory / "sheet.svg", directory / "sheet.png"
        figure.savefig(paths[0], metadata={"Date": None})
        figure.savefig(paths[1], dpi=110)
    return paths


def _sheet(vehicle: Vehicle, facts: DataSheet, handling: Handling | None, note: str) -> Figure:
    sheet = Sheet(vehicle, facts, min((_WIDTH - 2.0 * _MARGIN) / facts.length, _LARGEST_SCALE))
    side = facts.height * sheet.scale + _GAP + BELOW_GROUND
    plan = facts.width * sheet.scale + 2.0 * _GAP
    tables = _tables(facts, handling)
    text = _ROW * (1.0 + max(len(rows) for _, rows, _ in tables)) + 0.55
    height = _TITLE + side + plan + text
    figure = Figure(figsize=(_WIDTH, height))
    _lettering(figure, facts, note)
    side_view(_scaled(figure, sheet, text + plan, side, -sheet.metres(BELOW_GROUND)), sheet)
    ax = _scaled(figure, sheet, text, plan, -0.5 * sheet.metres(plan))
    plan_view(ax, sheet)
    _scale_bar(ax, sheet, -0.5 * sheet.metres(plan))
    for start, rows, columns in tables:
        _table(figure, height, start, text, rows, columns)
    return figure


def _lettering(figure: Figure, facts: DataSheet, note: str) -> None:
    """Border, title, key and note."""
    height = figure.get_figheight()
    inset = (_BORDER / _WIDTH, _BORDER / height)
    size = (1.0 - 2.0 * inset[0], 1.0 - 2.0 * inset[1])
    figure.add_artist(Rectangle(inset, *size, transform=figure.transFigure, fill=False, edgecolor=DIMENSION))
    left, right = _MARGIN / _WIDTH, 1.0 - _MARGIN / _WIDTH
    figure.text(left, 1.0 - 0.28 / height, facts.name, fontsize=14.0, weight="bold", color=INK, va="top")
    figure.text(left, 1.0 - 0.55 / height, facts.summary, fontsize=10.0, color=DIMENSION, va="top")
    small: Any = {"fontsize": 8.0, "color": DIMENSION}
    figure.text(right, 1.0 - 0.33 / height, _KEY, ha="right", va="top", **small)
    figure.text(left, 0.26 / height, note, ha="left", va="bottom", **small)


def _scaled(figure: Figure, sheet: Sheet, bottom: float, high: float, low: float) -> Axes:
    """Axes across the sheet in metres at its scale; ``bottom`` and ``high`` in inches, ``low`` [m] at the bottom."""
    total = figure.get_figheight()
    ax = figure.add_axes((0.0, bottom / total, 1.0, high / total))
    left = -sheet.metres(0.5 * (_WIDTH - sheet.facts.length * sheet.scale))
    ax.set(xlim=(left, left + sheet.metres(_WIDTH)), ylim=(low, low + sheet.metres(high)))
    ax.set_axis_off()
    return ax


def _scale_bar(ax: Axes, sheet: Sheet, low: float) -> None:
    """Five metres, at the lower left of the plan."""
    z, tick = low + sheet.metres(0.08), sheet.metres(0.05)
    for k in range(5):
        ax.plot((k, k + 1), (z, z), color=INK if k % 2 == 0 else "#c3cad1", linewidth=4.0, solid_capstyle="butt")
    ax.text(5.0 + tick, z, "5 m", ha="left", va="center", fontsize=8.0, color=DIMENSION)


def _table(
    figure: Figure, height: float, start: float, top: float, rows: Rows, columns: Sequence[tuple[float, str]]
) -> None:
    """Rows of text, the first as heads; columns are their distance from the start [in] and their alignment."""
    for k, row in enumerate(rows):
        for text, (offset, align) in zip(row, columns, strict=True):
            figure.text(
                (start + offset) / _WIDTH,
                (top - _ROW * (k + 1)) / height,
                text,
                ha=align,
                va="baseline",
                fontsize=8.5,
                color=DIMENSION if k == 0 else INK,
            )


def _tables(facts: DataSheet, handling: Handling | None) -> list[tuple[float, Rows, list[tuple[float, str]]]]:
    """Where each table starts [in], its rows, and its columns."""
    number = "right"
    return [
        (_MARGIN, axle_rows(facts), [(0.0, "left"), (2.15, number), (2.85, number), (3.05, "left")]),
        (6.6, unit_rows(facts), [(0.0, "left"), (1.9, number), (2.7, number)]),
        (10.3, _handling_rows(facts, handling), [(0.0, "left"), (3.7, number)]),
    ]


def axle_rows(facts: DataSheet) -> Rows:
    """A head and a row for every axle, lifted ones too."""
    rows: Rows = [("axle", "behind front [m]", "load [t]", "")]
    for unit in facts.units:
        for k, axle in enumerate(unit.axles, start=1):
            kinds = [word for word in ("driven", "lifted") if getattr(axle, word)]
            if axle.reach is not None:
                kinds.insert(
                    0, f"steered ±{math.degrees(axle.reach):.1f}°" + (f" ({axle.group})" if axle.group else "")
                )
            load = "–" if axle.lifted else f"{axle.load / GRAVITY / 1e3:.2f}"
            rows.append((f"{unit.name} {k}", f"{axle.behind_front:.2f}", load, ", ".join(kinds)))
    return rows


def unit_rows(facts: DataSheet) -> Rows:
    """A head and a row for every unit, with the load of its front hitch, and for the whole."""
    rows: Rows = [("unit", "mass [t]", "coupling [t]")]
    for unit in facts.units:
        coupling = "" if unit.coupling_load is None else f"{unit.coupling_load / GRAVITY / 1e3:.2f}"
        rows.append((unit.name, f"{unit.mass / 1e3:.2f}", coupling))
    return [*rows, ("combination", f"{facts.mass / 1e3:.2f}", "")]


def _handling_rows(facts: DataSheet, handling: Handling | None) -> Rows:
    return [("steering and handling", ""), *steering_rows(facts), *handling_rows(handling)]


def steering_rows(facts: DataSheet) -> list[tuple[str, str]]:
    """What the steered axles of each unit reach, in words and a value with its unit."""
    rows = []
    for i, unit in enumerate(facts.units):
        if unit.smallest_circle is not None:
            what = "outer front corner at full lock" if i == 0 else f"{unit.name} follows its hitch down to"
            rows.append((what, f"{unit.smallest_circle:.2f} m radius"))
    return rows


def handling_rows(handling: Handling | None) -> list[tuple[str, str]]:
    """The handling in words and a value with its unit; nothing if there is none."""
    if handling is None:
        return []
    gradient = math.degrees(handling.understeer_gradient) * GRAVITY
    at = f"at {handling.speed * 3.6:.0f} km/h"
    amplification = handling.rearward_amplification
    return [
        (f"understeer gradient {at}", f"{gradient:+.2f} °/g"),
        ("characteristic speed", _speed(handling.characteristic_speed, "none, it oversteers")),
        ("critical speed", _speed(handling.critical_speed, "none up to 250 km/h")),
        (f"yaw damping ratio {at}", f"{handling.yaw_damping:.2f}"),
        *([] if amplification is None else [(f"rearward amplification {at}", f"{amplification:.2f}")]),
        ("static rollover threshold", f"{handling.rollover_threshold / GRAVITY:.2f} g"),
    ]


def _speed(speed: float | None, otherwise: str) -> str:
    return otherwise if speed is None else f"{speed * 3.6:.0f} km/h"
