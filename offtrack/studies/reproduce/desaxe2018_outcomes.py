"""Errors and matches over the drives of Figs 6 to 8 of de Saxe 2018, and the paper's four panels.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from offtrack.reports.plots import GREY
from offtrack.studies.reproduce.desaxe2018_drive import Case, Drive, driven
from scenarios.progress import Progress
from scenarios.results import metrics
from scenarios.results.log import Log, Signal

SOURCE: Final = "de Saxe & Cebon, Vehicle System Dynamics 2018"
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
    return [_outcome(point, one, name) for point, one in zip(points, drives, strict=False) for name in _ODOMETRIES]


def _outcome(point: Point, one: Drive, odometry: str) -> Outcome:
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


Choice = Callable[[Point], bool]


def _values(results: Sequence[Outcome], quantity: str, chosen: Choice, odometry: str = "viso2") -> list[float]:
    """Magnitudes of a quantity in the chosen drives."""
    return [abs(getattr(one, quantity)) for one in results if one.odometry == odometry and chosen(one.point)]


def most(results: Sequence[Outcome], quantity: str, chosen: Choice, odometry: str = "viso2") -> float:
    """Largest magnitude of a quantity; this and the functions below give NaN if no drive is chosen."""
    return max(_values(results, quantity, chosen, odometry), default=math.nan)


def least(results: Sequence[Outcome], quantity: str, chosen: Choice) -> float:
    """Smallest magnitude of a quantity of viso2."""
    return min(_values(results, quantity, chosen), default=math.nan)


def average(results: Sequence[Outcome], chosen: Choice) -> float:
    """Mean number of matches of viso2 over the chosen drives."""
    counts = _values(results, "matches", chosen)
    return sum(counts) / len(counts) if counts else math.nan


def over(results: Sequence[Outcome], one: Choice, other: Choice) -> float:
    """RMS error of viso2 over all drives of one kind, divided by that of another kind."""
    above, below = (np.array(_values(results, "rms", chosen)) for chosen in (one, other))
    return metrics.rms(above) / metrics.rms(below) if len(above) and np.any(below) else math.nan


def matches_at(results: Sequence[Outcome], facing: str, baseline: float) -> float:
    """Mean number of matches of viso2 at a baseline [m]."""
    return most(results, "matches", lambda p: p.facing == facing and p.baseline == baseline)


def first_short(results: Sequence[Outcome], facing: str) -> float:
    """Smallest baseline with too few matches [m]."""
    viso2 = (one for one in results if one.odometry == "viso2" and one.point.facing == facing)
    return min((one.point.baseline for one in viso2 if one.matches < ENOUGH), default=math.nan)


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


def draw_panels(
    results: Sequence[Outcome],
    along: str,
    xlabel: str,
    groups: Sequence[tuple[str, Choice, str]],
    *,
    band: tuple[float, float] | None = None,
    limit: float | None = None,
) -> Figure:
    """Draw the paper's four panels; RMS errors and matches from its text are grey."""
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    for ax, (quantity, title) in zip(figure.subplots(2, 2).flat, _PANELS, strict=True):
        if quantity == "rms" and band:
            ax.axhspan(*band, color=GREY, alpha=0.25, linewidth=0.0, label="published")
        if quantity == "matches":
            ax.axhline(ENOUGH, color=GREY, linestyle="--", linewidth=1.0, label="250, published threshold")
        if limit is not None:
            ax.axvline(limit, color=GREY, linestyle="--", linewidth=1.0)
        for label, chosen, colour in groups:
            for odometry, line in zip(_ODOMETRIES, ("-o", ":^"), strict=True):
                of_odometry = (one for one in results if one.odometry == odometry and chosen(one.point))
                shown = sorted((getattr(one.point, along), getattr(one, quantity)) for one in of_odometry)
                if shown:
                    style: dict[str, Any] = {"color": colour, "markersize": 3.5, "linewidth": 1.2}
                    ax.plot(*zip(*shown, strict=True), line, label=f"{label}, {odometry}", **style)
        ax.set(title=title, xlabel=xlabel)
        if quantity != "mean":
            ax.set_ylim(bottom=0.0)
    figure.axes[0].legend(fontsize=8.0)
    figure.axes[2].legend(handles=figure.axes[2].lines[:1], fontsize=8.0)
    return figure
