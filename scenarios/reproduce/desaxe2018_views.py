"""Fig. 13 of de Saxe 2018: what the cameras saw in the field tests, and the features that were matched in it.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 4.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimators.estimates import Motion
from estimators.viso2_odometry import Viso2Odometry
from estimators.viso_ot import VisoOt
from scenarios.assembly import assemble
from scenarios.drawing import ESTIMATED
from scenarios.log import Log, Signal
from scenarios.loop import Session
from scenarios.reproduce.desaxe2018_drive import with_source
from scenarios.reproduce.desaxe2018_field import Facing, field_case
from scenarios.reproduce.desaxe2018_simulation import SOURCE
from scenarios.reproduce.figure import Comparison, Progress, Reproduction
from scenarios.scenario import load_scenario
from sensors.messages import GreyImage, StereoFrame
from vehicle.clock import TICK

_WHEN: Final = 20.0  # in the roundabout [s]
_QUICK: Final = 3.0  # on the straight before it [s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A stereo pair, rectified, and the features of its left image that were matched."""

    facing: Facing
    left: GreyImage
    right: GreyImage
    motion: Motion

    @property
    def tracks(self) -> NDArray[np.float32]:
        """Of the features: u, v before, u, v now (n, 4) [px]."""
        return self.motion.tracks


def fig13(quick: bool, progress: Progress) -> Reproduction:
    """One stereo pair of the left roundabout, rear- and side-facing, with matched features."""
    until = _QUICK if quick else _WHEN
    sides: tuple[Facing, ...] = ("rear", "left")
    views = [_seen(facing, until, _part(progress, k)) for k, facing in enumerate(sides)]
    progress(100, 100, "")
    return Reproduction(
        name="desaxe2018-fig13",
        title="Fig. 13: example views with matched features",
        source=SOURCE,
        comparisons=[
            Comparison(
                quantity=f"{name} cameras: matches of the pair shown",
                published="400–800",
                own=view.motion.matches,
                unit="-",
            )
            for name, view in zip(("rear", "side"), views, strict=True)
        ],
        notes=("Left roundabout, baseline 0.5 m. The published range is that of most manoeuvres, by the text.",),
        data=_log(views),
        draw=lambda: _drawn(views),
    )


def _part(progress: Progress, k: int) -> Callable[[int], None]:
    return lambda done: progress(50 * k + done, 100, "driving")


class Latest:
    """An off-tracking estimator that keeps the newest frame, and the motion it measured up to it.

    Not frozen, as it stands for what changes during a run.
    """

    def __init__(self, source: VisoOt[Any]) -> None:
        self._source = source
        self.frame: StereoFrame | None = None
        self.motion: Motion | None = None

    def init(self) -> Any:
        """The estimator's memory before any frame."""
        return self._source.init()

    def step(self, memory: Any, frame: StereoFrame) -> tuple[Any, Any]:
        """The estimator's step."""
        memory, estimate = self._source.step(memory, frame)
        self.frame, self.motion = frame, None if estimate is None else estimate.motion
        return memory, estimate


def _seen(facing: Facing, until: float, told: Callable[[int], None]) -> View:
    """The last pair of the roundabout's first ``until`` seconds; ``told`` is how many of 50 parts are done."""
    case = field_case("left roundabout", facing, 0.5, quick=True)
    parts = assemble(load_scenario(case.scenario, case.settings), case.seed)
    if parts.cameras is None:
        raise ValueError(f"scenario {case.scenario} has no cameras")
    calibration = parts.cameras.calibration
    latest = Latest(VisoOt(calibration, parts.trailer.follow_distance, Viso2Odometry(calibration)))
    session = Session(with_source(parts, parts.cameras, latest))
    try:
        while session.outcome is None and session.tick * TICK < until:
            session.advance()
            told(int(50 * session.tick * TICK / until))
    finally:
        session.close()
        parts.cameras.renderer.close()
    if latest.frame is None or latest.motion is None:
        raise ValueError(f"nothing was seen within {until} s")
    return View(facing=facing, left=latest.frame.left, right=latest.frame.right, motion=latest.motion)


_SIGNALS: Final = (
    Signal("facing", "-", "0 to the rear, 1 to the left"),
    Signal("u_before", "px", "column in the left image before"),
    Signal("v_before", "px", "row there"),
    Signal("u", "px", "column in the left image"),
    Signal("v", "px", "row there"),
)


def _log(views: Sequence[View]) -> Log:
    tables = [np.column_stack([np.full(len(v.tracks), float(v.facing == "left")), v.tracks]) for v in views]
    return Log(_SIGNALS, np.concatenate(tables))


def _drawn(views: Sequence[View]) -> Figure:
    """Left and right image side by side as in the paper, the features on the left one."""
    figure = Figure(figsize=(12.0, 1.0 + 1.9 * len(views)), layout="constrained")
    axes = figure.subplots(len(views), 2, squeeze=False)
    for pair, view, letter in zip(axes, views, "ab", strict=False):
        for ax, image, side in zip(pair, (view.left, view.right), ("left", "right"), strict=True):
            ax.imshow(image, cmap="gray", vmin=0, vmax=255)
            ax.set(
                xticks=(), yticks=(), title=f"({letter}) {'rear' if view.facing == 'rear' else 'side'} cameras, {side}"
            )
        u0, v0, u, v = view.tracks.T
        pair[0].plot(np.stack([u0, u]), np.stack([v0, v]), color=ESTIMATED, linewidth=0.7)
        pair[0].plot(u, v, ".", color=ESTIMATED, markersize=2.0)
    return figure
