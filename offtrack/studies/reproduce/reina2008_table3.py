"""Table III of Reina 2008: false positives, false negatives and misidentified traces of FTrace and ``ftrace_plus``.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. The rates are defined in ``trace_statistics``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from offtrack.reports.plots import ESTIMATED, GREY, TRUE
from offtrack.studies.reproduce.reproduction import Comparison, Reproduction, compared
from offtrack.studies.reproduce.trace_sets import HARD, PLAIN, SIGMAS, SLOPE, Table, TraceSet, TraceStatistics
from scenarios.progress import Progress
from sensors.sand.rover_pass import SlipProfile

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
_SLOPES: Final[Mapping[SlipProfile, float]] = {"slow": SLOPE, "fast": 0.0}  # slope of the ground by slip profile [-]
_PLUS: Final = tuple(
    TraceSet(
        name=f"{kind}, {profile}",
        kinds=(kind,),
        seeds=(1, 2, 3, 4, 5),  # the tracker was tuned on seeds from 100 on
        frames=400,  # 80 s, of which the first 20 s are without slip
        profile=profile,
        slope=slope,
    )
    for profile, slope in _SLOPES.items()
    for kind in (*PLAIN, *HARD)
)

_RATES: Final = ("false_positives", "false_negatives", "misidentified")
_FRAMES: Final = {"A": "1560", "B": "3456"}
_PUBLISHED: Final[Mapping[str, tuple[str, str, str]]] = {"A": ("0.0", "1.5", "0.0"), "B": ("0.8", "2.7", "1.7")}  # [%]
_NOTE: Final = (
    "Sets A and B have the paper's numbers of images, on sand as in Fig. 2 a to c. A is flat and without slip; B is on "
    "a slope of 5 degrees with slowly varying slip as in Fig. 8. A quarter of the path is a crust without an imprint. "
    "The sets of Fig. 2 d to f are listed too; the paper does not say how its images were distributed."
)
_NOTE_PLUS: Final = (
    "The paper's Table III is of FTrace on its own images of all kinds of Fig. 2, in unpublished proportions and with "
    "slowly varying slip. Slow: as in Fig. 8, on a slope of 5 degrees. Fast: varies by 1.6 degrees within 5 s. A "
    "quarter of the path is a crust without an imprint. Two seconds late: the tracker's estimate of the slip two "
    "seconds before the newest image."
)


def table3(quick: bool, progress: Progress) -> Reproduction:
    """Rates of FTrace on 5016 images of sets A and B, and on shadows and foreign imprints."""
    table = Table(
        name="reina2008-table3",
        title="Table III: rates of the FTrace system",
        note=_NOTE,
        estimator="ftrace",
        sets=(*SETS, *DIFFICULT),
        compare=_compared,
        draw=_rates,
    )
    return table.reproduce(quick, progress)


def table3_plus(quick: bool, progress: Progress) -> Reproduction:
    """Rates and errors of ``ftrace_plus`` on six kinds of sand, with slip that changes slowly and fast."""
    table = Table(
        name="reina2008-table3-plus",
        title="Table III with ftrace_plus, on all kinds of sand of Fig. 2",
        note=_NOTE_PLUS,
        estimator="ftrace_plus",
        sets=_PLUS,
        compare=_compared_plus,
        draw=_errors,
    )
    return table.reproduce(quick, progress)


def _compared(one: TraceSet, got: TraceStatistics) -> list[Comparison]:
    rows = (
        ("frames", _FRAMES.get(one.name, ""), got.frames, "-"),
        *(
            (name.replace("_", " "), published, getattr(got, name), "%")
            for name, published in zip(_RATES, _PUBLISHED.get(one.name, ("", "", "")), strict=True)
        ),
        ("slip angle RMS", "< 2" if one.name in _FRAMES else "", math.degrees(got.rms), "deg"),
    )
    return [compared(f"set {one.name}: {quantity}", *numbers) for quantity, *numbers in rows]


def _compared_plus(one: TraceSet, got: TraceStatistics) -> list[Comparison]:
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


def _rates(results: Sequence[tuple[TraceSet, TraceStatistics]]) -> Figure:
    """Draw every rate of every set, published and own."""
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    x = np.arange(len(results))
    for column, (ax, name) in enumerate(zip(figure.subplots(1, 3), _RATES, strict=True)):
        published = [float(_PUBLISHED[one.name][column]) if one.name in _PUBLISHED else math.nan for one, _ in results]
        ax.bar(x - 0.2, published, 0.38, color=GREY, label="published")
        ax.bar(x + 0.2, [getattr(got, name) for _, got in results], 0.38, color=ESTIMATED, label="own")
        ax.axhline(0.0, color=TRUE, linewidth=0.5)
        ax.set_title(name.replace("_", " ") + " [%]")
        ax.set_xticks(x, [one.name.replace("_", "\n") for one, _ in results])
    figure.axes[0].legend(loc="upper left")
    return figure


def _errors(results: Sequence[tuple[TraceSet, TraceStatistics]]) -> Figure:
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
