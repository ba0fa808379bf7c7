"""Figures of a page: matplotlib axes in one style, as SVG for wide pages and for phones; plan views of playbacks.

Lettering stays text, so that the page's typeface applies and numbers can be searched and copied. Every legend lies
below its axes, where it hides no curve.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, cast

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import AutoLocator, FuncFormatter, MaxNLocator

from offtrack.reports.page import Figure
from offtrack.reports.player.playback import PALETTE, PlayedRun
from scenarios.results.swept_path import placed
from vehicle.frames import arc_length, rows_every

TRUE, ESTIMATED, GREY, INK = (PALETTE[name] for name in ("true", "estimated", "grey", "ink"))
SWEPT, LIMIT = "#cfe0f1", "#b3261e"
SERIES: Final = (TRUE, ESTIMATED, "#2a9d8f", "#8e5ea2", LIMIT, "#6b7a2a")  # curves of several units or axles
WIDTH, NARROW = 9.6, 4.4  # [in] of every figure on a wide page and on a phone; the page scales it
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
_LETTERS: Final = 15.6  # that fit into an inch of a legend


class Drawing:
    """A figure while it is drawn; its content for a page once the block is left."""

    content = Figure("")


@contextmanager
def drawn(
    name: str, height: float = FLAT, *, title: str = "", narrow: float | None = None
) -> Iterator[tuple[Drawing, Axes]]:
    """Axes on a figure ``height`` inches high; ``name`` keeps the identifiers of several figures on a page apart.

    ``narrow`` is its height on a phone, if it is another one.
    """
    drawing = Drawing()
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name, "text.parse_math": False}):
        canvas = Canvas(figsize=(WIDTH, height), layout="constrained", facecolor="none")
        ax = canvas.subplots()
        yield drawing, ax
        _plain_logarithms(ax)
        broad = _svg(canvas, ax, "broad")
        canvas.set_size_inches(NARROW, narrow or height)
        if isinstance(ax.xaxis.get_major_locator(), AutoLocator):
            ax.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))  # more would touch
        with matplotlib.rc_context({"svg.hashsalt": f"{name} narrow"}):
            drawing.content = Figure(broad + _svg(canvas, ax, "narrow"), title)


def _svg(canvas: Canvas, ax: Axes, kind: str) -> str:
    """The figure in its present size as an SVG element of this class."""
    legend_below(canvas, ax)
    text, printer = io.StringIO(), cast("Any", FigureCanvasSVG(canvas))
    printer.print_svg(text, metadata={"Date": None})  # ``savefig`` draws everything twice
    svg = text.getvalue()
    return svg[svg.index("<svg") :].replace("<svg", f'<svg class="{kind}"', 1)


_MARGIN, _TALLEST, _MOMENTS = 2.0, 8.2, 5  # of a plan [m, in], and moments at which the vehicle is drawn


def plan_figure(run: PlayedRun) -> Figure:
    """A run from above with its swept area, paths, and the vehicle at some moments; a slender course is stretched."""
    poses = [body.poses(run.log) for body in run.bodies]
    swept = [placed(body.outline, pose) for body, pose in zip(run.bodies, poses, strict=True)]
    trails = [run.trail_points(trail) for trail in run.trails]
    everything = np.concatenate([part.reshape(-1, 2) for part in (*swept, *trails)])
    low, high = np.nanmin(everything, axis=0) - _MARGIN, np.nanmax(everything, axis=0) + _MARGIN
    shape = float((high - low)[1] / (high - low)[0])
    to_scale = shape >= _SLENDER
    heights = [min(width * shape + 0.9, _TALLEST) if to_scale else FLAT for width in (WIDTH, NARROW)]
    with drawn(f"plan {run.name}", heights[0], narrow=heights[1]) as (drawing, ax):
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]")
        ax.set(aspect="equal" if to_scale else "auto", ylabel="y [m]" if to_scale else "y [m], stretched")
        shown, along = rows_every(poses[0][:, :2], 0.15), arc_length(poses[0][:, :2])
        rows = np.minimum(np.searchsorted(along, np.linspace(0.0, along[-1], _MOMENTS)), len(along) - 1)
        for body, corners in zip(run.bodies, swept, strict=True):
            area = Path.make_compound_path_from_polys(corners[shown])
            ax.add_artist(PathPatch(area, facecolor=SWEPT, edgecolor=SWEPT, linewidth=0.4))
            if to_scale:
                outlines = PolyCollection(list(corners[rows]), facecolor="none", edgecolor=INK, linewidth=0.9, zorder=3)
                ax.add_collection(outlines)
                tyres = list(body.wheel_corners(run.log, rows))
                ax.add_collection(PolyCollection(tyres, facecolor=INK, linewidth=0.0, zorder=3))
        ax.plot([], [], color=SWEPT, linewidth=7, label="swept by the bodies")
        for line in run.lines:
            ax.plot(*line.points.T, color=PALETTE[line.colour], linewidth=4.0, alpha=0.5, label=line.label)
        for trail, path in zip(run.trails, trails, strict=True):
            ax.plot(*path.T, color=PALETTE[trail.colour], label=trail.label, zorder=4)
    return drawing.content


def legend_below(canvas: Canvas, ax: Axes) -> None:
    """Puts the legend of the axes below them, if they have one, in place of a former one."""
    handles, labels = ax.get_legend_handles_labels()
    for legend in canvas.legends[:]:
        legend.remove()
    if labels:
        lengths, room = [len(label) + 8 for label in labels], int(_LETTERS * canvas.get_figwidth())  # with the lines
        columns = len(labels) if sum(lengths) <= room else max(1, room // max(lengths))
        canvas.legend(handles, labels, loc="outside lower center", ncols=columns, handlelength=1.6)


def _plain_logarithms(ax: Axes) -> None:
    """Ticks of logarithmic axes as plain numbers."""
    for axis in (ax.xaxis, ax.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            few = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")  # more would touch
            axis.set_minor_formatter(few)
