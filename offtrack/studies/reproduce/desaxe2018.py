"""Drives with a stereo pair on the trailer, and Figs 6 to 9 of de Saxe 2018: sensitivities of the error, and drift.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 3 (3.2.4 for Fig. 9): the trailer moves 100 m straight ahead at 5 m/s and a constant slip angle.
The estimates do not steer the trailer, so one drive serves all odometries.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product, takewhile
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
from offtrack.reports.plots import ESTIMATED, GREY, TRUE
from offtrack.studies.reproduce.reproduction import Comparison, Reproduction, printed, reproduced
from scenarios.assembly.trailer_run import Assembly, assemble
from scenarios.assembly.trailer_sensors import Cameras, Rectified
from scenarios.loop.trailer_session import TrailerSession, track_of
from scenarios.options.scenario import load_scenario
from scenarios.processes import as_finished, default_jobs
from scenarios.progress import Progress, no_progress, part_of
from scenarios.results import metrics
from scenarios.results.log import Log, Signal
from scenarios.results.trailer_signals import Estimate, run_log
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
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
    return _result(case, session, sources)


def with_estimator(parts: Assembly, cameras: Cameras, estimator: OffTrackingSource) -> Assembly:
    """The run with another estimator for the last trailer's cameras."""
    rectified = Rectified(estimator, cameras.rectifier) if cameras.rectifier else estimator
    last = parts.trailers[-1]
    watched = dataclasses.replace(last, sensing=dataclasses.replace(last.sensing, estimator=rectified))
    return dataclasses.replace(parts, trailers=(*parts.trailers[:-1], watched))


def _result(case: Case, session: TrailerSession, sources: ParallelSources) -> Drive:
    rows, unit = list(session.rows), session.parts.trailers[-1].unit
    bodies = np.array([row.truth.bodies[unit] for row in rows])
    logs = []
    for estimates in sources.kept:
        track = track_of(session, session.trailers[-1], with_unit=True)
        logs.append(run_log(rows, [dataclasses.replace(track, estimates=estimates)], session.parts.vehicle))
    log, at = logs[0], np.flatnonzero(np.isfinite(logs[0]["health"]))  # the same images for all odometries
    return Drive(
        case=case,
        time=log["time"][at],
        true=log["off_tracking_true"][at],
        reference=log["off_tracking_reference"][at],
        lateral=_lateral(bodies, at),
        speed=np.array([row.truth.velocities[unit][0] for row in rows])[at],
        tracks={
            name: Track(*(log[signal][at] for signal in _TRACKED))
            for name, log in zip(case.odometries, logs, strict=True)
        },
    )


