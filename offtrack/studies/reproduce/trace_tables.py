"""Table III of Reina 2008, also with ``ftrace_plus``: quality of slip estimators on sets of images of wheel traces.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.

Every image belongs to one of three kinds, by its true content. It is *with a trace* if the wheel's own imprint covers
at least ``WITH`` of the visible ground behind the wheel, *without* if at most ``WITHOUT``. Between them a trace begins
or ends; such images are not counted, as there is no single right answer.

- False positive: an image without a trace, but an estimate. In percent of the images without.
- False negative: an image with a trace, but no estimate. In percent of the images with.
- Misidentification: an image with a trace, and an estimate whose mean distance from the middle of the visible rut
  exceeds half a wheel's width, so that most of the line is off the rut. In percent of the images with. (A criterion on
  the angle would reject good lines wherever the trace is curved.)

Errors of the slip angle are relative to the body's slip angle at the time of the image, over the images with an
identified trace.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from estimators.context import RoverContext, SlipEstimator
from estimators.estimates import Health, SlipAngle
from offtrack.reports.plots import ESTIMATED, GREY, TRUE
from offtrack.studies.reproduce.reproduction import Comparison, Reproduction, compared
from scenarios.assembly.rover_run import rover_geometry
from scenarios.catalogue import SLIP_ESTIMATOR, resolve
from scenarios.processes import as_finished, default_jobs
from scenarios.progress import Progress
from scenarios.randomness import stream
from scenarios.results.log import Log, Signal
from sensors.sand.rover_pass import SlipProfile, labelled_sequence
from sensors.sand.trace_rig import TraceRig, nominal_rig
from sensors.sand.world import TraceTruth
from vehicle.frames import FloatArray, wrap
from vehicle.rover.description import load_rover
from vehicle.rover.terrain import Terrain

WITH: Final = 0.8  # smallest share of the visible length of an image with a trace
WITHOUT: Final = 0.1  # largest share of an image without
SIGMAS: Final = 2.5  # bound for 95 % of the errors, in standard deviations (98.8 % of Gaussian errors are within)
_LEAST_STD: Final = 1e-9  # smaller standard deviations mean exact [rad]


class Judgement(NamedTuple):
    """Comparison of one estimate with the truth; errors are NaN where there is nothing to compare."""

    present: bool | None  # True: with a trace; None: it begins or ends
    detected: bool
    misplaced: bool  # True if the line of the estimate is off the trace
    error: float  # of the slip angle [rad]
    sigmas: float  # error over the stated standard deviation [-]
    lagged_error: float  # of the later, better estimate of an earlier slip angle [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceStatistics:
    """Rates in percent and errors of the slip angle; NaN where there is no image to count."""

    frames: int
    without: int  # images without a trace
    present: int  # images with one
    false_positives: float  # of the images without [%]
    false_negatives: float  # of the images with [%]
    misidentified: float  # of the images with [%]
    rms: float  # of the identified [rad]
    bias: float  # mean error of the identified [rad]
    lagged_rms: float  # [rad]
    within: float  # share of the identified within ``SIGMAS`` standard deviations [%]


def compared_with_truth(
    estimates: Sequence[SlipAngle], truths: Sequence[TraceTruth], rig: TraceRig, steer: Sequence[float] | None = None
) -> list[Judgement]:
    """Compare every estimate of a sequence with the truth at the same image.

    ``steer`` is the steer angle of the watched wheel at every image, + left [rad]; None: always straight.

    Raises:
        ValueError: if numbers or ticks differ.
    """
    steer = [0.0] * len(truths) if steer is None else steer
    if [estimate.tick for estimate in estimates] != [truth.tick for truth in truths] or len(steer) != len(truths):
        raise ValueError(f"{len(estimates)} estimates, {len(truths)} truths, {len(steer)} angles: ticks must be equal")
    slips = {truth.tick: truth.slip_angle for truth in truths}
    return [
        _judgement(estimate, truth, angle, rig, slips)
        for estimate, truth, angle in zip(estimates, truths, steer, strict=True)
    ]


def statistics(judgements: Iterable[Judgement]) -> TraceStatistics:
    """Rates and errors over judgements of one or several sequences."""
    table = list(judgements)
    absent = [one for one in table if one.present is False]
    present = [one for one in table if one.present]
    detected = [one for one in present if one.detected]
    identified = [one for one in detected if not one.misplaced]
    errors = np.array([one.error for one in identified])
    return TraceStatistics(
        frames=len(table),
        without=len(absent),
        present=len(present),
        false_positives=_percent(sum(one.detected for one in absent), len(absent)),
        false_negatives=_percent(len(present) - len(detected), len(present)),
        misidentified=_percent(len(detected) - len(identified), len(present)),
        rms=_rms(errors),
        bias=float(errors.mean()) if len(errors) else math.nan,
        lagged_rms=_rms(np.array([one.lagged_error for one in identified])),
        within=_percent(sum(abs(one.sigmas) <= SIGMAS for one in identified), len(identified)),
    )


def line_distance(slip: float, offset: float, truth: TraceTruth, rig: TraceRig) -> float:
    """Mean lateral distance [m] of a straight line from the middle of the visible rut.

    The line passes ``offset`` [m] to the left of the wheel, and its direction in R is ``slip`` [rad].
    """
    x, y = truth.line[truth.there].T
    line = rig.wheel[1] + offset + math.tan(slip) * (x - rig.wheel[0])
    return float(np.abs(line - y).mean()) if len(x) else math.inf


def _judgement(
    estimate: SlipAngle, truth: TraceTruth, steer: float, rig: TraceRig, slips: dict[int, float]
) -> Judgement:
    share = truth.share
    present = True if share >= WITH else False if share <= WITHOUT else None
    if estimate.health is Health.LOST:
        return Judgement(present, False, False, math.nan, math.nan, math.nan)
    distance = line_distance(estimate.wheel_slip + steer, estimate.trace_offset, truth, rig)
    error = wrap(estimate.value - truth.slip_angle)
    earlier = None if estimate.lagged_tick is None else slips.get(estimate.lagged_tick)
    return Judgement(
        present=present,
        detected=True,
        misplaced=distance > 0.5 * rig.wheel_width,
        error=error,
        sigmas=error / max(estimate.std, _LEAST_STD),
        lagged_error=math.nan if earlier is None else wrap(estimate.lagged_value - earlier),
    )


def _percent(count: int, of: int) -> float:
    return 100.0 * count / of if of else math.nan


def _rms(errors: FloatArray) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


SOURCE: Final = "Reina et al., ICRA 2008"
PLAIN: Final = ("uniform", "ripples", "pebbles")  # Fig. 2 a to c
HARD: Final = ("shadows", "mast_shadows", "foreign")  # Fig. 2 d to f
SLOPE: Final = math.tan(math.radians(5.0))  # of set B's ground, across the path (Reina 2008, section III)
_BARE: Final = 0.25  # share of the path with a crust that takes no imprint: the images without a trace; assumed
_QUICK: Final = 120  # images per sequence with --quick, one sequence per kind


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceSet:
    """Sequences that are evaluated together."""

    name: str
    kinds: Sequence[str]
    seeds: Sequence[int]
    frames: int  # of each sequence
    profile: SlipProfile
    slope: float

    @property
    def size(self) -> int:
        """Total number of images."""
        return len(self.kinds) * len(self.seeds) * self.frames

    def shortened(self) -> TraceSet:
        """Shorter set for ``--quick``."""
        return dataclasses.replace(self, seeds=self.seeds[:1], frames=_QUICK)


class Crossing(NamedTuple):
    """One sequence of one of the sets."""

    trace_set: int  # number of the set
    kind: str
    seed: int


_SIGNALS: Final = (
    Signal("set", "-", "number of the set, in the order of the table"),
    Signal("kind", "-", "kind of sand: 0 uniform, 1 ripples, 2 pebbles, 3 shadows, 4 mast_shadows, 5 foreign"),
    Signal("seed", "-", "seed of the sequence"),
    Signal("frame", "-", "number in the sequence"),
    Signal("present", "-", "1: with a trace, 0: without, NaN: it begins or ends"),
    Signal("detected", "-", "1: a trace was reported"),
    Signal("misplaced", "-", "1: the reported line is off the rut"),
    Signal("error", "rad", "estimated minus true slip angle"),
    Signal("sigmas", "-", "error over the stated standard deviation"),
    Signal("lagged_error", "rad", "later estimate of an earlier slip angle, minus the true slip angle at that time"),
)
_NOTES: Final = (
    "An image is with a trace if the wheel's own imprint covers at least 80 % of the visible length behind the wheel, "
    "and without if at most 10 %. Other images are not counted.",
    "False positives are in percent of the images without a trace; false negatives and misidentified traces in percent "
    "of those with one. Misidentified: the mean distance of the line from the middle of the rut exceeds half a "
    "wheel's width.",
)

Evaluated = Mapping[Crossing, Sequence[Judgement]]


def _crossings(sets: Sequence[TraceSet]) -> list[Crossing]:
    """All sequences of the sets in order."""
    return [Crossing(k, kind, seed) for k, one in enumerate(sets) for kind in one.kinds for seed in one.seeds]


def _evaluated_sets(sets: Sequence[TraceSet], estimator: str, progress: Progress) -> Evaluated:
    """Evaluate a slip estimator on every sequence, in several processes if there are several cores.

    After an interrupt only the finished sequences are returned.

    Raises:
        KeyboardInterrupt: if no sequence is finished.
        ValueError: one line, if the estimator is unknown.
    """
    resolve("slip_estimator", estimator, SLIP_ESTIMATOR, in_scenario=False)
    wanted = _crossings(sets)
    done, total = 0, sum(one.size for one in sets)
    results: dict[Crossing, list[Judgement]] = {}
    jobs = min(default_jobs(), len(wanted))
    progress(0, total, f"{len(wanted)} sequences, {jobs} at a time")
    work = partial(_evaluated, tuple(sets), estimator)
    try:
        for one, judgements in as_finished(work, wanted, jobs=jobs):
            results[one] = judgements
            done += len(judgements)
            progress(done, total, f"set {sets[one.trace_set].name}, {one.kind}, seed {one.seed}")
    except KeyboardInterrupt:
        if not results:
            raise
    return {one: results[one] for one in wanted if one in results}


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Definition of a reproduced table: its sets, and functions to compare and draw them."""

    name: str
    title: str
    note: str  # description of the sets
    estimator: str
    sets: Sequence[TraceSet]
    compare: Callable[[TraceSet, TraceStatistics], list[Comparison]]
    draw: Callable[[Sequence[tuple[TraceSet, TraceStatistics]]], Figure]

    def reproduce(self, quick: bool, progress: Progress) -> Reproduction:
        """Evaluate the sets; after an interrupt, only the finished sequences."""
        sets = [one.shortened() if quick else one for one in self.sets]
        results_of = _evaluated_sets(sets, self.estimator, progress)
        results = [(one, _statistics(k, results_of)) for k, one in enumerate(sets)]
        missing = _unfinished(sets, results_of)
        return Reproduction(
            name=self.name,
            title=self.title,
            source=SOURCE,
            comparisons=[line for one, numbers in results for line in self.compare(one, numbers)],
            notes=(*_NOTES, self.note, *missing),
            interrupted=bool(missing),
            data=Log(
                _SIGNALS, np.array([row for one, judgements in results_of.items() for row in _rows(one, judgements)])
            ),
            draw=lambda: self.draw(results),
        )


