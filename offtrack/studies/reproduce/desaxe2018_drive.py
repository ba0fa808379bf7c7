"""Drives of a trailer with one stereo pair: estimates of several odometries, their errors and matches.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018. The estimates do not steer the trailer, so one drive serves all odometries. The four panels are those of
its Figs 6 to 8, section 3.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, takewhile
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimators.calibration.epipolar import RightRotation, straightened
from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import OffTrackingSource
from estimators.odometry.keyframe import KeyframeOdometry
from estimators.odometry.viso2 import Viso2Odometry
from estimators.off_tracking.viso_ot import VisoOt
from offtrack.reports.plots import GREY
from offtrack.studies.reproduce.reproduction import Comparison, Reproduction, compared
from scenarios.assembly.trailer_run import Assembly, assemble
from scenarios.assembly.trailer_sensors import Cameras, Rectified
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.processes import as_finished, default_jobs
from scenarios.progress import Progress, no_progress, part_of
from scenarios.randomness import stream
from scenarios.results import metrics
from scenarios.results.log import Log, Signal
from scenarios.results.trailer_signals import Estimate, ReferenceOffTracking, TrailerTrack, run_log
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse

# Rotation of the right camera in the field tests, as the paper concludes (section 4.4): roll, yaw, pitch.
RIGHT_ROTATION: Final = RightRotation(math.radians(-0.15), math.radians(0.10), 0.0)


class Straightened:
    """Odometry on right images that are corrected by a known rotation (de Saxe 2018, section 4.4)."""

    def __init__(self, calibration: StereoCalibration, odometry: Viso2Odometry, rotation: RightRotation) -> None:
        self._calibration, self._odometry, self._rotation = calibration, odometry, rotation

    def init(self) -> Any:
        """Memory of the odometry before any frame."""
        return self._odometry.init()

    def step(self, memory: Any, frame: StereoFrame) -> tuple[Any, Any]:
        """Step of the odometry with the corrected frame."""
        right = straightened(self._calibration, frame.right, self._rotation.matrix())
        stepped: tuple[Any, Any] = self._odometry.step(memory, dataclasses.replace(frame, right=right))
        return stepped


ODOMETRIES: Final[dict[str, Callable[[StereoCalibration], Any]]] = {
    "viso2": Viso2Odometry,
    "viso2, corrected": lambda c: Straightened(c, Viso2Odometry(c), RIGHT_ROTATION),
    "keyframe": KeyframeOdometry,
    "keyframe, self-calibrated": lambda c: SelfCalibratedOdometry(c, KeyframeOdometry(c)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A drive and the odometries that watch it."""

    scenario: str
    settings: tuple[str, ...] = ()
    odometries: tuple[str, ...] = ("viso2", "keyframe")
    seed: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Estimates of one odometry in a drive: arrays (n,) over its images, NaN where there is no estimate."""

    off_tracking: FloatArray  # [m]
    std: FloatArray  # [m]
    matches: FloatArray
    inliers: FloatArray
    lateral: FloatArray  # motion since the previous image, along y of the trailer [m]


_TRACKED: Final = ("off_tracking_estimate", "off_tracking_std", "matches", "inliers", "odometry_dy")  # of a Track


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """A drive, sampled at its images: arrays (n,)."""

    case: Case
    time: FloatArray  # [s]
    true: FloatArray  # off-tracking, + left [m]
    reference: FloatArray  # off-tracking as measured by a GNSS-aided inertial unit [m]
    lateral: FloatArray  # true motion since the previous image, along y of the trailer [m]
    speed: FloatArray  # of the trailer [m/s]
    tracks: dict[str, Track]
    outcome: str

    def error(self, odometry: str) -> FloatArray:
        """Estimated minus true off-tracking [m]."""
        return self.tracks[odometry].off_tracking - self.true


class ParallelSources:
    """Several estimators on the same frames; the first one is used for control, the estimates of all are kept.

    Not frozen, as it accumulates estimates during a run.
    """

    def __init__(self, sources: Sequence[Any]) -> None:
        self._sources = sources
        self.kept: list[list[Estimate]] = [[] for _ in sources]

    def init(self) -> tuple[Any, ...]:
        """Memories of all estimators before any frame."""
        return tuple(source.init() for source in self._sources)

    def step(self, memory: tuple[Any, ...], frame: StereoFrame) -> tuple[tuple[Any, ...], Any]:
        """Step all estimators; returns the estimate of the first."""
        stepped = [source.step(past, frame) for source, past in zip(self._sources, memory, strict=True)]
        for kept, (_, estimate) in zip(self.kept, stepped, strict=True):
            if estimate is not None:
                kept.append(Estimate(estimate.off_tracking, estimate.motion))
        return tuple(memory for memory, _ in stepped), stepped[0][1]


def drive(case: Case, progress: Progress) -> Drive:
    """Drive a case from start to finish.

    Raises:
        RendererUnavailableError: one line, if OpenGL does not work here.
    """
    progress(0.0, 1.0)  # shown before the cameras are calibrated, which takes a while
    parts = assemble(load_scenario(case.scenario, case.settings), case.seed)
    if parts.cameras is None:
        raise ValueError(f"scenario {case.scenario} has no cameras")
    calibration, last = parts.cameras.calibration, parts.trailers[-1]
    follow, height = last.geometry.follow_distance, last.path_height
    odometries = [ODOMETRIES[name](calibration) for name in case.odometries]
    sources = ParallelSources([VisoOt(calibration, follow, odometry, path_height=height) for odometry in odometries])
    with closing(parts), TrailerSession(with_estimator(parts, parts.cameras, sources)) as session:
        while session.outcome is None:
            session.advance()
            progress(session.progress, 1.0)
    return _result(case, session, sources, parts.cameras)


def with_estimator(parts: Assembly, cameras: Cameras, estimator: OffTrackingSource) -> Assembly:
    """The run with another estimator for the last trailer's cameras."""
    rectified = Rectified(estimator, cameras.rectifier) if cameras.rectifier else estimator
    last = parts.trailers[-1]
    watched = dataclasses.replace(last, sensing=dataclasses.replace(last.sensing, estimator=rectified))
    return dataclasses.replace(parts, trailers=(*parts.trailers[:-1], watched))


