"""One figure of a page in the house's style: axes to draw on, and the text of an SVG element in the end."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

TRUE, ESTIMATED, GREY, INK = "#1f5fa8", "#e0761a", "#8b95a1", "#27313b"  # apart for colour-blind readers too
WIDTH = 9.6  # [in] of every figure; the page scales it
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


class _Drawing:
    """One figure while it is being drawn; its SVG once the block is left."""

    svg = ""


@contextmanager
def drawn(name: str, height: float) -> Iterator[tuple[_Drawing, Axes]]:
    """Axes on a figure ``height`` inches high; ``name`` keeps the identifiers of several figures on a page apart."""
    drawing = _Drawing()
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name}):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        yield drawing, figure.subplots()
        text = io.StringIO()
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
        drawing.svg = text.getvalue()[text.getvalue().index("<svg") :]
