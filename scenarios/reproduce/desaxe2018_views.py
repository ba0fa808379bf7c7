"""Fig. 13 of de Saxe 2018: camera images of the field tests with matched features.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 4.2.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from estimators.odometry.point_tracking import Matches
from estimators.odometry.viso2 import NEAR, Viso2Odometry
from estimators.odometry.viso2_matching import circular_matches, pair_features
from scenarios.assembly.trailer import assemble
from scenarios.loop.combination import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.progress import Progress, part_of
from scenarios.report.plots import ESTIMATED
from scenarios.reproduce.desaxe2018_drive import with_estimator
from scenarios.reproduce.desaxe2018_field import Facing, field_case
from scenarios.reproduce.desaxe2018_outcomes import SOURCE
from scenarios.reproduce.figure import Reproduction, compared
from scenarios.results.log import Log, Signal
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.clock import TICK

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
    sides: tuple[Facing, ...] = ("rear", "left")
    views = [_view(facing, until, part_of(progress, k, len(sides), "driving")) for k, facing in enumerate(sides)]
    progress(100, 100, "")
    return Reproduction(
        name="desaxe2018-fig13",
        title="Fig. 13: example views with matched features",
        source=SOURCE,
        comparisons=[
            compared(f"{name} cameras: matches of the pair shown", "400–800", float(len(view.matches.current)), "-")
            for name, view in zip(("rear", "side"), views, strict=True)
        ],
        notes=(
            "Left roundabout, baseline 0.5 m. The published range is that of most manoeuvres, from the text. With two "
            "matches per bucket of 50 x 50 px there are at most 432 in images of 1344 x 391 px, the size in the "
            "paper's simulations. The size in its field tests is not published.",
        ),
        data=_log(views),
        draw=lambda: _drawn(views),
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


def _view(facing: Facing, until: float, progress: Progress) -> View:
    """View of the last stereo pair in the roundabout's first ``until`` seconds."""
    case = field_case("left roundabout", facing, 0.5, quick=True)
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
    return View(facing=facing, left=newest.left, right=newest.right, matches=_matched(calibration, list(latest.frames)))


def _matched(calibration: StereoCalibration, frames: Sequence[StereoFrame]) -> Matches:
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


def _log(views: Sequence[View]) -> Log:
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
            facing = "rear" if view.facing == "rear" else "side"
            ax.set(xticks=(), yticks=(), title=f"({letter}) {facing} cameras, {side}")
        (u0, v0, _), (u, v, u_right) = view.matches.previous.T, view.matches.current.T
        pair[0].plot(np.stack([u0, u]), np.stack([v0, v]), color=ESTIMATED, linewidth=0.7)
        for ax, column in zip(pair, (u, u_right), strict=True):
            ax.plot(column, v, ".", color=ESTIMATED, markersize=2.0)
    return figure
