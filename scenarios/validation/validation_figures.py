"""The plots of the validation page, each as the text of an SVG element."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from scenarios.report.drawing import ESTIMATED, GREY, INK, TRUE, WIDTH, drawn
from scenarios.validation.check import Plot

_STYLES: Final[dict[str, dict[str, Any]]] = {
    "model": {"linewidth": 1.8, "zorder": 4},
    "model points": {"color": TRUE, "linewidth": 0.0, "marker": "o", "markersize": 5.5, "zorder": 6},
    "reference": {"color": ESTIMATED, "linewidth": 1.3, "linestyle": (0, (4, 3)), "zorder": 5},
    "reference points": {"color": ESTIMATED, "linewidth": 0.0, "marker": "o", "markersize": 3.5, "zorder": 6},
    "faint": {"color": GREY, "linewidth": 0.7, "zorder": 2},
}
_MODELS: Final = (TRUE, "#2a9d8f", "#8e5ea2")  # of several model lines in one plot
_FLAT: Final = 3.1  # height of a plot that is not to scale [in]
_TALLEST: Final = 7.9  # [in]


def svg(plot: Plot, name: str) -> str:
    """The plot drawn; ``name`` keeps the identifiers of several figures on a page apart."""
    with drawn(name, _height(plot)) as (figure, ax):
        ax.set_prop_cycle(color=_MODELS)
        for series in plot.series:
            ax.plot(series.x, series.y, label=series.label or None, **_STYLES[series.style])
        _finish(ax, plot)
    return figure.svg


def _height(plot: Plot) -> float:
    if not plot.to_scale:
        return _FLAT
    x, y = (np.concatenate([series[k] for series in plot.series]) for k in (1, 2))
    return float(min(_TALLEST, max(_FLAT, WIDTH * np.ptp(y) / np.ptp(x) + 1.2)))


def _finish(ax: Axes, plot: Plot) -> None:
    ax.set(xlabel=plot.x_label, ylabel=plot.y_label)
    if plot.logarithmic:
        ax.set(xscale="log", yscale="log")
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(FuncFormatter(_plain))
            axis.set_minor_formatter(FuncFormatter(_plain_if_sparse))
    if plot.to_scale:
        ax.set(aspect="equal")
    handles, _ = ax.get_legend_handles_labels()
    if handles:
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2, labelcolor=INK)


def _plain(value: float, _: int | None) -> str:
    return f"{value:g}"


def _plain_if_sparse(value: float, _: int | None) -> str:
    """Labels of a decade's 2 and 5 only: the others would touch."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""
