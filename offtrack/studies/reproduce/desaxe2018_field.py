"""Figs 13 to 16 of de Saxe 2018: field tests, with a camera mount that was bent after its calibration.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 4. The paper's off-tracking is + right; here it is + left.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimators.odometry.image_points import Matches
from estimators.odometry.viso2 import NEAR, Viso2Odometry
from estimators.odometry.viso2_matching import circular_matches, pair_features
from offtrack.reports.plots import ESTIMATED, GREY, TRUE
from offtrack.studies.reproduce.desaxe2018 import ENOUGH, THIRD, Case, Drive, Facing, driven, with_estimator
from offtrack.studies.reproduce.reproduction import Comparison, Reproduction, printed, reproduced
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.progress import Progress, part_of
from scenarios.results import metrics
from scenarios.results.log import Column, Log, Signal
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray

MANOEUVRES: Final = {  # in the order of the paper's rows
    "figure-of-eight": "field-figure-of-eight",
    "left roundabout": "field-roundabout-left",
    "right roundabout": "field-roundabout-right",
}
OWN: Final = "keyframe, self-calibrated"
_CORRECTED: Final = "viso2, corrected"
_SIDES: Final[dict[Facing, str]] = {"rear": "rear", "left": "side"}
_BASELINES: Final = (0.5, 0.7, 0.9)
_CLEARLY: Final = 1.0  # off-tracking beyond which the bias of each side is evaluated in Fig. 16 [m]


class FieldTest(NamedTuple):
    """One drive of the field tests."""

    manoeuvre: str
    facing: Facing = "rear"
    baseline: float = _BASELINES[0]  # [m]

    def case(self, *, quick: bool) -> Case:
        """The drive as a case; ``quick``: one of the three turns, or one figure of eight."""
        settings = [f"rig.facing={self.facing}", f"rig.baseline={self.baseline}"]
        if quick and self.manoeuvre == "figure-of-eight":
            turn = '{{direction = "{}", radius = 11.35, turn_deg = 225.6, straight = {}}}'
            settings.append(f"course.turns=[{turn.format('left', 50.0)}, {turn.format('right', 40.0)}]")
        elif quick:
            settings.append("course.turn_deg=360.0")
        if quick:
            settings += ["speed_kmh=25", "course.entry=40"]
        corrected = (_CORRECTED,) if self.facing == "rear" and self.baseline == _BASELINES[0] else ()
        odometries = ("viso2", OWN, *corrected)
        return Case(scenario=MANOEUVRES[self.manoeuvre], settings=tuple(settings), odometries=odometries)


Shown = Sequence[tuple[FieldTest, Drive]]


def fig14(quick: bool, progress: Progress) -> Reproduction:
    """Off-tracking, matches and errors over time: three manoeuvres, rear- and side-facing, baseline 0.5 m."""
    tests = [FieldTest(manoeuvre, facing) for manoeuvre in MANOEUVRES for facing in _SIDES]

    def compare(test: FieldTest, one: Drive) -> Iterator[Comparison]:
        paper = printed("desaxe2018")["field"][test.facing if test.manoeuvre == "left roundabout" else "others"]
        return _compared(f"{test.manoeuvre}, {_SIDES[test.facing]}", one, paper)

    return _figure("fig14", tests, quick, progress, compare, _histories)


def fig15(quick: bool, progress: Progress) -> Reproduction:
    """RMS and largest errors and matches in the left roundabout, over baselines and sides."""
    tests = [FieldTest("left roundabout", facing, baseline) for facing in _SIDES for baseline in _BASELINES]

    def compare(test: FieldTest, one: Drive) -> Iterator[Comparison]:
        return _compared(f"{_SIDES[test.facing]}, {test.baseline} m", one, printed("desaxe2018")["field"][test.facing])

    return _figure("fig15", tests, quick, progress, compare, _bars)


def fig16(quick: bool, progress: Progress) -> Reproduction:
    """The three manoeuvres, rear-facing, with right images corrected for the rotation of their camera."""

    def compare(test: FieldTest, one: Drive) -> Iterator[Comparison]:
        for odometry in ("viso2", _CORRECTED, OWN):
            name = f"{test.manoeuvre}, {odometry}"
            for side, bias in zip(("left", "right"), biases(one, odometry), strict=True):
                if math.isfinite(bias):
                    yield Comparison(f"{name}: bias where the path is {side}", "", bias)
            paper = "as uncorrected left roundabout, 0.11–0.12" if odometry == _CORRECTED else ""
            yield Comparison(f"{name}: RMS error", paper, _rms(one, odometry))

    return _figure("fig16", [FieldTest(name) for name in MANOEUVRES], quick, progress, compare, _corrections)


def _figure(
    figure: str,
    tests: Sequence[FieldTest],
    quick: bool,
    progress: Progress,
    compare: Callable[[FieldTest, Drive], Iterable[Comparison]],
    draw: Callable[[Shown], Figure],
) -> Reproduction:
    drives = driven([test.case(quick=quick) for test in tests], progress)
    shown = list(zip(tests, drives, strict=False))
    logs = [Log.of(_columns(*each)) for each in shown]
    return reproduced(
        f"desaxe2018-{figure}",
        [line for test, one in shown for line in compare(test, one)],
        Log(logs[0].signals, np.concatenate([log.rows for log in logs])),
        lambda: draw(shown),
        finished=(len(drives), len(tests)),
        parts="drives",
    )


def _error(one: Drive, odometry: str) -> FloatArray:
    """Estimate minus its reference [m]: see the notes."""
    return one.error(odometry) if odometry == OWN else one.tracks[odometry].off_tracking - one.reference


def _rms(one: Drive, odometry: str) -> float:
    return metrics.rms(_error(one, odometry))


def _compared(name: str, one: Drive, paper: Mapping[str, str]) -> Iterator[Comparison]:
    yield Comparison(f"{name}: RMS error", paper["rms"], _rms(one, "viso2"))
    yield Comparison(f"{name}: largest error", paper["largest"], metrics.peak(_error(one, "viso2")))
    yield Comparison(f"{name}: keyframe, RMS error", "", _rms(one, OWN))
    yield Comparison(f"{name}: keyframe, largest error", "", metrics.peak(_error(one, OWN)))
    yield Comparison(f"{name}: mean matches", paper["matches"], metrics.mean(one.tracks["viso2"].matches), "-")


def biases(one: Drive, odometry: str) -> tuple[float, float]:
    """Mean errors [m] where the hitch's path is clearly to the left, and to the right, of the follow point."""
    error = _error(one, odometry)
    return metrics.mean(error[one.true > _CLEARLY]), metrics.mean(error[one.true < -_CLEARLY])


