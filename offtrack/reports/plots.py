"""Figures of a page: matplotlib axes in one style, as SVG.

Lettering stays text, so that the page's typeface applies and numbers can be searched and copied. Every legend lies
below its axes, where it hides no curve.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from offtrack.reports.page import Figure
from vehicle.frames import FloatArray

TRUE, ESTIMATED, GREY, INK = "#1f5fa8", "#e0761a", "#8b95a1", "#27313b"  # apart for colour-blind readers too
BAND, LOST_BAND, SWEPT, LIMIT = "#f9e3cf", "#f6d5d2", "#cfe0f1", "#b3261e"
SERIES: Final = (TRUE, ESTIMATED, "#2a9d8f", "#8e5ea2", LIMIT, "#6b7a2a")  # curves of several units or axles
WIDTH = 9.6  # [in] of every figure; the page scales it
FLAT: Final = 2.9  # height of a figure over time [in]
STYLE: Any = {  # matplotlib's types for it change with its version
    "svg.fonttype": "none",
    "font.size": 9.5,
    "axes.edgecolor": "#b8c0c8",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e9ec",
    "grid.linewidth": 0.8,
    "xtick.color": "#5b6673",
    "ytick.color": "#5b6673",
    "lines.linewidth": 1.5,
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "legend.fontsize": 9.0,
}
_SLENDER: Final = 0.15  # height over width of a course; a more slender one would be a thread if drawn to scale
_LETTERS: Final = 150  # that fit into a line of a legend


class Drawing:
    """A figure while it is drawn; its content for a page once the block is left."""

    content = Figure("")
    to_scale = True  # x and y; a plan view may be stretched


@contextmanager
def drawn(name: str, height: float = FLAT, *, title: str = "") -> Iterator[tuple[Drawing, Axes]]:
    """Axes on a figure ``height`` inches high; ``name`` keeps the identifiers of several figures on a page apart."""
    drawing = Drawing()
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name, "text.parse_math": False}):
        canvas = Canvas(figsize=(WIDTH, height), layout="constrained")
        ax = canvas.subplots()
        yield drawing, ax
        _plain_logarithms(ax)
        legend_below(canvas, ax)
        text = io.StringIO()
        canvas.savefig(text, format="svg", transparent=True, metadata={"Date": None})
        svg = text.getvalue()
        drawing.content = Figure(svg[svg.index("<svg") :], title)


@contextmanager
def plan_drawn(
    name: str, points: Sequence[FloatArray], *, margin: float = 2.0, tallest: float = 7.5
) -> Iterator[tuple[Drawing, Axes]]:
    """Axes from above around points (..., 2) with a margin [m], at most ``tallest`` inches high.

    To scale, unless the course is so slender that it has to be stretched.
    """
    everything = np.concatenate([part.reshape(-1, 2) for part in points])
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    width, height = high - low + 2.0 * margin
    shape = float(height / width)
    to_scale = shape >= _SLENDER
    room = np.array([margin, margin if to_scale else max(min(margin, 0.1 * (height - 2.0 * margin)), 1e-3)])
    low, high = low - room, high + room
    with drawn(name, min(WIDTH * shape + 0.9, tallest) if to_scale else FLAT) as (drawing, ax):
        drawing.to_scale = to_scale
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]")
        ax.set(aspect="equal" if to_scale else "auto", ylabel="y [m]" if to_scale else "y [m], stretched")
        yield drawing, ax


def over_time(ax: Axes, time: FloatArray, ylabel: str, *, xlabel: str = "time [s]", zero: bool = True) -> None:
    """Axes over the whole of ``time`` [s], with a line at zero if the value has a sign."""
    ax.set(xlim=(0.0, float(time[-1])), xlabel=xlabel, ylabel=ylabel)
    if zero:
        zero_line(ax)


def zero_line(ax: Axes) -> None:
    """A thin horizontal line at zero."""
    ax.axhline(0.0, color=GREY, linewidth=0.8)


def limit_lines(ax: Axes, limit: float, label: str, *, colour: str = LIMIT) -> None:
    """Dashed horizontal lines at plus and minus ``limit``."""
    for k, value in enumerate((-limit, limit)):
        ax.axhline(value, color=colour, linewidth=0.9, dashes=(6, 3), label=None if k else label)


def error_band(ax: Axes, time: FloatArray, error: FloatArray, std: FloatArray) -> None:
    """An error over time inside the band of twice the standard deviation that the estimator stated."""
    ax.fill_between(time, -2.0 * std, 2.0 * std, color=BAND, linewidth=0.0, label="±2 σ stated by the estimator")
    ax.plot(time, error, ".-", color=ESTIMATED, linewidth=0.9, markersize=4.0, label="error of the estimate")


def shade(ax: Axes, edges: FloatArray, chosen: NDArray[np.bool_], colour: str, label: str) -> None:
    """Shades each run of chosen intervals; interval k (n,) lies between ``edges`` k and k + 1 (n + 1,)."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8))).reshape(-1, 2)
    for k, (first, last) in enumerate(changes):
        ax.axvspan(edges[first], edges[last], color=colour, linewidth=0.0, label=None if k else label)


def swept_bodies(ax: Axes, bodies: Sequence[FloatArray]) -> None:
    """Ground swept by bodies, each with corners (n, 4, 2) over time."""
    for corners in bodies:
        ax.add_collection(PolyCollection(list(corners), facecolor=SWEPT, edgecolor=SWEPT, linewidth=0.4))
    ax.plot([], [], color=SWEPT, linewidth=7, label="swept by the bodies")


def outlines(ax: Axes, corners: FloatArray) -> None:
    """Outlines of bodies with corners (n, 4, 2)."""
    ax.add_collection(PolyCollection(list(corners), facecolor="none", edgecolor=INK, linewidth=0.9, zorder=3))


def legend_below(canvas: Canvas, ax: Axes) -> None:
    """Puts the legend of the axes below them, if they have one."""
    handles, labels = ax.get_legend_handles_labels()
    if labels:
        lengths = [len(label) + 8 for label in labels]  # with the line in front
        columns = len(labels) if sum(lengths) <= _LETTERS else max(1, _LETTERS // max(lengths))
        canvas.legend(handles, labels, loc="outside lower center", ncols=columns, handlelength=1.6)


def _plain_logarithms(ax: Axes) -> None:
    """Ticks of logarithmic axes as plain numbers."""
    for axis in (ax.xaxis, ax.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(FuncFormatter(_two_and_five))


def _two_and_five(value: float, _: int | None) -> str:
    """Labels only the 2 and the 5 of a decade: the others would touch."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""
