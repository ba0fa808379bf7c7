"""One drive of the trailer, seen by one pair of cameras, and what several odometries make of the same images.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018. Nothing is steered by the estimates, so that one drive serves them all.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, takewhile
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from estimators.calibration.right_rotation import RightRotation, straightened
from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import OffTrackingSource
from estimators.odometry.keyframe import KeyframeOdometry
from estimators.odometry.viso2 import Viso2Odometry
from estimators.off_tracking.viso_ot import VisoOt
from scenarios.assembly.mount import Cameras
from scenarios.assembly.stereo_cameras import Rectified
from scenarios.assembly.trailer import Assembly, assemble
from scenarios.loop.combination import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.progress import Progress, no_progress, part_of
from scenarios.randomness import stream
from scenarios.results import metrics
from scenarios.results.reference_unit import reference_off_tracking
from scenarios.results.trailer_signals import Estimate, TrailerTrack, run_log
from scenarios.studies.pool import as_finished, default_jobs
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse

# How the paper concludes that the right camera was turned in the tests (section 4.4): roll, yaw, pitch.
TURNED: Final = RightRotation(math.radians(-0.15), math.radians(0.10), 0.0)


class Straightened:
    """An odometry that gets right images straightened by a rotation that is told (de Saxe 2018, section 4.4)."""

    def __init__(self, calibration: StereoCalibration, odometry: Viso2Odometry, rotation: RightRotation) -> None:
        self._calibration, self._odometry, self._rotation = calibration, odometry, rotation

    def init(self) -> Any:
        """The odometry's memory before any frame."""
        return self._odometry.init()

    def step(self, memory: Any, frame: StereoFrame) -> tuple[Any, Any]:
        """The odometry's step with the straightened frame."""
        right = straightened(self._calibration, frame.right, self._rotation)
        stepped: tuple[Any, Any] = self._odometry.step(memory, dataclasses.replace(frame, right=right))
        return stepped


ODOMETRIES: Final[dict[str, Callable[[StereoCalibration], Any]]] = {
    "viso2": Viso2Odometry,
    "viso2, corrected": lambda c: Straightened(c, Viso2Odometry(c), TURNED),
    "keyframe": KeyframeOdometry,
    "keyframe, self-calibrated": lambda c: SelfCalibratedOdometry(c, KeyframeOdometry(c)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is driven and what watches it."""

    scenario: str
    settings: tuple[str, ...] = ()
    odometries: tuple[str, ...] = ("viso2", "keyframe")
    seed: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What one odometry made of a drive: arrays (n,) over its images, NaN where it says nothing."""

    off_tracking: FloatArray  # [m]
    std: FloatArray  # [m]
    matches: FloatArray
    inliers: FloatArray
    aside: FloatArray  # motion since the image before, along y of the trailer [m]


_SIGNALS: Final = ("off_tracking_estimate", "off_tracking_std", "matches", "inliers", "odometry_dy")  # of a Track


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """A drive at its images, shape (n,) each."""

    case: Case
    time: FloatArray  # [s]
    true: FloatArray  # off-tracking, + left [m]
    reference: FloatArray  # the same as a GNSS-aided inertial unit has it [m]
    aside: FloatArray  # true motion since the image before, along y of the trailer [m]
    speed: FloatArray  # of the trailer [m/s]
    tracks: dict[str, Track]
    outcome: str

    def error(self, odometry: str) -> FloatArray:
        """Estimate less truth [m]."""
        return self.tracks[odometry].off_tracking - self.true


class Beside:
    """Several estimators that are given the same frames; the first one's answer counts, all are kept.

    Not frozen, as it stands for what accumulates during a run.
    """

    def __init__(self, sources: Sequence[Any]) -> None:
        self._sources = sources
        self.kept: list[list[Estimate]] = [[] for _ in sources]

    def init(self) -> tuple[Any, ...]:
        """Everyone's memory before any frame."""
        return tuple(source.init() for source in self._sources)

    def step(self, memory: tuple[Any, ...], frame: StereoFrame) -> tuple[tuple[Any, ...], Any]:
        """Everyone's step; the first one's estimate."""
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
    calibration, follow = parts.cameras.calibration, parts.trailers[-1].geometry.follow_distance
    beside = Beside([VisoOt(calibration, follow, ODOMETRIES[name](calibration)) for name in case.odometries])
    with closing(parts), TrailerSession(with_estimator(parts, parts.cameras, beside)) as session:
        while session.outcome is None:
            session.advance()
            progress(session.progress, 1.0)
    return _gathered(case, session, beside, parts.cameras)


def with_estimator(parts: Assembly, cameras: Cameras, estimator: OffTrackingSource) -> Assembly:
    """The run with another estimator behind the last trailer's cameras."""
    rectified = Rectified(estimator, cameras.rectifier) if cameras.rectifier else estimator
    last = parts.trailers[-1]
    watched = dataclasses.replace(last, sensing=dataclasses.replace(last.sensing, estimator=rectified))
    return dataclasses.replace(parts, trailers=(*parts.trailers[:-1], watched))


def _gathered(case: Case, session: TrailerSession, beside: Beside, cameras: Cameras) -> Drive:
    parts = session.parts
    truths = [row.truth for row in session.rows]
    last = parts.trailers[-1]
    unit, follow = last.unit, last.geometry.follow_distance
    bodies = np.array([truth.bodies[unit] for truth in truths])
    poses = np.array([truth.poses[unit] for truth in truths])
    true = metrics.true_off_tracking(poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]), follow)
    rng = stream(case.seed, "reference unit")
    reference = reference_off_tracking(truths, unit=unit, follow_distance=follow, rng=rng)
    tracks: dict[str, Track] = {}
    at = np.array([], dtype=np.intp)
    for odometry, estimates in zip(case.odometries, beside.kept, strict=True):
        track = TrailerTrack(
            name=last.name,
            follow_distance=follow,
            steers_ahead=last.steers_ahead,
            n_steered=last.n_steered,
            estimates=estimates,
            X_SC=cameras.calibration.X_SC,
        )
        units = parts.vehicle.units
        n_front = len(units[0].steered_axles)
        log = run_log(session.rows, [track], units=[unit.name for unit in units], n_front=n_front)
        at = at if len(at) else np.flatnonzero(np.isfinite(log["health"]))  # the same images for everyone
        tracks[odometry] = Track(*(log[signal][at] for signal in _SIGNALS))
    return Drive(
        case=case,
        time=np.array([truth.tick * TICK for truth in truths])[at],
        true=true[at],
        reference=reference[at],
        aside=_aside(bodies, at),
        speed=np.array([truth.velocities[unit][0] for truth in truths])[at],
        tracks=tracks,
        outcome=session.outcome or "",
    )