def _result(case: Case, session: TrailerSession, sources: ParallelSources, cameras: Cameras) -> Drive:
    parts = session.parts
    rows = list(session.rows)
    truths = [row.truth for row in rows]
    last = parts.trailers[-1]
    unit, follow = last.unit, last.geometry.follow_distance
    bodies = np.array([truth.bodies[unit] for truth in truths])
    tracks: dict[str, Track] = {}
    at = np.array([], dtype=np.intp)
    for odometry, estimates in zip(case.odometries, sources.kept, strict=True):
        track = TrailerTrack(
            name=last.name,
            unit=unit,
            follow_distance=follow,
            path_height=last.path_height,
            steers_ahead=last.steers_ahead,
            n_steered=last.n_steered,
            estimates=estimates,
            X_SC=cameras.calibration.X_SC,
            reference=ReferenceOffTracking(
                unit=unit, follow_distance=follow, path_height=last.path_height, rng=stream(case.seed, "reference unit")
            ),
        )
        log = run_log(rows, [track], parts.vehicle)
        at = at if len(at) else np.flatnonzero(np.isfinite(log["health"]))  # the same images for all odometries
        tracks[odometry] = Track(*(log[signal][at] for signal in _TRACKED))
    return Drive(
        case=case,
        time=np.array([truth.tick * TICK for truth in truths])[at],
        true=log["off_tracking_true"][at],
        reference=log["off_tracking_reference"][at],
        lateral=_lateral(bodies, at),
        speed=np.array([truth.velocities[unit][0] for truth in truths])[at],
        tracks=tracks,
        outcome=session.outcome or "",
    )


