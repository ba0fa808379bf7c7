"""Figures of a page: matplotlib axes in one style, as SVG; charts and plan views of playbacks.

Lettering stays text, so that the page's typeface applies and numbers can be searched and copied. Every legend lies
below its axes, where it hides no curve.
"""

import io
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, Final, cast

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter

from offtrack.reports.page import Figure, Section
from offtrack.reports.player.playback import PALETTE, Chart, Playback, PlayedRun
from scenarios.results.swept_path import placed
from scenarios.results.trailer_result import FrictionPicture
from vehicle.frames import FloatArray, arc_length, rows_every

TRUE, ESTIMATED, GREY, INK = (PALETTE[name] for name in ("true", "estimated", "grey", "ink"))
BAND, LOST_BAND, SWEPT, LIMIT = "#f9e3cf", "#f6d5d2", "#cfe0f1", "#b3261e"
SERIES: Final = (TRUE, ESTIMATED, "#2a9d8f", "#8e5ea2", LIMIT, "#6b7a2a")  # curves of several units or axles
WIDTH = 9.6  # [in] of every figure; the page scales it
FLAT: Final = 2.9  # height of a figure over time [in]
STYLE: Any = {  # matplotlib's types for it change with its version
    "svg.fonttype": "none",
    "font.size": 9.5,
    "axes.edgecolor": "#b8c0c8",
    "axes.facecolor": "none",
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
        canvas = Canvas(figsize=(WIDTH, height), layout="constrained", facecolor="none")
        ax = canvas.subplots()
        yield drawing, ax
        _plain_logarithms(ax)
        legend_below(canvas, ax)
        text, printer = io.StringIO(), cast("Any", FigureCanvasSVG(canvas))
        printer.print_svg(text, metadata={"Date": None})  # ``savefig`` draws everything twice
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


def outlines(ax: Axes, corners: FloatArray) -> None:
    """Outlines of bodies with corners (n, 4, 2)."""
    ax.add_collection(PolyCollection(list(corners), facecolor="none", edgecolor=INK, linewidth=0.9, zorder=3))


_SHADES: Final[dict[str, str]] = {"lost": LOST_BAND, "degraded": "#fbf3d0", "grey": "#d9dde2", "fourth": "#efe6f3"}
_ROAD, _ICE, _STRONGEST = "#eef0f2", (0.49, 0.29, 0.66), 0.45  # colours, and opacity of the most slippery ground
_MOST_FRICTIONS, _MOMENTS = 4, 5  # shades of friction, and moments at which the vehicle is drawn


def chart_figure(chart: Chart, run: PlayedRun) -> Figure:
    """A chart of a playback over time, with the spans of the run behind it."""
    time = run.log["time"]
    with drawn(f"{chart.title} {run.name}") as (drawing, ax):
        for k, span in enumerate(run.spans):
            new = span.label not in (one.label for one in run.spans[:k])
            colour = _SHADES.get(span.colour, LOST_BAND)
            ax.axvspan(span.start, span.end, color=colour, linewidth=0.0, label=span.label if new else None)
        for curve in chart.curves:
            if curve.signal not in run.log:
                continue
            less = run.log[curve.less] if curve.less else 0.0
            value = curve.scale * (run.log[curve.signal] - less)
            known, colour = np.isfinite(value), PALETTE[curve.colour]
            if curve.style == "band":
                base = curve.scale * run.log[curve.base][known] if curve.base else 0.0
                low, high = base - 2.0 * value[known], base + 2.0 * value[known]
                ax.fill_between(time[known], low, high, color=colour, alpha=0.2, linewidth=0.0, label=curve.label)
            elif curve.style == "dots" and known.any():
                ax.plot(time[known], value[known], ".", color=colour, markersize=4.0, label=curve.label)
            elif known.any():
                style: Any = {"linewidth": 1.0, "linestyle": (0, (3, 2))} if curve.style == "dashed" else {}
                ax.plot(time[known], value[known], color=colour, label=curve.label, **style)
        if chart.limit is not None:
            limit_lines(ax, chart.limit, "limit")
        name = re.split(",| of the | per | against | since ", chart.title)[0].lower()
        over_time(ax, time, f"{name} [{chart.unit}]")
    return drawing.content


def chart_figures(playback: Playback, names: Container[str]) -> Iterator[tuple[str, Figure]]:
    """Name and figure of the first run for each chart whose first words ``names`` has."""
    for chart in playback.charts:
        name = chart.title.partition(",")[0]
        if name in names:
            yield name, chart_figure(chart, playback.runs[0])


def chart_sections(playback: Playback, about: Mapping[str, str]) -> Iterator[Section]:
    """A section with its text for each chart that ``about`` names by the first words of its title."""
    for name, figure in chart_figures(playback, about):
        yield Section(name, about[name], [figure])


def plan_figure(playback: Playback, *, bodies: bool = True) -> Figure:
    """The first run from above: road, paths and, with ``bodies``, swept area and the vehicle at some moments."""
    run = playback.runs[0]
    poses = [body.poses(run.log) for body in run.bodies]
    swept = [placed(body.outline, pose) for body, pose in zip(run.bodies, poses, strict=True)]
    trails = [run.trail_points(trail) for trail in run.trails]
    lines = [line.points for line in run.lines]
    points, margin = ([*swept, *trails], 2.0) if bodies else ([*swept, *trails, *lines], 0.3)
    with plan_drawn(f"plan {run.name}", points, margin=margin, tallest=8.2) as (drawing, ax):
        if playback.road is not None:
            band = np.concatenate([playback.road.left, playback.road.right[::-1]])
            ax.add_collection(PolyCollection([band], facecolor=_ROAD, zorder=0.5))
        if bodies:
            shown = rows_every(poses[0][:, :2], 0.15)
            for corners in swept:
                area = Path.make_compound_path_from_polys(corners[shown])
                ax.add_artist(PathPatch(area, facecolor=SWEPT, edgecolor=SWEPT, linewidth=0.4))
            ax.plot([], [], color=SWEPT, linewidth=7, label="swept by the bodies")
        if playback.friction is not None:
            _slippery(ax, playback.friction)
        if bodies and drawing.to_scale:
            along = arc_length(poses[0][:, :2])
            rows = np.minimum(np.searchsorted(along, np.linspace(0.0, along[-1], _MOMENTS)), len(along) - 1)
            for body, corners in zip(run.bodies, swept, strict=True):
                outlines(ax, corners[rows])
                tyres = list(body.wheel_corners(run.log, rows))
                ax.add_collection(PolyCollection(tyres, facecolor=INK, linewidth=0.0, zorder=3))
        for line in run.lines:
            ax.plot(*line.points.T, color=PALETTE[line.colour], linewidth=4.0, alpha=0.5, label=line.label)
        for trail, path in zip(run.trails, trails, strict=True):
            ax.plot(*path.T, color=PALETTE[trail.colour], label=trail.label, zorder=4)
    return drawing.content


def _slippery(ax: Axes, friction: FrictionPicture) -> None:
    """Shades ground that is more slippery than the best: a step of colour for each step of friction."""
    best = float(friction.values.max())
    levels = np.unique(np.round(friction.values, 1))
    edges = np.linspace(float(friction.values.min()), best, min(len(levels), _MOST_FRICTIONS) + 1)
    x, y = (
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in zip(friction.low, friction.high, friction.values.shape[::-1], strict=True)
    )
    steps = len(edges) - 1
    for k, (low, high) in enumerate(pairwise(edges[:-1].tolist())):  # the best stays white, as ground elsewhere
        inside = (friction.values <= high) & ((friction.values > low) | (k == 0))
        colour = (*_ICE, _STRONGEST * (steps - 1 - k) / (steps - 1))
        ax.contourf(x, y, inside.astype(np.float64), levels=[0.5, 1.5], colors=[colour], zorder=0.6)
        mean = float(friction.values[inside].mean()) if inside.any() else low
        ax.add_patch(Rectangle((0.0, 0.0), 0.0, 0.0, facecolor=colour, label=f"friction {mean:.2f}"))


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