def _aside(bodies: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Motion along the trailer's y from each image to the next, at the later one [m]; the first has none."""
    ends = [np.nan] + [float((inverse(bodies[i]) @ bodies[j])[1, 3]) for i, j in pairwise(at.tolist())]
    return np.array(ends)


_DRIVEN: dict[Case, Drive] = {}  # figures share drives: with all of them made at once, each is driven once


def driven(cases: Sequence[Case], progress: Progress) -> list[Drive]:
    """The drives of all cases, in several processes if there are several cores.

    An interrupt ends it early and keeps those before the first that is not finished, if there is one.
    """
    missing = [case for case in dict.fromkeys(cases) if case not in _DRIVEN]
    jobs = min(default_jobs(), len(missing))
    try:
        if jobs > 1:
            _drive_together(missing, progress, jobs)
        else:
            for k, case in enumerate(missing):
                _DRIVEN[case] = drive(
                    case, part_of(progress, k, len(missing), f"{case.scenario}, drive {k + 1} of {len(missing)}")
                )
    except KeyboardInterrupt:
        if cases[0] not in _DRIVEN:
            raise
    progress(100 * len(missing), 100 * len(missing), "")
    return [_DRIVEN[case] for case in takewhile(_DRIVEN.__contains__, cases)]


def _drive_together(cases: Sequence[Case], progress: Progress, jobs: int) -> None:
    """Drives all cases and keeps each as soon as it is finished; told after each."""
    progress(0, 100 * len(cases), f"{len(cases)} drives in {jobs} processes")
    for k, (case, found) in enumerate(as_finished(partial(drive, progress=no_progress), cases, jobs=jobs), start=1):
        _DRIVEN[case] = found
        progress(100 * k, 100 * len(cases), f"{case.scenario}, {k} of {len(cases)} drives in {jobs} processes")


def unfinished(done: int, of: int) -> tuple[str, ...]:
    """A note if an interrupt has left some out."""
    return () if done == of else (f"Interrupted: {done} of {of} drives are finished, and only they are here.",)
