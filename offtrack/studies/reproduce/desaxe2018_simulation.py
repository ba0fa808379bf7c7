"""Figs 6 to 9 of de Saxe 2018: sensitivities of the off-tracking error, and drift, in a rendered world.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 3: the trailer moves 100 m straight ahead at 5 m/s and a constant slip angle.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 3.2.4.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from offtrack.reports.plots import ESTIMATED, GREY, TRUE
from offtrack.studies.reproduce.desaxe2018_drive import Drive, driven, unfinished
from offtrack.studies.reproduce.desaxe2018_outcomes import (
    SOURCE,
    Choice,
    Facing,
    Point,
    average,
    draw_panels,
    first_short,
    least,
    log_of,
    matches_at,
    most,
    outcomes,
    over,
)
from offtrack.studies.reproduce.reproduction import Reproduction, compared
from scenarios.progress import Progress
from scenarios.results import metrics
from scenarios.results.log import Log, Signal
from vehicle.frames import FloatArray

_THIRD: Final = "#5b8c3a"


def fig6(quick: bool, progress: Progress) -> Reproduction:
    """Errors and matches over the stereo baseline, rear- and side-facing, at 14 degrees of slip."""
    baselines = (0.5, 2.5, 5.0) if quick else tuple(0.5 * k for k in range(1, 11))
    points = [Point(facing=facing, baseline=b) for facing in ("rear", "left") for b in baselines]
    results = outcomes(points, quick=quick, progress=progress)
    comparisons = [
        compared(f"{drives}: {label}", published, most(results, quantity, _DRIVES[drives]))
        for drives, label, quantity, published in (
            ("rear, up to 2.5 m", "largest RMS error", "rms", "0.01–0.04"),
            ("rear, up to 2.5 m", "largest mean error", "mean", "0.01"),
            ("side, up to 2.5 m", "largest RMS error", "rms", "0.01–0.04"),
            ("rear, beyond 2.5 m", "largest RMS error", "rms", ""),
            ("side, beyond 2.5 m", "largest RMS error", "rms", "above the rear's"),
        )
    ]
    ratio = over(results, _DRIVES["side, beyond 2.5 m"], _DRIVES["rear, beyond 2.5 m"])
    comparisons += [
        compared("side over rear, beyond 2.5 m: RMS error over all", "> 1", ratio, "-"),
        compared("rear, 0.5 m: matches", "380", matches_at(results, "rear", 0.5), "-"),
        compared("side, 0.5 m: matches", "", matches_at(results, "left", 0.5), "-"),
        compared("rear, 5 m: matches", "", matches_at(results, "rear", 5.0), "-"),
        compared("side, 5 m: matches", "fewer than the rear's", matches_at(results, "left", 5.0), "-"),
        compared("rear: first baseline with under 250 matches", "2.5", first_short(results, "rear")),
        compared("side: first baseline with under 250 matches", "2.5", first_short(results, "left")),
        *(
            compared(f"keyframe, {drives}: largest RMS error", "", most(results, "rms", _DRIVES[drives], "keyframe"))
            for drives in ("rear, up to 2.5 m", "side, up to 2.5 m")
        ),
    ]
    return Reproduction(
        name="desaxe2018-fig6",
        title="Fig. 6: sensitivity to the stereo baseline at 14 degrees of slip",
        source=SOURCE,
        comparisons=comparisons,
        notes=(_SIGN, _RANGE, *unfinished(len(results) // 2, len(points))),
        interrupted=len(results) // 2 < len(points),
        data=log_of(results),
        draw=lambda: draw_panels(results, "baseline", "stereo baseline [m]", _SIDES, band=(0.01, 0.04)),
    )


def fig7(quick: bool, progress: Progress) -> Reproduction:
    """Errors and matches of rear-facing cameras over the slip angle, at three baselines."""
    slips = (0.0, 8.0, 16.0) if quick else (*np.arange(0.0, 17.0, 2.0).tolist(), 20.0, 30.0, 45.0, 60.0)
    baselines = (0.5, 1.5, 2.5)
    points = [Point(baseline=b, slip=slip) for b in baselines for slip in slips]
    results = outcomes(points, quick=quick, progress=progress)
    published = {
        0.5: ("0.01–0.03", "0.01", "380"),
        1.5: ("0.01–0.03", "0.01", "325"),
        2.5: ("0.02–0.04", "0.035", "250"),
    }
    comparisons = []
    for b, (rms, mean, matches) in published.items():
        usual = partial(_usual, b)
        comparisons += [
            compared(f"{b} m, up to 16 deg: smallest RMS error", rms.partition("–")[0], least(results, "rms", usual)),
            compared(f"{b} m, up to 16 deg: largest RMS error", rms.partition("–")[2], most(results, "rms", usual)),
            compared(f"{b} m, up to 16 deg: largest mean error", mean, most(results, "mean", usual)),
            compared(f"{b} m, up to 16 deg: mean matches", matches, average(results, usual), "-"),
            compared(f"{b} m, up to 16 deg: keyframe, largest RMS", "", most(results, "rms", usual, "keyframe")),
        ]
    colours = dict(zip(baselines, (TRUE, ESTIMATED, _THIRD), strict=True))
    groups = [(f"{b} m", partial(_has_baseline, b), colour) for b, colour in colours.items()]
    return Reproduction(
        name="desaxe2018-fig7",
        title="Fig. 7: sensitivity to the slip angle, rear-facing",
        source=SOURCE,
        comparisons=comparisons,
        notes=(_SIGN, *unfinished(len(results) // 2, len(points))),
        interrupted=len(results) // 2 < len(points),
        data=log_of(results),
        draw=lambda: draw_panels(results, "slip", "trailer slip angle [°]", groups, band=(0.01, 0.03), limit=16.0),
    )


def fig8(quick: bool, progress: Progress) -> Reproduction:
    """Errors and matches over the density of the scenery, rear- and side-facing."""
    points = [Point(facing=facing, density=d) for facing in ("rear", "left") for d in (0.0, 0.5, 1.0)]
    results = outcomes(points, quick=quick, progress=progress)

    def rms(facing: Facing, density: float, odometry: str = "viso2") -> float:
        return most(results, "rms", lambda p: p.facing == facing and p.density == density, odometry)

    def ratio(facing: Facing) -> float:
        full = rms(facing, 1.0)
        return rms(facing, 0.0) / full if full > 0.0 else math.nan

    comparisons = [
        compared("rear, 100 %: RMS error", "0.01–0.03", rms("rear", 1.0)),
        compared("rear, 0 %: RMS error", "about the same", rms("rear", 0.0)),
        compared("side, 100 %: RMS error", "", rms("left", 1.0)),
        compared("side, 0 %: RMS error", "", rms("left", 0.0)),
        compared("rear: RMS error at 0 % over that at 100 %", "1", ratio("rear"), "-"),
        compared("side: RMS error at 0 % over that at 100 %", "2", ratio("left"), "-"),
        compared("fewest matches at 0 %", "> 250", least(results, "matches", lambda p: p.density == 0.0), "-"),
        compared("keyframe, rear, 0 %: RMS error", "", rms("rear", 0.0, "keyframe")),
        compared("keyframe, side, 0 %: RMS error", "", rms("left", 0.0, "keyframe")),
        compared("keyframe, side, 100 %: RMS error", "", rms("left", 1.0, "keyframe")),
    ]
    return Reproduction(
        name="desaxe2018-fig8",
        title="Fig. 8: sensitivity to the density of the scenery",
        source=SOURCE,
        comparisons=comparisons,
        notes=(_SIGN, *unfinished(len(results) // 2, len(points))),
        interrupted=len(results) // 2 < len(points),
        data=log_of(results),
        draw=lambda: draw_panels(results, "density", "density of the scenery [-]", _SIDES),
    )


_SIGN: Final = (
    "Errors are against the exact off-tracking. Numbers without a name belong to viso2, the paper's odometry. keyframe "
    "is this project's own odometry on the same images. Side-facing cameras look to the left."
)
_RANGE: Final = (
    "viso2 searches disparities up to 200 px, so it sees nothing nearer than 2.8 baselines: 14 m at a baseline of 5 m. "
    "Buckets of 50 x 50 px with two matches each limit the number of matches to 432."
)

_DRIVES: Final[dict[str, Choice]] = {
    "rear": lambda p: p.facing == "rear",
    "side": lambda p: p.facing == "left",
    "rear, up to 2.5 m": lambda p: p.facing == "rear" and p.baseline <= 2.5,
    "side, up to 2.5 m": lambda p: p.facing == "left" and p.baseline <= 2.5,
    "rear, beyond 2.5 m": lambda p: p.facing == "rear" and p.baseline > 2.5,
    "side, beyond 2.5 m": lambda p: p.facing == "left" and p.baseline > 2.5,
}
_SIDES: Final = (("rear", _DRIVES["rear"], TRUE), ("side", _DRIVES["side"], ESTIMATED))


def _has_baseline(baseline: float, p: Point) -> bool:
    return p.baseline == baseline


def _usual(baseline: float, p: Point) -> bool:
    return p.baseline == baseline and p.slip <= 16.0


_POINT: Final = Point(facing="left", baseline=1.5, slip=5.0)
_SEEDS: Final = (1, 2, 3, 4, 5)  # drift is random: the worst of these is shown
_LENGTH: Final = 14.0  # of the path that the off-tracking depends on [m]


def fig9(quick: bool, progress: Progress) -> Reproduction:
    """Off-tracking of side-facing cameras over time, and the motion along their optical axis."""
    base = _POINT.case(quick=quick)
    cases = [dataclasses.replace(base, seed=seed) for seed in (_SEEDS[:2] if quick else _SEEDS)]
    drives = driven(cases, progress)
    worst = max(drives, key=lambda one: metrics.peak(one.error("viso2")))
    return Reproduction(
        name="desaxe2018-fig9",
        title="Fig. 9: temporary drift, side-facing, 5 degrees of slip, baseline 1.5 m",
        source=SOURCE,
        comparisons=[
            compared("error in the region of drift", "0.08", metrics.peak(worst.error("viso2"))),
            compared("error of the motion along the optical axis, RMS", "", metrics.rms(_axial_error(worst, "viso2"))),
            compared(
                "share of the off-tracking error that these errors explain",
                "comparable",
                100.0 * _explained(worst),
                "%",
            ),
            compared("largest error over all drives", "< 0.15", max(metrics.peak(d.error("viso2")) for d in drives)),
            compared("RMS error over all drives", "", metrics.rms(np.concatenate([d.error("viso2") for d in drives]))),
            compared(
                "keyframe: largest error over all drives", "", max(metrics.peak(d.error("keyframe")) for d in drives)
            ),
        ],
        notes=(
            "Drift is random, in the paper and here. Of several random worlds, the one with the largest error "
            "is shown.",
            "The explained share is the squared correlation of the off-tracking error and the errors of the motion "
            "along the optical axis, summed over the last 14 m.",
            *unfinished(len(drives), len(cases)),
        ),
        interrupted=len(drives) < len(cases),
        data=_log(worst),
        draw=lambda: _drawn(worst),
    )


def _axial_error(one: Drive, odometry: str) -> FloatArray:
    """Estimated minus true motion along the optical axis of left-facing cameras [m]."""
    return one.tracks[odometry].lateral - one.lateral


def _summed(one: Drive) -> FloatArray:
    """Errors of the motion along the optical axis, summed over the last trailer length [m]."""
    errors = np.nan_to_num(_axial_error(one, "viso2"))
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


def _explained(one: Drive) -> float:
    """Squared correlation of the off-tracking error and the summed errors of the motion."""
    error, summed = one.error("viso2"), _summed(one)
    known = np.isfinite(error)
    if min(np.ptp(error[known]), np.ptp(summed[known])) == 0.0:  # no variation to explain, or none to explain it
        return math.nan
    return float(np.corrcoef(error[known], summed[known])[0, 1] ** 2)


def _log(one: Drive) -> Log:
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


def _drawn(one: Drive) -> Figure:
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