def _columns(test: FieldTest, one: Drive) -> Iterator[Column]:
    n, viso2, own = len(one.time), one.tracks["viso2"], one.tracks[OWN]
    number = float(list(MANOEUVRES).index(test.manoeuvre))
    yield Signal("manoeuvre", "-", "0 figure-of-eight, 1 left roundabout, 2 right roundabout"), np.full(n, number)
    yield Signal("facing", "-", "0 to the rear, 1 to the left"), np.full(n, float(test.facing == "left"))
    yield Signal("baseline", "m", "of the stereo cameras"), np.full(n, test.baseline)
    yield Signal("time", "s", "time"), one.time
    yield Signal("speed", "m/s", "of the trailer"), one.speed
    yield Signal("off_tracking_true", "m", "+ left"), one.true
    yield Signal("off_tracking_reference", "m", "as the reference unit has it"), one.reference
    yield Signal("off_tracking_viso2", "m", "estimate"), viso2.off_tracking
    corrected = one.tracks[_CORRECTED].off_tracking if _CORRECTED in one.tracks else np.full(n, np.nan)
    meaning = "estimate of viso2 from images that were turned back, where there is one"
    yield Signal("off_tracking_corrected", "m", meaning), corrected
    yield Signal("off_tracking_keyframe", "m", "estimate of keyframe with self-calibration"), own.off_tracking
    yield Signal("off_tracking_keyframe_std", "m", "its standard deviation"), own.std
    yield Signal("matches_viso2", "-", "matches"), viso2.matches
    yield Signal("inliers_viso2", "-", "inliers among them"), viso2.inliers


def _histories(shown: Shown) -> Figure:
    """Every panel as in the paper: off-tracking, below it matches, below them errors; rear left, side right."""
    figure = Figure(figsize=(12.0, 13.0), layout="constrained")
    axes = figure.subplots(9, 2, sharex="row", height_ratios=(3.0, 1.0, 1.3) * 3, squeeze=False)
    for (test, one), letter in zip(shown, "abcdef", strict=False):
        row, column = 3 * list(MANOEUVRES).index(test.manoeuvre), list(_SIDES).index(test.facing)
        tracking, matches, errors = axes[row : row + 3, column]
        tracking.set_title(f"({letter}) {_SIDES[test.facing]} cameras, {test.manoeuvre}")
        _history(tracking, errors, one, {"viso2": ESTIMATED, OWN: THIRD}, 1.0)
        matches.plot(one.time, one.tracks["viso2"].matches, color=TRUE, linewidth=0.8)
        matches.axhline(ENOUGH, color=GREY, linestyle="--", linewidth=0.8)
        matches.set(ylabel="matches", ylim=(0.0, None))
    _finished(axes)
    _legend_below(figure, axes[0, 0])
    return figure


