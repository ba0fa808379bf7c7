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

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.context import RoverContext, SlipEstimator
from estimators.estimates import Health, SlipAngle
from offtrack.reports.plots import ESTIMATED, GREY, TRUE
from offtrack.studies.reproduce.reproduction import Comparison, Reproduction, printed, reproduced
from scenarios.assembly.rover_run import rover_geometry
from scenarios.catalogue import SLIP_ESTIMATOR, resolve
from scenarios.options.scenario import stream
from scenarios.processes import as_finished, default_jobs
from scenarios.progress import Progress
from scenarios.results import metrics
from scenarios.results.log import Log, Signal
from sensors.sand.rover_pass import SlipProfile, labelled_sequence
from sensors.sand.trace_rig import TraceRig, nominal_rig
from sensors.sand.world import TraceTruth
from vehicle.frames import wrap
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
    lagged_rms: float  # [rad]
    within: float  # share of the identified within ``SIGMAS`` standard deviations [%]


def compared_with_truth(estimates: Sequence[SlipAngle], truths: Sequence[TraceTruth], rig: TraceRig) -> list[Judgement]:
    """Compare every estimate of a sequence, whose watched wheel is not steered, with the truth at the same image.

    Raises:
        ValueError: if numbers or ticks differ.
    """
    if [estimate.tick for estimate in estimates] != [truth.tick for truth in truths]:
        raise ValueError(f"{len(estimates)} estimates, {len(truths)} truths: ticks must be equal")
    slips = {truth.tick: truth.slip_angle for truth in truths}
    return [_judgement(estimate, truth, rig, slips) for estimate, truth in zip(estimates, truths, strict=True)]


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
        rms=metrics.rms(errors),
        lagged_rms=metrics.rms(np.array([one.lagged_error for one in identified])),
        within=_percent(sum(abs(one.sigmas) <= SIGMAS for one in identified), len(identified)),
    )


def line_distance(slip: float, offset: float, truth: TraceTruth, rig: TraceRig) -> float:
    """Mean lateral distance [m] of a straight line from the middle of the visible rut.

    The line passes ``offset`` [m] to the left of the wheel, and its direction in R is ``slip`` [rad].
    """
    x, y = truth.line[truth.there].T
    line = rig.wheel[1] + offset + math.tan(slip) * (x - rig.wheel[0])
    return float(np.abs(line - y).mean()) if len(x) else math.inf


def _judgement(estimate: SlipAngle, truth: TraceTruth, rig: TraceRig, slips: dict[int, float]) -> Judgement:
    share = truth.share
    present = True if share >= WITH else False if share <= WITHOUT else None
    if estimate.health is Health.LOST:
        return Judgement(present, False, False, math.nan, math.nan, math.nan)
    distance = line_distance(estimate.wheel_slip, estimate.trace_offset, truth, rig)
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


_KINDS: Final = ("uniform", "ripples", "pebbles", "shadows", "mast_shadows", "foreign")  # Fig. 2 a to f
_BARE: Final = 0.25  # share of the path with a crust that takes no imprint: the images without a trace; assumed
_QUICK: Final = 120  # images per sequence with --quick, one sequence per kind
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


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceSet:
    """Sequences that are evaluated together."""

    name: str
    kinds: Sequence[str]
    seeds: Sequence[int]
    frames: int  # of each sequence
    profile: SlipProfile
    slope_deg: float  # of the ground, across the path [deg]


class Crossing(NamedTuple):
    """One sequence of one of the sets."""

    trace_set: int  # number of the set
    kind: str
    seed: int


Evaluated = Mapping[Crossing, Sequence[Judgement]]
Results = Sequence[tuple[TraceSet, TraceStatistics]]


def evaluated(sets: Sequence[TraceSet], estimator: str, progress: Progress) -> Evaluated:
    """Evaluate a slip estimator on every sequence, in several processes if there are several cores.

    After an interrupt only the finished sequences are returned.

    Raises:
        KeyboardInterrupt: if no sequence is finished.
        ValueError: one line, if the estimator is unknown.
    """
    resolve("slip_estimator", estimator, SLIP_ESTIMATOR, in_scenario=False)
    wanted = _crossings(sets)
    done, total = 0, sum(sets[one.trace_set].frames for one in wanted)
    results: dict[Crossing, list[Judgement]] = {}
    jobs = min(default_jobs(), len(wanted))
    progress(0, total, f"{len(wanted)} sequences, {jobs} at a time")
    try:
        for one, judgements in as_finished(partial(_evaluated, tuple(sets), estimator), wanted, jobs=jobs):
            results[one] = judgements
            done += len(judgements)
            progress(done, total, f"set {sets[one.trace_set].name}, {one.kind}, seed {one.seed}")
    except KeyboardInterrupt:
        if not results:
            raise
    return {one: results[one] for one in wanted if one in results}


def _crossings(sets: Sequence[TraceSet]) -> list[Crossing]:
    """All sequences of the sets in order."""
    return [Crossing(k, kind, seed) for k, one in enumerate(sets) for kind in one.kinds for seed in one.seeds]


