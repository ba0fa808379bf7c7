"""Figs 6 to 8 of de Saxe 2018: what the off-tracking's error depends on, in a rendered world with perfect cameras.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 3: the trailer is dragged 100 m straight on at 5 m/s and a constant slip angle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios import metrics
from scenarios.drawing import ESTIMATED, GREY, TRUE
from scenarios.log import Log, Signal
from scenarios.reproduce.desaxe2018_drive import Case, Drive, driven, unfinished
from scenarios.reproduce.figure import Comparison, Progress, Reproduction

SOURCE: Final = "de Saxe & Cebon, Vehicle System Dynamics 2018"
ENOUGH: Final = 250.0  # matches below which the paper's errors grow
_ODOMETRIES: Final = ("viso2", "keyframe")
_THIRD: Final = "#5b8c3a"
_SHORT: Final = "course.length=40"  # with --quick: the off-tracking is known over 26 m of it

Facing = Literal["rear", "left"]


class Point(NamedTuple):
    """One drive of a figure."""

    facing: Facing = "rear"
    baseline: float = 0.5  # [m]
    slip: float = 14.0  # [deg]
    density: float = 1.0  # of the scenery

    def case(self, *, quick: bool) -> Case:
        """Its drive."""
        settings = (
            f"rig.facing={self.facing}",
            f"rig.baseline={self.baseline}",
            f"course.slip_angle_deg={self.slip}",
            f"world.scenery_density={self.density}",
        )
        return Case(scenario="constant-slip", settings=(*settings, _SHORT) if quick else settings)


class Outcome(NamedTuple):
    """What an odometry made of a drive."""

    point: Point
    odometry: str
    rms: float  # of the off-tracking's error [m]
    mean: float  # [m]
    largest: float  # [m]
    matches: float  # mean number
    inliers: float  # mean share of them [%]


def fig6(quick: bool, progress: Progress) -> Reproduction:
    """Errors and matches over the stereo baseline, rear- and side-facing, at 14 degrees of slip."""
    baselines = (0.5, 2.5, 5.0) if quick else tuple(0.5 * k for k in range(1, 11))
    points = [Point(facing=facing, baseline=b) for facing in ("rear", "left") for b in baselines]
    got = _outcomes(points, quick=quick, progress=progress)
    comparisons = [
        _line("rear, up to 2.5 m: largest RMS error", "0.01–0.04", _most(got, "rms", _near)),
        _line("rear, up to 2.5 m: largest mean error", "0.01", _most(got, "mean", _near)),
        _line("side, up to 2.5 m: largest RMS error", "0.01–0.04", _most(got, "rms", _near_side)),
        _line("rear, beyond 2.5 m: largest RMS error", "", _most(got, "rms", _far)),
        _line("side, beyond 2.5 m: largest RMS error", "above the rear's", _most(got, "rms", _far_side)),
        _line("rear, 0.5 m: matches", "", _most(got, "matches", lambda p: p == Point()), "-"),
        _line("rear: first baseline with under 250 matches", "2.5", _first_short(got, "rear")),
        _line("side: first baseline with under 250 matches", "2.5", _first_short(got, "left")),
        _line("keyframe, rear, up to 2.5 m: largest RMS error", "", _most(got, "rms", _near, "keyframe")),
        _line("keyframe, side, up to 2.5 m: largest RMS error", "", _most(got, "rms", _near_side, "keyframe")),
    ]
    return Reproduction(
        name="desaxe2018-fig6",
        title="Fig. 6: sensitivity to the stereo baseline at 14 degrees of slip",
        source=SOURCE,
        comparisons=comparisons,
        notes=(_SIGN, *unfinished(len(got) // 2, len(points))),
        data=_log(got),
        draw=lambda: _drawn(
            got,
            "baseline",
            "stereo baseline [m]",
            [("rear", _rear, TRUE), ("side", _side, ESTIMATED)],
            band=(0.01, 0.04),
        ),
    )


def fig7(quick: bool, progress: Progress) -> Reproduction:
    """Errors and matches of rear-facing cameras over the slip angle, at three baselines."""
    slips = (0.0, 8.0, 16.0) if quick else (*np.arange(0.0, 17.0, 2.0).tolist(), 20.0, 30.0, 45.0, 60.0)
    baselines = (0.5, 1.5, 2.5)
    points = [Point(baseline=b, slip=slip) for b in baselines for slip in slips]
    got = _outcomes(points, quick=quick, progress=progress)
    published = {
        0.5: ("0.01–0.03", "0.01", "380"),
        1.5: ("0.01–0.03", "0.01", "325"),
        2.5: ("0.02–0.04", "0.035", "250"),
    }
    comparisons = []
    for b, (rms, mean, matches) in published.items():

        def usual(p: Point, b: float = b) -> bool:
            return p.baseline == b and p.slip <= 16.0

        comparisons += [
            _line(f"{b} m, up to 16 deg: smallest RMS error", rms.partition("–")[0], _least(got, usual)),
            _line(f"{b} m, up to 16 deg: largest RMS error", rms.partition("–")[2], _most(got, "rms", usual)),
            _line(f"{b} m, up to 16 deg: largest mean error", mean, _most(got, "mean", usual)),
            _line(f"{b} m, up to 16 deg: mean matches", matches, _average(got, usual), "-"),
            _line(f"{b} m, up to 16 deg: keyframe, largest RMS", "", _most(got, "rms", usual, "keyframe")),
        ]
    colours = dict(zip(baselines, (TRUE, ESTIMATED, _THIRD), strict=True))
    groups = [(f"{b} m", partial(_has_baseline, b), colour) for b, colour in colours.items()]
    return Reproduction(
        name="desaxe2018-fig7",
        title="Fig. 7: sensitivity to the slip angle, rear-facing",
        source=SOURCE,
        comparisons=comparisons,
        notes=(_SIGN, *unfinished(len(got) // 2, len(points))),
        data=_log(got),
        draw=lambda: _drawn(got, "slip", "trailer slip angle [°]", groups, band=(0.01, 0.03), limit=16.0),
    )


def fig8(quick: bool, progress: Progress) -> Reproduction:
    """Errors and matches over the density of the scenery, rear- and side-facing."""
    points = [Point(facing=facing, density=d) for facing in ("rear", "left") for d in (0.0, 0.5, 1.0)]
    got = _outcomes(points, quick=quick, progress=progress)

    def rms(facing: Facing, density: float, odometry: str = "viso2") -> float:
        return _most(got, "rms", lambda p: p.facing == facing and p.density == density, odometry)

    def ratio(facing: Facing) -> float:
        full = rms(facing, 1.0)
        return rms(facing, 0.0) / full if full > 0.0 else math.nan

    comparisons = [
        _line("rear, 100 %: RMS error", "0.01–0.03", rms("rear", 1.0)),
        _line("rear, 0 %: RMS error", "about the same", rms("rear", 0.0)),
        _line("side, 100 %: RMS error", "", rms("left", 1.0)),
        _line("side, 0 %: RMS error", "", rms("left", 0.0)),
        _line("rear: RMS error at 0 % over that at 100 %", "1", ratio("rear"), "-"),
        _line("side: RMS error at 0 % over that at 100 %", "2", ratio("left"), "-"),
        _line("fewest matches at 0 %", "> 250", _fewest(got, lambda p: p.density == 0.0), "-"),
        _line("keyframe, rear, 0 %: RMS error", "", rms("rear", 0.0, "keyframe")),
        _line("keyframe, side, 0 %: RMS error", "", rms("left", 0.0, "keyframe")),
        _line("keyframe, side, 100 %: RMS error", "", rms("left", 1.0, "keyframe")),
    ]
    return Reproduction(
        name="desaxe2018-fig8",
        title="Fig. 8: sensitivity to the density of the scenery",
        source=SOURCE,
        comparisons=comparisons,
        notes=(_SIGN, *unfinished(len(got) // 2, len(points))),
        data=_log(got),
        draw=lambda: _drawn(
            got, "density", "density of the scenery [-]", [("rear", _rear, TRUE), ("side", _side, ESTIMATED)]
        ),
    )


_SIGN: Final = (
    "Errors are against the exact off-tracking. Numbers without a name are those of viso2, the paper's stages; "
    "keyframe is this project's own, from the same images. Side-facing cameras look to the left."
)
_SIGNALS: Final = (
    Signal("facing", "-", "0 to the rear, 1 to the left"),
    Signal("baseline", "m", "of the stereo cameras"),
    Signal("slip", "deg", "slip angle of the trailer"),
    Signal("density", "-", "of the scenery"),
    Signal("odometry", "-", "0 viso2, 1 keyframe"),
    Signal("rms", "m", "RMS error of the off-tracking"),
    Signal("mean", "m", "mean error, + left"),
    Signal("largest", "m", "largest magnitude of the error"),
    Signal("matches", "-", "mean number of matches"),
    Signal("inliers", "%", "mean share of inliers among them"),
)


def _outcomes(points: Sequence[Point], *, quick: bool, progress: Progress) -> list[Outcome]:
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


def _near(p: Point) -> bool:
    return _rear(p) and p.baseline <= 2.5


def _near_side(p: Point) -> bool:
    return _side(p) and p.baseline <= 2.5


def _far(p: Point) -> bool:
    return _rear(p) and p.baseline > 2.5


def _far_side(p: Point) -> bool:
    return _side(p) and p.baseline > 2.5


def _has_baseline(baseline: float, p: Point) -> bool:
    return p.baseline == baseline


def _rear(p: Point) -> bool:
    return p.facing == "rear"


def _side(p: Point) -> bool:
    return p.facing == "left"


def _values(got: Sequence[Outcome], quantity: str, chosen: Choice, odometry: str = "viso2") -> list[float]:
    return [abs(getattr(one, quantity)) for one in got if one.odometry == odometry and chosen(one.point)]


def _most(got: Sequence[Outcome], quantity: str, chosen: Choice, odometry: str = "viso2") -> float:
    return max(_values(got, quantity, chosen, odometry), default=math.nan)


def _least(got: Sequence[Outcome], chosen: Choice) -> float:
    return min(_values(got, "rms", chosen), default=math.nan)


def _fewest(got: Sequence[Outcome], chosen: Choice) -> float:
    return min(_values(got, "matches", chosen), default=math.nan)


def _average(got: Sequence[Outcome], chosen: Choice) -> float:
    counts = _values(got, "matches", chosen)
    return sum(counts) / len(counts) if counts else math.nan


def _first_short(got: Sequence[Outcome], facing: str) -> float:
    """The smallest baseline at which there are not enough matches [m]."""
    viso2 = (one for one in got if one.odometry == "viso2" and one.point.facing == facing)
    return min((one.point.baseline for one in viso2 if one.matches < ENOUGH), default=math.nan)


def _line(quantity: str, published: str, own: float, unit: str = "m") -> Comparison:
    return Comparison(quantity=quantity, published=published, own=own, unit=unit)


def _log(got: Sequence[Outcome]) -> Log:
    rows = [[float(_side(one.point)), *one.point[1:], float(_ODOMETRIES.index(one.odometry)), *one[2:]] for one in got]
    return Log(_SIGNALS, np.array(rows, dtype=np.float64).reshape(-1, len(_SIGNALS)))


_PANELS: Final = (
    ("rms", "(a) RMS error [m]"),
    ("mean", "(b) mean error [m]"),
    ("matches", "(c) mean number of matches"),
    ("inliers", "(d) mean share of inliers [%]"),
)


def _drawn(
    got: Sequence[Outcome],
    along: str,
    xlabel: str,
    groups: Sequence[tuple[str, Choice, str]],
    *,
    band: tuple[float, float] | None = None,
    limit: float | None = None,
) -> Figure:
    """The paper's four panels; what its text says of RMS errors and matches is grey."""
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
                _plot(ax, got, along, quantity, chosen, odometry, line=line, colour=colour, label=label)
        ax.set(title=title, xlabel=xlabel)
        if quantity != "mean":
            ax.set_ylim(bottom=0.0)
    figure.axes[0].legend(fontsize=8.0)
    figure.axes[2].legend(handles=figure.axes[2].lines[:1], fontsize=8.0)
    return figure


def _plot(
    ax: Axes,
    got: Sequence[Outcome],
    along: str,
    quantity: str,
    chosen: Choice,
    odometry: str,
    *,
    line: str,
    colour: str,
    label: str,
) -> None:
    shown = sorted(
        (getattr(one.point, along), getattr(one, quantity))
        for one in got
        if one.odometry == odometry and chosen(one.point)
    )
    if shown:
        ax.plot(
            *zip(*shown, strict=True), line, color=colour, markersize=3.5, linewidth=1.2, label=f"{label}, {odometry}"
        )
