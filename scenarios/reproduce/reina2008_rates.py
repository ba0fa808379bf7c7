"""Table III of Reina 2008: false positives, false negatives and misidentified traces of FTrace.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. The rates are defined in ``trace_statistics``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.progress import Progress
from scenarios.report.plots import ESTIMATED, GREY, TRUE
from scenarios.reproduce.figure import Comparison, Reproduction, compared
from scenarios.reproduce.trace_sets import HARD, PLAIN, SLOPE, Table, TraceSet
from scenarios.reproduce.trace_statistics import TraceStatistics

_SEEDS: Final = (61, 62, 63, 64)  # not used when FTrace's breakpoints were chosen
_SEEDS_A: Final = (66, 67)  # likewise; fewer but longer sequences, as each begins on a crust that takes no trace
_LENGTH: Final = 288  # images per sequence of set B: 58 s, as long as Fig. 8 from the onset of slip

SETS: Final = (
    TraceSet(name="A", kinds=PLAIN, seeds=_SEEDS_A, frames=260, profile="none", slope=0.0),
    TraceSet(name="B", kinds=PLAIN, seeds=_SEEDS, frames=_LENGTH, profile="slow", slope=SLOPE),
)
DIFFICULT: Final = tuple(
    TraceSet(name=kind, kinds=(kind,), seeds=_SEEDS[:2], frames=_LENGTH, profile="slow", slope=SLOPE) for kind in HARD
)
_FRAMES: Final = {"A": "1560", "B": "3456"}
# False positives, false negatives, misidentified [%].
_PUBLISHED: Final[Mapping[str, tuple[str, str, str]]] = {"A": ("0.0", "1.5", "0.0"), "B": ("0.8", "2.7", "1.7")}
_UNPUBLISHED: Final = ("", "", "")
_NOTE: Final = (
    "Sets A and B have the paper's numbers of images, on sand as in Fig. 2 a to c. A is flat and without slip; B is on "
    "a slope of 5 degrees with slowly varying slip as in Fig. 8. A quarter of the path is a crust without an imprint. "
    "The sets of Fig. 2 d to f are listed too; the paper does not say how its images were distributed."
)


def table3(quick: bool, progress: Progress) -> Reproduction:
    """Rates of FTrace on 5016 images of sets A and B, and on shadows and foreign imprints."""
    table = Table(
        name="reina2008-table3",
        title="Table III: rates of the FTrace system",
        note=_NOTE,
        estimator="ftrace",
        sets=(*SETS, *DIFFICULT),
        compare=_comparisons,
        draw=_draw,
    )
    return table.reproduce(quick, progress)


def _comparisons(one: TraceSet, got: TraceStatistics) -> list[Comparison]:
    rates = (got.false_positives, got.false_negatives, got.misidentified)
    names = ("false positives", "false negatives", "misidentified")
    lines = [compared(f"set {one.name}: frames", _FRAMES.get(one.name, ""), got.frames, "-")]
    lines += [
        compared(f"set {one.name}: {name}", published, rate, "%")
        for name, published, rate in zip(names, _PUBLISHED.get(one.name, _UNPUBLISHED), rates, strict=True)
    ]
    published_rms = "< 2" if one.name in _FRAMES else ""
    slip = compared(f"set {one.name}: slip angle RMS", published_rms, math.degrees(got.rms), "deg")
    return [*lines, slip]


def _draw(results: Sequence[tuple[TraceSet, TraceStatistics]]) -> Figure:
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    for ax, name in zip(figure.subplots(1, 3), ("false_positives", "false_negatives", "misidentified"), strict=True):
        _bars(ax, name, results)
    figure.axes[0].legend(loc="upper left")
    return figure


def _bars(ax: Axes, name: str, results: Sequence[tuple[TraceSet, TraceStatistics]]) -> None:
    """Draw one rate of every set: published and own."""
    column = ("false_positives", "false_negatives", "misidentified").index(name)
    published = [float(_PUBLISHED[one.name][column]) if one.name in _PUBLISHED else math.nan for one, _ in results]
    x = np.arange(len(results))
    ax.bar(x - 0.2, published, 0.38, color=GREY, label="published")
    ax.bar(x + 0.2, [getattr(got, name) for _, got in results], 0.38, color=ESTIMATED, label="own")
    ax.axhline(0.0, color=TRUE, linewidth=0.5)
    ax.set_title(name.replace("_", " ") + " [%]")
    ax.set_xticks(x, [one.name.replace("_", "\n") for one, _ in results])
