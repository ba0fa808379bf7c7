"""Data sheet of a vehicle or a rover: numbers, tables, and a drawing to scale with border and dimensions."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge

from offtrack.reports.plots import INK
from scenarios.results.run_directory import appearing_at_once

DIMENSION, LOAD = "#5b6673", "#b3261e"
WIDTH: Final = 15.0  # of the sheet [in]
MARGIN: Final = 1.0  # left and right of the drawing, for lettering [in]
TITLE, GAP, ROW, FOOT = 0.72, 0.35, 0.175, 0.55  # heights [in]
_BORDER: Final = 0.14  # between the edge of the sheet and its frame [in]
_STYLE: Any = {  # matplotlib's types for it change with its version
    "svg.fonttype": "none",
    "svg.hashsalt": "vehicle",
    "font.size": 9.0,
    "text.parse_math": False,
}

Rows = list[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of a drawing."""

    inches: float  # on paper for a metre of the vehicle [in/m]

    def metres(self, inches: float) -> float:
        """Length [m] on the vehicle that this length on paper [in] stands for."""
        return inches / self.inches


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetTable:
    """A table on the sheet and on the terminal."""

    rows: Rows  # the first is the head
    start: float  # of the table from the sheet's left edge [in]
    columns: tuple[tuple[float, Literal["left", "right"]], ...]  # distance from the start [in] and alignment


def save_sheet(draw: Callable[[], Figure], directory: Path) -> tuple[Path, Path]:
    """Draw a sheet, write it as sheet.svg and sheet.png and return their paths."""
    with matplotlib.rc_context(_STYLE):
        figure = draw()
        paths = directory / "sheet.svg", directory / "sheet.png"
        figure.savefig(paths[0], metadata={"Date": None})
        figure.savefig(paths[1], dpi=110)
    return paths


def height_of(tables: Sequence[SheetTable]) -> float:
    """Height of tables next to each other with the foot of the sheet below them [in]."""
    return ROW * (1.0 + max(len(table.rows) for table in tables)) + FOOT


def new_sheet(height: float, *, name: str, summary: str, key: str, note: str) -> Figure:
    """An empty sheet of a height [in] with border, title, key of the drawing, and a note at the bottom."""
    figure = Figure(figsize=(WIDTH, height))
    inset = (_BORDER / WIDTH, _BORDER / height)
    size = (1.0 - 2.0 * inset[0], 1.0 - 2.0 * inset[1])
    figure.add_artist(Rectangle(inset, *size, transform=figure.transFigure, fill=False, edgecolor=DIMENSION))
    left, right = MARGIN / WIDTH, 1.0 - MARGIN / WIDTH
    figure.text(left, 1.0 - 0.28 / height, name, fontsize=14.0, weight="bold", color=INK, va="top")
    figure.text(left, 1.0 - 0.55 / height, summary, fontsize=10.0, color=DIMENSION, va="top")
    small: Any = {"fontsize": 8.0, "color": DIMENSION}
    figure.text(right, 1.0 - 0.33 / height, key, ha="right", va="top", **small)
    figure.text(left, 0.26 / height, note, ha="left", va="bottom", **small)
    return figure


def scaled_axes(figure: Figure, scale: Scale, *, left: float, low: float, bottom: float, height: float) -> Axes:
    """Axes across the sheet, in metres at its scale.

    Args:
        figure: the sheet.
        scale: scale of the drawing.
        left: distance from the left edge of the sheet to the drawing's origin [in].
        low: coordinate at the bottom of the axes [m].
        bottom: distance from the bottom of the sheet to that of the axes [in].
        height: height of the axes [in].
    """
    total = figure.get_figheight()
    ax = figure.add_axes((0.0, bottom / total, 1.0, height / total))
    start = -scale.metres(left)
    ax.set(xlim=(start, start + scale.metres(WIDTH)), ylim=(low, low + scale.metres(height)))
    ax.set_axis_off()
    return ax


def scale_bar(ax: Axes, scale: Scale, start: float, low: float, step: float, label: str) -> None:
    """A bar of five steps [m] that starts at x = ``start``, just above the height ``low`` [m]."""
    z = low + scale.metres(0.08)
    for k in range(5):
        ends = (start + k * step, start + (k + 1) * step)
        ax.plot(ends, (z, z), color=INK if k % 2 == 0 else "#c3cad1", linewidth=4.0, solid_capstyle="butt")
    ax.text(start + 5.0 * step + scale.metres(0.05), z, label, ha="left", va="center", fontsize=8.0, color=DIMENSION)


def draw_table(figure: Figure, table: SheetTable, top: float) -> None:
    """Rows of text below ``top``, which is measured from the bottom of the sheet [in]."""
    for k, row in enumerate(table.rows):
        for text, (offset, align) in zip(row, table.columns, strict=True):
            figure.text(
                (table.start + offset) / WIDTH,
                (top - ROW * (k + 1)) / figure.get_figheight(),
                text,
                ha=align,
                va="baseline",
                fontsize=8.5,
                color=DIMENSION if k == 0 else INK,
            )