def _corrections(shown: Shown) -> Figure:
    """Draw corrected off-tracking and its error as in the paper, and the uncorrected error."""
    figure = Figure(figsize=(9.6, 9.0), layout="constrained")
    axes = figure.subplots(6, 1, height_ratios=(2.4, 1.2) * 3)
    for k, ((test, one), letter) in enumerate(zip(shown, "abc", strict=False)):
        tracking, errors = axes[2 * k : 2 * k + 2]
        tracking.set_title(f"({letter}) {test.manoeuvre}, corrected")
        errors.plot(one.time, _error(one, "viso2"), color=GREY, linewidth=0.8, label="viso2")
        _history(tracking, errors, one, {_CORRECTED: ESTIMATED, OWN: THIRD}, 0.6)
    _finished(axes)
    axes[0].legend(fontsize=8.0)
    axes[1].legend(fontsize=8.0, ncols=3)
    return figure


def _history(tracking: Axes, errors: Axes, one: Drive, colours: Mapping[str, str], largest: float) -> None:
    """Draw the reference, and estimates and errors of some odometries, over time."""
    tracking.plot(one.time, one.reference, color=TRUE, linewidth=1.2, label="reference unit")
    for odometry, colour in colours.items():
        tracking.plot(one.time, one.tracks[odometry].off_tracking, color=colour, linewidth=1.0, label=odometry)
        errors.plot(one.time, _error(one, odometry), color=colour, linewidth=0.8, label=odometry)
    tracking.set_ylabel("off-tracking [m]")
    errors.axhline(0.0, color=GREY, linewidth=0.5)
    errors.set(ylabel="error [m]", ylim=(-largest, largest))


def _finished(axes: NDArray[Any]) -> None:
    for ax in axes.flat:
        ax.set_visible(bool(ax.lines))  # panels of missing drives stay empty
    for ax in axes.reshape(len(axes), -1)[-1]:
        ax.set_xlabel("time [s]")


def _bars(shown: Shown) -> Figure:
    """Draw the paper's three panels over the baselines, with its ranges in grey."""
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    panels = figure.subplots(1, 3)
    names = [f"{_SIDES[test.facing]}\n{test.baseline} m" for test, _ in shown]
    of_drive: dict[str, tuple[str, Callable[[Drive, str], float]]] = {
        "rms": ("(a) RMS error [m]", _rms),
        "largest": ("(b) largest error [m]", lambda one, odometry: metrics.peak(_error(one, odometry))),
        "matches": ("(c) mean matches", lambda one, odometry: metrics.mean(one.tracks[odometry].matches)),
    }
    for ax, (quantity, (title, value)) in zip(panels, of_drive.items(), strict=True):
        ranges = np.array(
            [printed("desaxe2018")["field"][test.facing][quantity].split("–") for test, _ in shown], dtype=float
        )
        heights = ranges[:, 1] - ranges[:, 0]
        ax.bar(names, heights, 0.95, bottom=ranges[:, 0], color=GREY, alpha=0.35, label="published")
        for shift, odometry, colour in ((-0.2, "viso2", ESTIMATED), (0.2, OWN, THIRD)):
            own = [value(one, odometry) for _, one in shown]
            ax.bar(np.arange(len(shown)) + shift, own, 0.36, color=colour, label=odometry)
        ax.set_title(title)
        ax.tick_params("x", labelsize=8.0)
    _legend_below(figure, panels[0])
    return figure


def _legend_below(figure: Figure, ax: Axes) -> None:
    """Draw one legend for all panels below them."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8.0)


_TIME: Final = 20.0  # of the pair that is shown, in the roundabout [s]
_PAIRS: Final = 4  # stereo pairs that are kept; the last one is shown
_QUICK: Final = 3.0  # time with --quick, on the straight before the roundabout [s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A rectified stereo pair, and the features matched in it and in the previous pair."""

    facing: Facing
    left: GreyImage
    right: GreyImage
    matches: Matches


