"""Figs 6 to 8 of de Saxe 2018: sensitivities of the off-tracking error, in a rendered world with perfect cameras.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 3: the trailer moves 100 m straight ahead at 5 m/s and a constant slip angle.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Final

import numpy as np

from scenarios.progress import Progress
from scenarios.report.plots import ESTIMATED, TRUE
from scenarios.reproduce.desaxe2018_drive import unfinished
from scenarios.reproduce.desaxe2018_outcomes import (
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
from scenarios.reproduce.figure import Reproduction, compared

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