def horizontal_dimension(ax: Axes, scale: Scale, z: float, stations: Sequence[float]) -> None:
    """A chain of dimensions at the height z [m] between stations along x [m]."""
    tick = scale.metres(0.04)
    ax.plot((stations[0], stations[-1]), (z, z), color=DIMENSION, linewidth=0.7)
    for x in stations:
        _tick(ax, x, z, tick)
    for start, stop in pairwise(stations):
        middle, text = 0.5 * (start + stop), f"{stop - start:.2f}"
        ax.text(middle, z + 0.3 * tick, text, ha="center", va="bottom", fontsize=7.5, color=DIMENSION)


def vertical_dimension(ax: Axes, scale: Scale, x: float, low: float, high: float) -> None:
    """A dimension at x [m] between two heights [m]."""
    tick = scale.metres(0.04)
    ax.plot((x, x), (low, high), color=DIMENSION, linewidth=0.7)
    for z in (low, high):
        _tick(ax, x, z, tick)
    middle, text = 0.5 * (low + high), f"{high - low:.2f}"
    ax.text(x + tick, middle, text, ha="left", va="center", rotation=90.0, fontsize=7.5, color=DIMENSION)


def _tick(ax: Axes, x: float, z: float, size: float) -> None:
    """The slanted stroke that ends a dimension."""
    ax.plot((x - size, x + size), (z - size, z + size), color=DIMENSION, linewidth=1.2)


def centre_of_gravity(ax: Axes, x: float, z: float, radius: float) -> None:
    """The quartered disc that marks a centre of gravity, of a radius [m]."""
    ax.add_patch(Circle((x, z), radius, facecolor="white", edgecolor=INK, linewidth=0.8, zorder=4.2))
    for start in (0.0, 180.0):
        ax.add_patch(Wedge((x, z), radius, start, start + 90.0, facecolor=INK, linewidth=0.0, zorder=4.3))


def load_arrow(ax: Axes, x: float, length: float, low: float, text: str) -> None:
    """An arrow of a length [m] on the ground at x, and the load in words at the height ``low`` [m]."""
    if length > 0.0:
        arrow = {"arrowstyle": "-|>", "color": LOAD, "linewidth": 1.6, "shrinkA": 0.0, "shrinkB": 0.0}
        ax.annotate("", (x, 0.0), (x, -length), arrowprops=arrow)
    load_text(ax, x, low, text)


def load_text(ax: Axes, x: float, z: float, text: str, ha: str = "center", va: str = "top") -> None:
    """A load in words, at x and z [m]."""
    ax.text(x, z, text, ha=ha, va=va, fontsize=8.0, color=LOAD)


def wheel_from_side(
    ax: Axes, middle: tuple[float, float], radius: float, tyre: str, rim: float, *, driven: bool
) -> None:
    """A wheel with a tyre of this colour, a rim of a share of its radius, and a hub that is dark if driven."""
    for share, colour in ((1.0, tyre), (rim, "white"), (0.25, INK if driven else "white")):
        ax.add_patch(Circle(middle, share * radius, facecolor=colour, edgecolor=tyre, zorder=4.0 - share))


def wheel_from_above(
    ax: Axes,
    middle: tuple[float, float],
    size: tuple[float, float],
    along: tuple[float, float],
    colour: str,
    *,
    filled: bool = True,
) -> None:
    """A wheel of a diameter and width [m] that points along a unit vector; dashed if it is not filled."""
    x, y = along
    corners = 0.5 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * size
    shape = Polygon(
        corners @ np.array([[x, y], [-y, x]]) + middle,
        facecolor=colour if filled else "none",
        edgecolor=colour,
        linewidth=0.8,
        linestyle="-" if filled else (0, (2, 1.5)),
        zorder=3.5 if filled else 3.0,
    )
    ax.add_patch(shape)


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleSheet:
    """Data sheet of one vehicle or rover."""

    name: str
    summary: str
    size: str  # mass and dimensions in words
    tables: tuple[SheetTable, ...]
    warnings: tuple[str, ...]
    note: str  # on the sources of the numbers
    numbers: dict[str, object]  # ready for JSON
    draw: Callable[[], Figure]


def write_sheet(sheet: VehicleSheet, directory: Path) -> None:
    """Write sheet.svg, sheet.png and facts.json into a new directory."""
    with appearing_at_once(directory) as folder:
        save_sheet(sheet.draw, folder)
        (folder / "facts.json").write_text(json.dumps(sheet.numbers, indent=2) + "\n", encoding="utf-8")


def sources_note(sources: dict[str, str]) -> tuple[str, dict[str, int]]:
    """Number of values that state a source, in words and for JSON."""
    assumed = sum(source.startswith("assumed") for source in sources.values())
    return (
        f"{len(sources)} numbers of the file state their source, {assumed} of them as assumed",
        {"stated": len(sources), "assumed": assumed},
    )