def fig13(quick: bool, progress: Progress) -> Reproduction:
    """One stereo pair of the left roundabout, rear- and side-facing, with matched features."""
    until = _QUICK if quick else _TIME
    views = [view_of(facing, until, part_of(progress, k, 2, "driving")) for k, facing in enumerate(_SIDES)]
    progress(100, 100, "")
    return reproduced(
        "desaxe2018-fig13",
        [
            Comparison(f"{name} cameras: matches of the pair shown", "400–800", float(len(view.matches.current)), "-")
            for name, view in zip(_SIDES.values(), views, strict=True)
        ],
        _views_log(views),
        lambda: _drawn(views),
    )


class NewestFrames:
    """Replaces an off-tracking estimator and keeps the newest frames; it gives no estimates.

    Not frozen, as it changes during a run.
    """

    def __init__(self) -> None:
        self.frames: deque[StereoFrame] = deque(maxlen=_PAIRS)

    def init(self) -> None:
        """No memory apart from the frames."""

    def step(self, memory: None, frame: StereoFrame) -> tuple[None, None]:
        """Keep the frame."""
        self.frames.append(frame)
        return None, None


def view_of(facing: Facing, until: float, progress: Progress) -> View:
    """View of the last stereo pair in the roundabout's first ``until`` seconds."""
    case = FieldTest("left roundabout", facing).case(quick=True)
    parts = assemble(load_scenario(case.scenario, case.settings), case.seed)
    if parts.cameras is None:
        raise ValueError(f"scenario {case.scenario} has no cameras")
    calibration = parts.cameras.calibration
    latest = NewestFrames()
    with closing(parts), TrailerSession(with_estimator(parts, parts.cameras, latest)) as session:
        while session.outcome is None and session.tick * TICK < until:
            session.advance()
            progress(min(session.tick * TICK, until), until)
    if len(latest.frames) < _PAIRS:
        raise ValueError(f"{len(latest.frames)} stereo pairs within {until} s; at least {_PAIRS} are needed")
    newest = latest.frames[-1]
    return View(
        facing=facing, left=newest.left, right=newest.right, matches=matched_features(calibration, list(latest.frames))
    )


def matched_features(calibration: StereoCalibration, frames: Sequence[StereoFrame]) -> Matches:
    """Matches of viso2 in the last two frames, predicted with the velocity from the frames before."""
    odometry = Viso2Odometry(calibration)
    memory, motion = odometry.init(), None
    for frame in frames:
        memory, motion = odometry.step(memory, frame)
    guess = np.eye(4) if motion is None else motion.X_PC
    before, now = (pair_features(frame) for frame in frames[-2:])
    return circular_matches(calibration, before, now, guess, NEAR)


_SIGNALS: Final = (
    Signal("facing", "-", "0 to the rear, 1 to the left"),
    Signal("u_before", "px", "column in the previous left image"),
    Signal("v_before", "px", "row in the previous left image"),
    Signal("u", "px", "column in the left image"),
    Signal("v", "px", "row, mean of both images"),
    Signal("u_right", "px", "column in the right image"),
)


def _views_log(views: Sequence[View]) -> Log:
    tables = [
        np.column_stack([np.full(len(z.current), float(v.facing == "left")), z.previous[:, :2], z.current])
        for v in views
        for z in [v.matches]
    ]
    return Log(_SIGNALS, np.concatenate(tables))


def _drawn(views: Sequence[View]) -> Figure:
    """Draw left and right images with the matched features, and their motion in the left image."""
    figure = Figure(figsize=(12.0, 1.0 + 1.9 * len(views)), layout="constrained")
    axes = figure.subplots(len(views), 2, squeeze=False)
    for pair, view, letter in zip(axes, views, "ab", strict=False):
        for ax, image, side in zip(pair, (view.left, view.right), ("left", "right"), strict=True):
            ax.imshow(image, cmap="gray", vmin=0, vmax=255)
            ax.set(xticks=(), yticks=(), title=f"({letter}) {_SIDES[view.facing]} cameras, {side}")
        (u0, v0, _), (u, v, u_right) = view.matches.previous.T, view.matches.current.T
        pair[0].plot(np.stack([u0, u]), np.stack([v0, v]), color=ESTIMATED, linewidth=0.7)
        for ax, column in zip(pair, (u, u_right), strict=True):
            ax.plot(column, v, ".", color=ESTIMATED, markersize=2.0)
    return figure
