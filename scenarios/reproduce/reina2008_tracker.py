"""Rates of ``ftrace_plus`` as in Table III of Reina 2008, on all kinds of sand of Fig. 2.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from scenarios.progress import Progress
from scenarios.report.plots import ESTIMATED, GREY, TRUE
from scenarios.reproduce.figure import Comparison, Reproduction, compared
from scenarios.reproduce.trace_sets import HARD, PLAIN, SLOPE, Table, TraceSet
from scenarios.reproduce.trace_statistics import SIGMAS, TraceStatistics
from sensors.sand.rover_pass import SlipProfile

_SEEDS: Final = (1, 2, 3, 4, 5)  # the tracker was tuned on seeds from 100 on
_LENGTH: Final = 400  # images per sequence: 80 s, of which the first 20 s are without slip
_SLOPES: Final[Mapping[SlipProfile, float]] = {"slow": SLOPE, "fast": 0.0}  # slope of the ground by slip profile [-]
SETS: Final = tuple(
    TraceSet(name=f"{kind}, {profile}", kinds=(kind,), seeds=_SEEDS, frames=_LENGTH, profile=profile, slope=slope)
    for profile, slope in _SLOPES.items()
    for kind in (*PLAIN, *HARD)
)
_NOTE: Final = (
    "The paper's Table III is of FTrace on its own images of all kinds of Fig. 2, in unpublished proportions and with "
    "slowly varying slip. Slow: as in Fig. 8, on a slope of 5 degrees. Fast: varies by 1.6 degrees within 5 s. A "
    "quarter of the path is a crust without an imprint. Two seconds late: the tracker's estimate of the slip two "
    "seconds before the newest image."
)


def table3_plus(quick: bool, progress: Progress) -> Reproduction:
    """Rates and errors of ``ftrace_plus`` on six kinds of sand, with slip that changes slowly and fast."""
    table = Table(
        name="reina2008-table3-plus",
        title="Table III with ftrace_plus, on all kinds of sand of Fig. 2",
        note=_NOTE,
        estimator="ftrace_plus",
        sets=SETS,
        compare=_comparisons,
        draw=_draw,
    )
    return table.reproduce(quick, progress)


def _comparisons(one: TraceSet, got: TraceStatistics) -> list[Comparison]:
    slow = one.profile == "slow"
    rows = (
        ("images without a trace", "", got.without, "-"),
        ("images with a trace", "", got.present, "-"),
        ("false positives", "0.0–0.8" if slow else "", got.false_positives, "%"),
        ("false negatives", "1.5–2.7" if slow else "", got.false_negatives, "%"),
        ("misidentified", "0.0–1.7" if slow else "", got.misidentified, "%"),
        ("slip angle RMS", "1.4–2" if slow else "", math.degrees(got.rms), "deg"),
        ("slip angle RMS, two seconds late", "", math.degrees(got.lagged_rms), "deg"),
        (f"errors within {SIGMAS} standard deviations", "", got.within, "%"),
    )
    return [compared(f"{one.name}: {quantity}", published, own, unit) for quantity, published, own, unit in rows]


def _draw(results: Sequence[tuple[TraceSet, TraceStatistics]]) -> Figure:
    """Draw slip errors for every kind of sand, immediate and two seconds late, and the published ones."""
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    for ax, profile in zip(figure.subplots(1, len(_SLOPES), sharey=True), _SLOPES, strict=True):
        shown = [(one, got) for one, got in results if one.profile == profile]
        x = np.arange(len(shown))
        ax.bar(x - 0.2, [math.degrees(got.rms) for _, got in shown], 0.38, color=ESTIMATED, label="immediate")
        ax.bar(x + 0.2, [math.degrees(got.lagged_rms) for _, got in shown], 0.38, color=TRUE, label="two seconds late")
        if profile == "slow":
            ax.axhspan(1.4, 2.0, color=GREY, alpha=0.3, label="published")
        ax.set_title(f"{profile} slip: RMS error [deg]")
        ax.set_xticks(x, [one.kinds[0].replace("_", "\n") for one, _ in shown])
    figure.axes[0].legend(loc="upper right")
    return figure
