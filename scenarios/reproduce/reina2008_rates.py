"""Table III of Reina 2008: how often FTrace sees a trace that is not there, misses one, or takes another for it.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. What the rates count is said in ``trace_statistics``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.estimates import SlipAngle
from estimators.wheel_trace.ftrace import FTrace
from scenarios.drawing import ESTIMATED, GREY, TRUE
from scenarios.log import Log, Signal
from scenarios.reproduce.figure import Comparison, Progress, Reproduction
from scenarios.reproduce.trace_statistics import Judgement, TraceStatistics, judged, statistics
from sensors.sand.rig import nominal_rig
from sensors.sand.rover_pass import SlipProfile
from sensors.sand.sequence import labelled_sequence
from sensors.sand.trace import TraceTruth
from vehicle.rover.description import load_rover
from vehicle.terrain import Terrain

SOURCE: Final = "Reina et al., ICRA 2008"
_PLAIN: Final = ("uniform", "ripples", "pebbles")  # Fig. 2 a to c
_HARD: Final = ("shadows", "mast_shadows", "foreign")  # Fig. 2 d to f
_BARE: Final = 0.25  # share of the way whose crust takes no imprint: the images without a trace; assumed
_SEEDS: Final = (61, 62, 63, 64)  # none of them was looked at when FTrace's breakpoints were chosen
_SEEDS_A: Final = (66, 67)  # the same; longer sequences, as each begins on a crust that takes no trace
_LENGTH: Final = 288  # images of one sequence of set B: 58 s, as long as Fig. 8 is from its onset of slip
_QUICK: Final = 120  # images of a sequence, of which there is one for each kind
_SLOPE: Final = math.tan(math.radians(5.0))  # of set B's ground, across the way (Reina 2008, section III)


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceSet:
    """Sequences that are counted together."""

    name: str
    kinds: Sequence[str]
    seeds: Sequence[int]
    frames: int  # of each sequence
    profile: SlipProfile
    slope: float
    published: tuple[str, str, str]  # false positives, false negatives, misidentified [%]

    @property
    def size(self) -> int:
        """Images in all."""
        return len(self.kinds) * len(self.seeds) * self.frames


SETS: Final = (
    TraceSet(
        name="A", kinds=_PLAIN, seeds=_SEEDS_A, frames=260, profile="none", slope=0.0, published=("0.0", "1.5", "0.0")
    ),
    TraceSet(
        name="B",
        kinds=_PLAIN,
        seeds=_SEEDS,
        frames=_LENGTH,
        profile="slow",
        slope=_SLOPE,
        published=("0.8", "2.7", "1.7"),
    ),
)
BESIDE: Final = tuple(
    TraceSet(
        name=kind, kinds=(kind,), seeds=_SEEDS[:2], frames=_LENGTH, profile="slow", slope=_SLOPE, published=("", "", "")
    )
    for kind in _HARD
)


def table3(quick: bool, progress: Progress) -> Reproduction:
    """FTrace on 5016 images of sets A and B, and beside them on the light and the imprints that are hard for it."""
    sets = [_shortened(one) if quick else one for one in (*SETS, *BESIDE)]
    total = sum(one.size for one in sets)
    rows: list[list[float]] = []
    results: list[tuple[TraceSet, TraceStatistics]] = []
    done = 0
    for number, one in enumerate(sets):
        judgements: list[Judgement] = []
        for kind, seed in _sequences(one):
            progress(done, total, f"set {one.name}, {kind}, seed {seed}")
            found = _judged(one, kind, seed)
            rows += [[number, (*_PLAIN, *_HARD).index(kind), seed, k, *row] for k, row in enumerate(_rows(found))]
            judgements += found
            done += one.frames
        results.append((one, statistics(judgements)))
    progress(total, total, "")
    return Reproduction(
        name="reina2008-table3",
        title="Table III: rates of the FTrace system",
        source=SOURCE,
        comparisons=[line for one, got in results for line in _comparisons(one, got)],
        notes=_NOTES,
        data=Log(_SIGNALS, np.array(rows)),
        draw=lambda: _drawn(results),
    )


_NOTES: Final = (
    "An image is with a trace if the wheel's own imprint covers 80 % or more of the visible length behind the wheel, "
    "without if 10 % or less; between, it counts for nothing.",
    "False positives in percent of the images without, false negatives and misidentified in percent of those with a "
    "trace. Misidentified: the line is on average more than half a wheel's width off the middle of the rut.",
    "Sets A and B have the paper's numbers of images, over sand of Fig. 2 a to c; A is flat and without slip, B on a "
    "slope of 5 degrees with a slip as slow as in Fig. 8. A quarter of the way is crust that takes no imprint. The "
    "sets of Fig. 2 d to f are beside them; the paper does not say how its images were shared out.",
)
_SIGNALS: Final = (
    Signal("set", "-", "0: A, 1: B, then the sets beside them"),
    Signal("kind", "-", "of sand: 0 uniform, 1 ripples, 2 pebbles, 3 shadows, 4 mast_shadows, 5 foreign"),
    Signal("seed", "-", "of the sequence"),
    Signal("frame", "-", "in the sequence"),
    Signal("present", "-", "1: with a trace, 0: without, nothing: it begins or ends"),
    Signal("detected", "-", "1: a trace was reported"),
    Signal("misplaced", "-", "1: the reported line lies off the rut"),
    Signal("error", "rad", "estimated less true slip angle"),
)


def _rows(judgements: Sequence[Judgement]) -> Iterator[list[float]]:
    for one in judgements:
        yield [math.nan if one.present is None else one.present, one.detected, one.misplaced, one.error]


def _shortened(one: TraceSet) -> TraceSet:
    return dataclasses.replace(one, seeds=one.seeds[:1], frames=_QUICK)


def _sequences(one: TraceSet) -> Iterator[tuple[str, int]]:
    return ((kind, seed) for kind in one.kinds for seed in one.seeds)


def _judged(one: TraceSet, kind: str, seed: int) -> list[Judgement]:
    """FTrace on one sequence."""
    rover = load_rover("el_dorado_ii")
    rig = nominal_rig(rover)
    ftrace = FTrace(rig)
    memory = ftrace.init()
    estimates: list[SlipAngle] = []
    truths: list[TraceTruth] = []
    terrain = Terrain(slope_y=one.slope)
    for view, _, trace in labelled_sequence(
        kind, seed=seed, frames=one.frames, rover=rover, profile=one.profile, bare=_BARE, terrain=terrain
    ):
        memory, estimate = ftrace.step(memory, view)
        estimates.append(estimate)
        truths.append(trace)
    return judged(estimates, truths, rig)


def _comparisons(one: TraceSet, got: TraceStatistics) -> list[Comparison]:
    rates = (got.false_positives, got.false_negatives, got.misidentified)
    names = ("false positives", "false negatives", "misidentified")
    lines = [
        Comparison(quantity=f"set {one.name}: frames", published=_FRAMES.get(one.name, ""), own=got.frames, unit="-")
    ]
    lines += [
        Comparison(quantity=f"set {one.name}: {name}", published=published, own=rate, unit="%")
        for name, published, rate in zip(names, one.published, rates, strict=True)
    ]
    published_rms = "< 2" if one.name in _FRAMES else ""
    slip = Comparison(
        quantity=f"set {one.name}: slip angle RMS", published=published_rms, own=math.degrees(got.rms), unit="deg"
    )
    return [*lines, slip]


_FRAMES: Final = {"A": "1560", "B": "3456"}


def _drawn(results: Sequence[tuple[TraceSet, TraceStatistics]]) -> Figure:
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    for ax, name in zip(figure.subplots(1, 3), ("false_positives", "false_negatives", "misidentified"), strict=True):
        _bars(ax, name, results)
    figure.axes[0].legend(loc="upper left")
    return figure


def _bars(ax: Axes, name: str, results: Sequence[tuple[TraceSet, TraceStatistics]]) -> None:
    """One rate of every set, published beside own."""
    column = ("false_positives", "false_negatives", "misidentified").index(name)
    published = [float(one.published[column]) if one.published[column] else math.nan for one, _ in results]
    x = np.arange(len(results))
    ax.bar(x - 0.2, published, 0.38, color=GREY, label="published")
    ax.bar(x + 0.2, [getattr(got, name) for _, got in results], 0.38, color=ESTIMATED, label="own")
    ax.axhline(0.0, color=TRUE, linewidth=0.5)
    ax.set_title(name.replace("_", " ") + " [%]")
    ax.set_xticks(x, [one.name.replace("_", "\n") for one, _ in results])