def _unfinished(sets: Sequence[TraceSet], results_of: Evaluated) -> tuple[str, ...]:
    """Note on missing sequences after an interrupt."""
    of = len(_crossings(sets))
    return (
        ()
        if len(results_of) == of
        else (f"Interrupted: {len(results_of)} of {of} sequences are finished; the others are missing here.",)
    )


def _statistics(number: int, results_of: Evaluated) -> TraceStatistics:
    """Rates and errors of one set."""
    return statistics(each for one, judgements in results_of.items() if one.trace_set == number for each in judgements)


def _rows(one: Crossing, judgements: Sequence[Judgement]) -> Iterator[list[float]]:
    kind = (*PLAIN, *HARD).index(one.kind)
    for k, (present, *numbers) in enumerate(judgements):
        yield [one.trace_set, kind, one.seed, k, math.nan if present is None else present, *numbers]


def _evaluated(sets: Sequence[TraceSet], estimator: str, one: Crossing) -> list[Judgement]:
    """Evaluate the estimator on one sequence."""
    of = sets[one.trace_set]
    rover = load_rover("el_dorado_ii")
    rig = nominal_rig(rover)
    context = RoverContext(rover=rover_geometry(rover), rig=rig, rng=stream(one.seed, "slip estimator"), options={})
    tracker: SlipEstimator = resolve("slip_estimator", estimator, SLIP_ESTIMATOR, in_scenario=False).of(context)
    memory = tracker.init()
    estimates: list[SlipAngle] = []
    truths: list[TraceTruth] = []
    for view, _, trace in labelled_sequence(
        one.kind,
        seed=one.seed,
        frames=of.frames,
        rover=rover,
        profile=of.profile,
        bare=_BARE,
        terrain=Terrain(slope_y=of.slope),
    ):
        memory, estimate = tracker.step(memory, view)
        estimates.append(estimate)
        truths.append(trace)
    return compared_with_truth(estimates, truths, rig)


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