def _evaluated(sets: Sequence[TraceSet], estimator: str, one: Crossing) -> list[Judgement]:
    """Evaluate the estimator on one sequence."""
    of, rover = sets[one.trace_set], load_rover("el_dorado_ii")
    rig = nominal_rig(rover)
    context = RoverContext(rover=rover_geometry(rover), rig=rig, rng=stream(one.seed, "slip estimator"), options={})
    tracker: SlipEstimator = resolve("slip_estimator", estimator, SLIP_ESTIMATOR, in_scenario=False).of(context)
    terrain = Terrain(slope_y=math.tan(math.radians(of.slope_deg)))
    memory = tracker.init()
    estimates: list[SlipAngle] = []
    truths: list[TraceTruth] = []
    for view, _, trace in labelled_sequence(
        one.kind, seed=one.seed, frames=of.frames, rover=rover, profile=of.profile, bare=_BARE, terrain=terrain
    ):
        memory, estimate = tracker.step(memory, view)
        estimates.append(estimate)
        truths.append(trace)
    return compared_with_truth(estimates, truths, rig)


def _table(name: str, draw: Callable[[Results], Figure], quick: bool, progress: Progress) -> Reproduction:
    """Evaluate the sets; after an interrupt, only the finished sequences."""
    table = printed("reina2008")[name]
    sets = [TraceSet(**one) for one in table["sets"]]
    if quick:
        sets = [dataclasses.replace(one, seeds=one.seeds[:1], frames=_QUICK) for one in sets]
    of_sequence = evaluated(sets, table["estimator"], progress)
    results = [
        (each, statistics(one for key, several in of_sequence.items() if key.trace_set == k for one in several))
        for k, each in enumerate(sets)
    ]
    return reproduced(
        f"reina2008-{name}",
        [
            Comparison(
                f"{table['prefix']}{one.name}: {quantity}",
                paper.get(one.name, paper.get(one.profile, "")),
                _number(got, number),
                unit,
            )
            for one, got in results
            for quantity, number, unit, paper in table["rows"]
        ],
        trace_log(of_sequence),
        lambda: draw(results),
        finished=(len(of_sequence), len(_crossings(sets))),
        parts="sequences",
    )


def trace_log(of_sequence: Evaluated) -> Log:
    """A row for every image."""
    rows = [
        [one.trace_set, _KINDS.index(one.kind), one.seed, k, math.nan if present is None else present, *numbers]
        for one, judgements in of_sequence.items()
        for k, (present, *numbers) in enumerate(judgements)
    ]
    return Log(_SIGNALS, np.array(rows))


def _number(got: TraceStatistics, name: str) -> float:
    value: float = getattr(got, name.removesuffix("_deg"))
    return math.degrees(value) if name.endswith("_deg") else value


def _rates(results: Results) -> Figure:
    """Draw every rate of every set, published and own."""
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    rates = [(name, paper) for _, name, unit, paper in printed("reina2008")["table3"]["rows"] if unit == "%"]
    names = [one.name.replace("_", "\n") for one, _ in results]
    for ax, (name, paper) in zip(figure.subplots(1, 3), rates, strict=True):
        published = [float(paper.get(one.name, "nan")) for one, _ in results]
        own = [_number(got, name) for _, got in results]
        bars(ax, names, {"published": (GREY, published), "own": (ESTIMATED, own)})
        ax.axhline(0.0, color=TRUE, linewidth=0.5)
        ax.set_title(name.replace("_", " ") + " [%]")
    figure.axes[0].legend(loc="upper left")
    return figure


def _errors(results: Results) -> Figure:
    """Draw slip errors for every kind of sand, immediate and two seconds late, and the published ones."""
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    profiles = list(dict.fromkeys(one.profile for one, _ in results))
    for ax, profile in zip(figure.subplots(1, len(profiles), sharey=True), profiles, strict=True):
        shown = [(one, got) for one, got in results if one.profile == profile]
        late = [_number(got, "lagged_rms_deg") for _, got in shown]
        both = {
            "immediate": (ESTIMATED, [_number(got, "rms_deg") for _, got in shown]),
            "two seconds late": (TRUE, late),
        }
        bars(ax, [one.kinds[0].replace("_", "\n") for one, _ in shown], both)
        if profile == "slow":
            ax.axhspan(1.4, 2.0, color=GREY, alpha=0.3, label="published")
        ax.set_title(f"{profile} slip: RMS error [deg]")
    figure.axes[0].legend(loc="upper right")
    return figure


table3: Final = partial(_table, "table3", _rates)
table3_plus: Final = partial(_table, "table3-plus", _errors)


def bars(ax: Axes, names: Sequence[str], pair: Mapping[str, tuple[str, Sequence[float]]]) -> None:
    """Draw two bars at each name; ``pair`` has colour and values by label."""
    x = np.arange(len(names))
    for shift, (label, (colour, values)) in zip((-0.2, 0.2), pair.items(), strict=True):
        ax.bar(x + shift, values, 0.38, color=colour, label=label)
    ax.set_xticks(x, names)