def _lateral(bodies: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Motion along the trailer's y since the previous image [m]; NaN at the first."""
    ends = [np.nan] + [float((inverse(bodies[i]) @ bodies[j])[1, 3]) for i, j in pairwise(at.tolist())]
    return np.array(ends)


_DRIVES: dict[Case, Drive] = {}  # cache: figures share drives


def driven(cases: Sequence[Case], progress: Progress) -> list[Drive]:
    """Drive all cases, in several processes if there are several cores.

    After an interrupt only the drives before the first unfinished one are returned.

    Raises:
        KeyboardInterrupt: if the first drive is not finished.
    """
    missing = [case for case in dict.fromkeys(cases) if case not in _DRIVES]
    jobs = min(default_jobs(), len(missing))
    try:
        if jobs > 1:
            _drive_together(missing, progress, jobs)
        else:
            for k, case in enumerate(missing):
                _DRIVES[case] = drive(
                    case, part_of(progress, k, len(missing), f"{case.scenario}, drive {k + 1} of {len(missing)}")
                )
    except KeyboardInterrupt:
        if cases[0] not in _DRIVES:
            raise
    progress(100 * len(missing), 100 * len(missing), "")
    return [_DRIVES[case] for case in takewhile(_DRIVES.__contains__, cases)]


def _drive_together(cases: Sequence[Case], progress: Progress, jobs: int) -> None:
    """Drive all cases in parallel and keep each result as soon as it is finished."""
    progress(0, 100 * len(cases), f"{len(cases)} drives in {jobs} processes")
    for k, (case, result) in enumerate(as_finished(partial(drive, progress=no_progress), cases, jobs=jobs), start=1):
        _DRIVES[case] = result
        progress(100 * k, 100 * len(cases), f"{case.scenario}, {k} of {len(cases)} drives in {jobs} processes")


def reproduced(
    name: str,
    title: str,
    comparisons: Sequence[Comparison],
    notes: Sequence[str],
    data: Log,
    draw: Callable[[], Figure],
    drives: tuple[int, int],
) -> Reproduction:
    """A figure of the paper; ``drives``: number of finished drives, and of all."""
    done, of = drives
    missing = f"Interrupted: {done} of {of} drives are finished; the others are missing here."
    return Reproduction(
        name=name,
        title=title,
        source="de Saxe & Cebon, Vehicle System Dynamics 2018",
        comparisons=comparisons,
        notes=(*notes, *([missing] if done < of else [])),
        interrupted=done < of,
        data=data,
        draw=draw,
    )


ENOUGH: Final = 250.0  # matches below which the paper's errors grow
_ODOMETRIES: Final = ("viso2", "keyframe")
_SHORT: Final = "course.length=40"  # with --quick; the off-tracking is known over 26 m of it

Facing = Literal["rear", "left"]


class Point(NamedTuple):
    """One drive of a figure."""

    facing: Facing = "rear"
    baseline: float = 0.5  # [m]
    slip: float = 14.0  # [deg]
    density: float = 1.0  # of the scenery

    def case(self, *, quick: bool) -> Case:
        """The drive as a case."""
        settings = (
            f"rig.facing={self.facing}",
            f"rig.baseline={self.baseline}",
            f"course.slip_angle_deg={self.slip}",
            f"world.scenery_density={self.density}",
        )
        return Case(scenario="constant-slip", settings=(*settings, _SHORT) if quick else settings)


class Outcome(NamedTuple):
    """Errors and matches of an odometry in a drive."""

    point: Point
    odometry: str
    rms: float  # of the off-tracking's error [m]
    mean: float  # [m]
    largest: float  # [m]
    matches: float  # mean number
    inliers: float  # mean share of the matches [%]


def outcomes(points: Sequence[Point], *, quick: bool, progress: Progress) -> list[Outcome]:
    """Drive all points and evaluate every odometry; fewer outcomes after an interrupt."""
    drives = driven([point.case(quick=quick) for point in points], progress)
    return [outcome_of(point, one, name) for point, one in zip(points, drives, strict=False) for name in _ODOMETRIES]


def outcome_of(point: Point, one: Drive, odometry: str) -> Outcome:
    """Errors and matches of an odometry in a drive."""
    error, track = one.error(odometry), one.tracks[odometry]
    return Outcome(
        point=point,
        odometry=odometry,
        rms=metrics.rms(error),
        mean=metrics.mean(error),
        largest=metrics.peak(error),
        matches=metrics.mean(track.matches),
        inliers=100.0 * metrics.mean(track.inliers / np.maximum(track.matches, 1.0)),
    )


Choice = Callable[[Point], bool]  # of drives
Measure = Callable[[Sequence[Outcome]], float]  # of all outcomes; NaN if no drive is chosen


def values(quantity: str, chosen: Choice, odometry: str = "viso2") -> Callable[[Sequence[Outcome]], list[float]]:
    """Function that gives the magnitudes of a quantity in the chosen drives."""
    return lambda results: [
        abs(getattr(one, quantity)) for one in results if one.odometry == odometry and chosen(one.point)
    ]


def most(quantity: str, chosen: Choice, odometry: str = "viso2") -> Measure:
    """Measure of the largest magnitude of a quantity."""
    found = values(quantity, chosen, odometry)
    return lambda results: max(found(results), default=math.nan)


def least(quantity: str, chosen: Choice) -> Measure:
    """Measure of the smallest magnitude of a quantity of viso2."""
    found = values(quantity, chosen)
    return lambda results: min(found(results), default=math.nan)


def ratio(quantity: str, one: Choice, other: Choice) -> Measure:
    """Measure of the RMS of a quantity of viso2 over drives of one kind, divided by that of another kind."""
    above, below = values(quantity, one), values(quantity, other)

    def measure(results: Sequence[Outcome]) -> float:
        numerator, denominator = np.array(above(results)), np.array(below(results))
        return metrics.rms(numerator) / metrics.rms(denominator) if len(numerator) and np.any(denominator) else math.nan

    return measure


_SIGNALS: Final = (
    Signal("facing", "-", "0 to the rear, 1 to the left"),
    Signal("baseline", "m", "stereo baseline"),
    Signal("slip", "deg", "slip angle of the trailer"),
    Signal("density", "-", "density of the scenery"),
    Signal("odometry", "-", "0 viso2, 1 keyframe"),
    Signal("rms", "m", "RMS error of the off-tracking"),
    Signal("mean", "m", "mean error, + left"),
    Signal("largest", "m", "largest magnitude of the error"),
    Signal("matches", "-", "mean number of matches"),
    Signal("inliers", "%", "mean share of inliers among the matches"),
)


def log_of(results: Sequence[Outcome]) -> Log:
    """Table with one row per drive and odometry."""
    rows = [
        [float(one.point.facing == "left"), *one.point[1:], float(_ODOMETRIES.index(one.odometry)), *one[2:]]
        for one in results
    ]
    return Log(_SIGNALS, np.array(rows, dtype=np.float64).reshape(-1, len(_SIGNALS)))


_PANELS: Final = (
    ("rms", "(a) RMS error [m]"),
    ("mean", "(b) mean error [m]"),
    ("matches", "(c) mean number of matches"),
    ("inliers", "(d) mean share of inliers [%]"),
)


Row = tuple[str, str, Measure, str]  # quantity, number as published, own number, unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """A figure with the paper's four panels: errors and matches over one property of the drives."""

    name: str
    title: str
    points: Sequence[Point]
    quick: Sequence[Point]  # with --quick
    along: str  # property of the points on the horizontal axis
    xlabel: str
    groups: Sequence[tuple[str, Choice, str]]  # lines: label, drives, colour
    rows: Sequence[Row]
    notes: Sequence[str]
    band: tuple[float, float] | None = None  # of RMS errors in the paper [m]
    limit: float | None = None  # value on the horizontal axis that the paper marks

    def __call__(self, quick: bool, progress: Progress) -> Reproduction:
        """Drive all points and compare them; after an interrupt, those that are finished."""
        points = self.quick if quick else self.points
        results = outcomes(points, quick=quick, progress=progress)
        return reproduced(
            self.name,
            self.title,
            [compared(quantity, published, own(results), unit) for quantity, published, own, unit in self.rows],
            self.notes,
            log_of(results),
            lambda: self.drawn(results),
            (len(results) // len(_ODOMETRIES), len(points)),
        )

    def drawn(self, results: Sequence[Outcome]) -> Figure:
        """The four panels; RMS errors and matches from the paper's text are grey."""
        figure = Figure(figsize=(9.6, 6.4), layout="constrained")
        for ax, (quantity, title) in zip(figure.subplots(2, 2).flat, _PANELS, strict=True):
            if quantity == "rms" and self.band:
                ax.axhspan(*self.band, color=GREY, alpha=0.25, linewidth=0.0, label="published")
            if quantity == "matches":
                ax.axhline(ENOUGH, color=GREY, linestyle="--", linewidth=1.0, label="250, published threshold")
            if self.limit is not None:
                ax.axvline(self.limit, color=GREY, linestyle="--", linewidth=1.0)
            for label, chosen, colour in self.groups:
                for odometry, line in zip(_ODOMETRIES, ("-o", ":^"), strict=True):
                    of_odometry = (one for one in results if one.odometry == odometry and chosen(one.point))
                    shown = sorted((getattr(one.point, self.along), getattr(one, quantity)) for one in of_odometry)
                    if shown:
                        style: dict[str, Any] = {"color": colour, "markersize": 3.5, "linewidth": 1.2}
                        ax.plot(*zip(*shown, strict=True), line, label=f"{label}, {odometry}", **style)
            ax.set(title=title, xlabel=self.xlabel)
            if quantity != "mean":
                ax.set_ylim(bottom=0.0)
        figure.axes[0].legend(fontsize=8.0)
        figure.axes[2].legend(handles=figure.axes[2].lines[:1], fontsize=8.0)
        return figure
