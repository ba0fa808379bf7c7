"""Plots of the validation's report."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from scenarios.report.page import Figure
from scenarios.report.plots import ESTIMATED, GREY, TRUE, WIDTH, drawn
from scenarios.validation.check import Plot

_STYLES: Final[dict[str, dict[str, Any]]] = {
    "model": {"linewidth": 1.8, "zorder": 4},
    "model points": {"color": TRUE, "linewidth": 0.0, "marker": "o", "markersize": 5.5, "zorder": 6},
    "reference": {"color": ESTIMATED, "linewidth": 1.3, "linestyle": (0, (4, 3)), "zorder": 5},
    "reference points": {"color": ESTIMATED, "linewidth": 0.0, "marker": "o", "markersize": 3.5, "zorder": 6},
    "faint": {"color": GREY, "linewidth": 0.7, "zorder": 2},
}
_MODELS: Final = (TRUE, "#2a9d8f", "#8e5ea2")  # of several model lines in one plot
_FLAT: Final = 3.2  # height of a plot that is not to scale [in]
_TALLEST: Final = 7.9  # [in]


def figure(plot: Plot, name: str) -> Figure:
    """The plot as a figure; ``name`` keeps the identifiers of several figures on a page apart."""
    with drawn(name, _height(plot), title=plot.title) as (drawing, ax):
        ax.set_prop_cycle(color=_MODELS)
        for series in plot.series:
            ax.plot(series.x, series.y, label=series.label or None, **_STYLES[series.style])
        scale = "log" if plot.logarithmic else "linear"
        ax.set(xlabel=plot.x_label, ylabel=plot.y_label, xscale=scale, yscale=scale)
        if plot.to_scale:
            ax.set(aspect="equal")
    return drawing.content


def _height(plot: Plot) -> float:
    if not plot.to_scale:
        return _FLAT
    x, y = (np.concatenate([series[k] for series in plot.series]) for k in (1, 2))
    return float(min(_TALLEST, max(_FLAT, WIDTH * np.ptp(y) / np.ptp(x) + 1.2)))