def _lateral(bodies: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Motion along the trailer's y since the previous image [m]; NaN at the first."""
    return np.array([np.nan] + [float((inverse(bodies[i]) @ bodies[j])[1, 3]) for i, j in pairwise(at.tolist())])


_DRIVES: dict[Case, Drive] = {}  # cache: figures share drives


def driven(cases: Sequence[Case], progress: Progress) -> list[Drive]:
    """Drive all cases, in several processes if there are several cores; each result is kept as soon as it is there.

    After an interrupt only the drives before the first unfinished one are returned.

    Raises:
        KeyboardInterrupt: if the first drive is not finished.
    """
    missing = [case for case in dict.fromkeys(cases) if case not in _DRIVES]
    jobs = min(default_jobs(), len(missing))
    progress(0, 100 * len(missing), f"{len(missing)} drives, {jobs} at a time")

    def of_one(done: float, of: float, note: str = "") -> None:
        part_of(progress, sum(case in _DRIVES for case in missing), len(missing), "driving")(done, of)

    work = partial(drive, progress=no_progress if jobs > 1 else of_one)
    try:
        for k, (case, result) in enumerate(as_finished(work, missing, jobs=jobs), start=1):
            _DRIVES[case] = result
            progress(100 * k, 100 * len(missing), f"{case.scenario}, {k} of {len(missing)} drives")
    except KeyboardInterrupt:
        if cases[0] not in _DRIVES:
            raise
    progress(100 * len(missing), 100 * len(missing), "")
    return [_DRIVES[case] for case in takewhile(_DRIVES.__contains__, cases)]


ENOUGH: Final = 250.0  # matches below which the paper's errors grow
THIRD: Final = "#5b8c3a"
_COLOURS: Final = {"true": TRUE, "estimated": ESTIMATED, "third": THIRD}
_ODOMETRIES: Final = {"viso2": "-o", "keyframe": ":^"}  # with their lines
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

    @classmethod
    def of(cls, point: Point, one: Drive, odometry: str) -> "Outcome":
        """Errors and matches of an odometry in a drive."""
        error, track = one.error(odometry), one.tracks[odometry]
        inliers = 100.0 * metrics.mean(track.inliers / np.maximum(track.matches, 1.0))
        numbers = metrics.rms(error), metrics.mean(error), metrics.peak(error), metrics.mean(track.matches)
        return cls(point, odometry, *numbers, inliers)

    def lies_in(self, where: Mapping[str, Any]) -> bool:
        """True if the drive has these properties: values, or ranges of two numbers."""
        for key, wanted in where.items():
            value = getattr(self.point, key)
            if not (wanted[0] <= value <= wanted[1] if isinstance(wanted, list) else value == wanted):
                return False
        return True


def measured(name: str, where: Mapping[str, Any], results: Sequence[Outcome]) -> float:
    """A number such as "largest rms" over the drives with these properties: see ``desaxe2018.toml``; NaN: no drive."""
    (measure, quantity), where = name.split(), dict(where)
    odometry, over = where.pop("odometry", "viso2"), where.pop("over", None)
    chosen = [one for one in results if one.odometry == odometry and one.lies_in(where)]
    values = [abs(getattr(one, quantity)) for one in chosen]
    if measure == "first":
        few = (one.point.baseline for one, value in zip(chosen, values, strict=True) if value < ENOUGH)
        return min(few, default=math.nan)
    if measure == "ratio":
        below = [abs(getattr(one, quantity)) for one in results if one.odometry == odometry and one.lies_in(over)]
        return metrics.rms(np.array(values)) / metrics.rms(np.array(below)) if values and any(below) else math.nan
    if measure == "mean":
        return sum(values) / len(values) if values else math.nan
    return (max if measure == "largest" else min)(values, default=math.nan)


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


def _sensitivity(figure: str, quick: bool, progress: Progress) -> Reproduction:
    """A figure with the paper's four panels: errors and matches over one property of the drives."""
    table = printed("desaxe2018")[figure]
    grid = table["quick" if quick else "points"]
    points = [Point(**dict(zip(grid, values, strict=True))) for values in product(*grid.values())]
    drives = driven([point.case(quick=quick) for point in points], progress)
    results = [Outcome.of(*each, name) for each in zip(points, drives, strict=False) for name in _ODOMETRIES]
    rows = [
        [float(one.point.facing == "left"), *one.point[1:], float(list(_ODOMETRIES).index(one.odometry)), *one[2:]]
        for one in results
    ]
    return reproduced(
        f"desaxe2018-{figure}",
        [
            Comparison(quantity, number, measured(measure, where, results), unit)
            for quantity, number, unit, measure, where in table["rows"]
        ],
        Log(_SIGNALS, np.array(rows, dtype=np.float64)),
        lambda: _panels(table, results),
        finished=(len(drives), len(points)),
        parts="drives",
    )


fig6: Final = partial(_sensitivity, "fig6")
fig7: Final = partial(_sensitivity, "fig7")
fig8: Final = partial(_sensitivity, "fig8")
_PANELS: Final = {
    "rms": "(a) RMS error [m]",
    "mean": "(b) mean error [m]",
    "matches": "(c) mean number of matches",
    "inliers": "(d) mean share of inliers [%]",
}


def _panels(table: Mapping[str, Any], results: Sequence[Outcome]) -> Figure:
    """The four panels; RMS errors and matches from the paper's text are grey."""
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    for ax, (quantity, title) in zip(figure.subplots(2, 2).flat, _PANELS.items(), strict=True):
        if quantity == "rms" and "band" in table:
            ax.axhspan(*table["band"], color=GREY, alpha=0.25, linewidth=0.0, label="published")
        if quantity == "matches":
            ax.axhline(ENOUGH, color=GREY, linestyle="--", linewidth=1.0, label="250, published threshold")
        if "limit" in table:
            ax.axvline(table["limit"], color=GREY, linestyle="--", linewidth=1.0)
        for (label, where, colour), (odometry, line) in product(table["lines"], _ODOMETRIES.items()):
            chosen = (one for one in results if one.odometry == odometry and one.lies_in(where))
            shown = sorted((getattr(one.point, table["along"]), getattr(one, quantity)) for one in chosen)
            if shown:
                style: dict[str, Any] = {"color": _COLOURS[colour], "markersize": 3.5, "linewidth": 1.2}
                ax.plot(*zip(*shown, strict=True), line, label=f"{label}, {odometry}", **style)
        ax.set(title=title, xlabel=table["xlabel"])
        if quantity != "mean":
            ax.set_ylim(bottom=0.0)
    figure.axes[0].legend(fontsize=8.0)
    figure.axes[2].legend(handles=figure.axes[2].lines[:1], fontsize=8.0)
    return figure


_POINT: Final = Point(facing="left", baseline=1.5, slip=5.0)
_SEEDS: Final = (1, 2, 3, 4, 5)  # drift is random: the worst of these is shown
_LENGTH: Final = 14.0  # of the path that the off-tracking depends on [m]


def fig9(quick: bool, progress: Progress) -> Reproduction:
    """Off-tracking of side-facing cameras over time, and the motion along their optical axis."""
    base = _POINT.case(quick=quick)
    cases = [dataclasses.replace(base, seed=seed) for seed in (_SEEDS[:2] if quick else _SEEDS)]
    drives = driven(cases, progress)
    worst = max(drives, key=lambda one: metrics.peak(one.error("viso2")))
    explained = 100.0 * explained_share(worst)
    largest = {name: max(metrics.peak(one.error(name)) for one in drives) for name in _ODOMETRIES}
    return reproduced(
        "desaxe2018-fig9",
        [
            Comparison("error in the region of drift", "0.08", metrics.peak(worst.error("viso2"))),
            Comparison("error of the motion along the optical axis, RMS", "", metrics.rms(_axial_error(worst))),
            Comparison("share of the off-tracking error that these errors explain", "comparable", explained, "%"),
            Comparison("largest error over all drives", "< 0.15", largest["viso2"]),
            Comparison(
                "RMS error over all drives", "", metrics.rms(np.concatenate([d.error("viso2") for d in drives]))
            ),
            Comparison("keyframe: largest error over all drives", "", largest["keyframe"]),
        ],
        _drift_log(worst),
        lambda: _drift_drawn(worst),
        finished=(len(drives), len(cases)),
        parts="drives",
    )


def _axial_error(one: Drive) -> FloatArray:
    """Motion along the optical axis of left-facing cameras as estimated by viso2 minus the true one [m]."""
    return one.tracks["viso2"].lateral - one.lateral


def _summed(one: Drive) -> FloatArray:
    """Errors of the motion along the optical axis, summed over the last trailer length [m]."""
    errors = np.nan_to_num(_axial_error(one))
    distance, total = _distance(one), np.cumsum(errors)
    return total - np.interp(distance - _LENGTH, distance, total)


def _distance(one: Drive) -> FloatArray:
    """Distance that the trailer has travelled at each image [m]."""
    return np.concatenate([[0.0], np.cumsum(np.diff(one.time) * one.speed[1:])])


def _region(one: Drive) -> tuple[float, float]:
    """Start and end [s] of the last trailer length before the largest error."""
    at = int(np.nanargmax(np.abs(one.error("viso2"))))
    distance = _distance(one)
    return float(np.interp(distance[at] - _LENGTH, distance, one.time)), float(one.time[at])


def explained_share(one: Drive) -> float:
    """Squared correlation of the off-tracking error and the summed errors of the motion."""
    error, summed = one.error("viso2"), _summed(one)
    known = np.isfinite(error)
    if min(np.ptp(error[known]), np.ptp(summed[known])) == 0.0:  # no variation to explain, or none to explain it
        return math.nan
    return float(np.corrcoef(error[known], summed[known])[0, 1] ** 2)


def _drift_log(one: Drive) -> Log:
    viso2, keyframe = one.tracks["viso2"], one.tracks["keyframe"]
    return Log.of(
        [
            (Signal("time", "s", "time"), one.time),
            (Signal("off_tracking_true", "m", "true off-tracking, + left"), one.true),
            (Signal("off_tracking_viso2", "m", "estimate of viso2"), viso2.off_tracking),
            (Signal("off_tracking_keyframe", "m", "estimate of keyframe"), keyframe.off_tracking),
            (Signal("axial_true", "m", "motion since the previous image along the optical axis"), one.lateral),
            (Signal("axial_viso2", "m", "estimate of axial_true"), viso2.lateral),
        ]
    )


def _drift_drawn(one: Drive) -> Figure:
    figure = Figure(figsize=(9.6, 5.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for ax in (above, below):
        label = f"{_LENGTH:.0f} m up to the largest error" if ax is above else None
        ax.axvspan(*_region(one), color=GREY, alpha=0.2, linewidth=0.0, label=label)
    above.plot(one.time, one.true, "--", color=GREY, label="true")
    above.plot(one.time, one.tracks["viso2"].off_tracking, color=ESTIMATED, label="viso2")
    above.plot(one.time, one.tracks["keyframe"].off_tracking, ":", color=TRUE, label="keyframe")
    above.set(ylabel="off-tracking [m], + left", title="(a) off-tracking")
    above.legend()
    below.plot(
        one.time, one.tracks["viso2"].lateral, "-o", color=ESTIMATED, markersize=2.5, linewidth=0.8, label="viso2"
    )
    below.plot(one.time, one.lateral, "--", color=GREY, label="true")
    below.set(xlabel="time [s]", ylabel="per image along $Z_c$ [m]", title="(b) visual odometry")
    below.legend()
    return figure
