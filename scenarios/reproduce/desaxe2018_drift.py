"""Fig. 9 of de Saxe 2018: temporary drift, which ends once the trailer has travelled its own length.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018, section 3.2.4.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from scenarios.progress import Progress
from scenarios.report.plots import ESTIMATED, GREY, TRUE
from scenarios.reproduce.desaxe2018_drive import Drive, driven, unfinished
from scenarios.reproduce.desaxe2018_outcomes import SOURCE, Point
from scenarios.reproduce.figure import Reproduction, compared
from scenarios.results import metrics
from scenarios.results.log import Log, Signal
from vehicle.frames import FloatArray

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
