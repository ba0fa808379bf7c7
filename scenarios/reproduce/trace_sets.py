"""Sets of image sequences that slip estimators are judged on, and their judgement in several processes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from estimators.context import RoverContext, SlipEstimator
from estimators.estimates import SlipAngle
from scenarios.assembly.rover import rover_geometry
from scenarios.catalogue import SLIP_ESTIMATOR, resolve
from scenarios.progress import Progress
from scenarios.randomness import stream
from scenarios.reproduce.figure import Comparison, Reproduction
from scenarios.reproduce.trace_statistics import Judgement, TraceStatistics, judged, statistics
from scenarios.results.log import Log, Signal
from scenarios.studies.pool import as_finished, default_jobs
from sensors.sand.rig import nominal_rig
from sensors.sand.rover_pass import SlipProfile
from sensors.sand.sequence import labelled_sequence
from sensors.sand.trace import TraceTruth
from vehicle.rover.description import load_rover
from vehicle.rover.terrain import Terrain

SOURCE: Final = "Reina et al., ICRA 2008"
PLAIN: Final = ("uniform", "ripples", "pebbles")  # Fig. 2 a to c
HARD: Final = ("shadows", "mast_shadows", "foreign")  # Fig. 2 d to f
SLOPE: Final = math.tan(math.radians(5.0))  # of set B's ground, across the way (Reina 2008, section III)
_BARE: Final = 0.25  # share of the way whose crust takes no imprint: the images without a trace; assumed
_QUICK: Final = 120  # images of a sequence, of which there is one for each kind


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceSet:
    """Sequences that are counted together."""

    name: str
    kinds: Sequence[str]
    seeds: Sequence[int]
    frames: int  # of each sequence
    profile: SlipProfile
    slope: float

    @property
    def size(self) -> int:
        """Images in all."""
        return len(self.kinds) * len(self.seeds) * self.frames

    def shortened(self) -> TraceSet:
        """For a first look."""
        return dataclasses.replace(self, seeds=self.seeds[:1], frames=_QUICK)


class Crossing(NamedTuple):
    """One sequence of one of the sets."""

    trace_set: int  # its number
    kind: str
    seed: int


_SIGNALS: Final = (
    Signal("set", "-", "its number, in the order of the table"),
    Signal("kind", "-", "of sand: 0 uniform, 1 ripples, 2 pebbles, 3 shadows, 4 mast_shadows, 5 foreign"),
    Signal("seed", "-", "of the sequence"),
    Signal("frame", "-", "in the sequence"),
    Signal("present", "-", "1: with a trace, 0: without, nothing: it begins or ends"),
    Signal("detected", "-", "1: a trace was reported"),
    Signal("misplaced", "-", "1: the reported line lies off the rut"),
    Signal("error", "rad", "estimated less true slip angle"),
    Signal("sigmas", "-", "the same over the stated standard deviation"),
    Signal("lagged_error", "rad", "of the later estimate of an earlier moment, less the true slip angle then"),
)
_NOTES: Final = (
    "An image is with a trace if the wheel's own imprint covers 80 % or more of the visible length behind the wheel, "
    "without if 10 % or less; between, it counts for nothing.",
    "False positives in percent of the images without, false negatives and misidentified in percent of those with a "
    "trace. Misidentified: the line is on average more than half a wheel's width off the middle of the rut.",
)

Judged = Mapping[Crossing, Sequence[Judgement]]


def _crossings(sets: Sequence[TraceSet]) -> list[Crossing]:
    """All sequences of the sets, in their order."""
    return [Crossing(k, kind, seed) for k, one in enumerate(sets) for kind in one.kinds for seed in one.seeds]


def _all_judged(sets: Sequence[TraceSet], estimator: str, progress: Progress) -> Judged:
    """What a slip estimator makes of every sequence, in several processes if there are several cores.

    An interrupt ends it early and keeps the sequences that are finished, if there are any.

    Raises:
        KeyboardInterrupt: if none is finished.
        ValueError: one line, if there is no such estimator.
    """
    resolve("slip_estimator", estimator, SLIP_ESTIMATOR)
    wanted = _crossings(sets)
    done, total = 0, sum(one.size for one in sets)
    found: dict[Crossing, list[Judgement]] = {}
    jobs = min(default_jobs(), len(wanted))
    progress(0, total, f"{len(wanted)} sequences, {jobs} at a time")
    work = partial(_judged, tuple(sets), estimator)
    try:
        for one, judgements in as_finished(work, wanted, jobs=jobs):
            found[one] = judgements
            done += len(judgements)
            progress(done, total, f"set {sets[one.trace_set].name}, {one.kind}, seed {one.seed}")
    except KeyboardInterrupt:
        if not found:
            raise
    return {one: found[one] for one in wanted if one in found}


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """What is made of sets, and how it is shown."""

    name: str
    title: str
    note: str  # what the sets are
    estimator: str
    sets: Sequence[TraceSet]
    compared: Callable[[TraceSet, TraceStatistics], list[Comparison]]
    drawn: Callable[[Sequence[tuple[TraceSet, TraceStatistics]]], Figure]

    def made(self, quick: bool, progress: Progress) -> Reproduction:
        """The reproduction; of an interrupted one, of the sequences that are finished."""
        sets = [one.shortened() if quick else one for one in self.sets]
        got = _all_judged(sets, self.estimator, progress)
        results = [(one, _statistics(k, got)) for k, one in enumerate(sets)]
        missing = _unfinished(sets, got)
        return Reproduction(
            name=self.name,
            title=self.title,
            source=SOURCE,
            comparisons=[line for one, numbers in results for line in self.compared(one, numbers)],
            notes=(*_NOTES, self.note, *missing),
            interrupted=bool(missing),
            data=Log(_SIGNALS, np.array([row for one, judgements in got.items() for row in _rows(one, judgements)])),
            draw=lambda: self.drawn(results),
        )


def _unfinished(sets: Sequence[TraceSet], got: Judged) -> tuple[str, ...]:
    """A note if an interrupt has left some out."""
    of = len(_crossings(sets))
    return () if len(got) == of else (f"Interrupted: {len(got)} of {of} sequences are finished, and only they count.",)


def _statistics(number: int, got: Judged) -> TraceStatistics:
    """Rates and errors over one of the sets."""
    return statistics(each for one, judgements in got.items() if one.trace_set == number for each in judgements)


def _rows(one: Crossing, judgements: Sequence[Judgement]) -> Iterator[list[float]]:
    kind = (*PLAIN, *HARD).index(one.kind)
    for k, (present, *numbers) in enumerate(judgements):
        yield [one.trace_set, kind, one.seed, k, math.nan if present is None else present, *numbers]


def _judged(sets: Sequence[TraceSet], estimator: str, one: Crossing) -> list[Judgement]:
    """The estimator on one sequence."""
    of = sets[one.trace_set]
    rover = load_rover("el_dorado_ii")
    rig = nominal_rig(rover)
    context = RoverContext(rover=rover_geometry(rover), rig=rig, rng=stream(one.seed, "slip estimator"), options={})
    tracker: SlipEstimator = resolve("slip_estimator", estimator, SLIP_ESTIMATOR).of(context)
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
    return judged(estimates, truths, rig)
