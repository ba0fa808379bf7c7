"""The report of a rover's recording."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from scenarios.recordings.slip_estimation import SlipEstimation
from scenarios.report.drawing import BAND, ESTIMATED, TRUE, drawn, zero_line
from scenarios.report.numbers import ShownNumber, number_cards, number_table
from scenarios.report.page import Figure, Items, Page, Section, outcome_verdict, software_section
from scenarios.results.log import Log
from scenarios.results.writer import versions

_LAGGED: Final = "#12935f"
_NUMBERS: Final = (
    ShownNumber("slip", "error_rms_deg", "Error, RMS", "°", 1, 2, "Estimated slip angle minus that of the recording."),
    ShownNumber("slip", "error_max_deg", "Error, maximum", "°", 1, 2, "The largest error of a single estimate."),
    ShownNumber("slip", "lagged_error_rms_deg", "Error of the later estimate, RMS", "°", 1, 2,
          "Error of the slip angle estimated some seconds later, once more of its trace has been seen."),
    ShownNumber("slip", "within_2_5_sigma", "Errors within 2.5 σ", "%", 100, 1,
          "Share of the errors below 2.5 stated standard deviations: 95 % or more if these are correct."),
    ShownNumber("slip", "mean_deg", "Slip angle, mean", "°", 1, 2, "Mean over the estimates, + left."),
    ShownNumber("slip", "max_deg", "Slip angle, maximum", "°", 1, 2, "The largest slip angle to either side."),
    ShownNumber("slip", "std_mean_deg", "Stated standard deviation", "°", 1, 2, "Mean over the estimates."),
    ShownNumber("slip", "valid_fraction", "Images with an estimate", "%", 100, 1,
          "Share of the usable images in which a trace was found."),
    ShownNumber("frames", "images", "Images", "", 1, 0, "Images of the recording that were read."),
    ShownNumber("frames", "dropped", "Dropped images", "", 1, 0, "Images that were missing or broken."),
    ShownNumber("frames", "duration_s", "Duration", "s", 1, 1, "From the first image to the last."),
    ShownNumber("timing", "estimator_ms_per_image", "Estimator per image", "ms", 1, 1,
          "Computing time on this machine."),
)  # fmt: skip
_ON_CARDS: Final = ("error_rms_deg", "mean_deg", "valid_fraction", "estimator_ms_per_image")


def report_page(estimation: SlipEstimation, numbers: dict[str, Any]) -> str:
    """The page as HTML; ``numbers`` is the summary."""
    name = numbers["recording"]
    sections = [
        Section("Slip angle", "Angle from the body's axis to the direction of travel, + left.", [_slip(estimation.log)])
    ]
    if estimation.dropped:
        dropped = [f"image {k}: {reason}" for k, reason in estimation.dropped.items()]
        sections.append(Section("Images that could not be used", content=[Items(dropped)]))
    sections += [Section("All numbers", content=[number_table(numbers, _NUMBERS)]), software_section(versions())]
    return Page(
        title=f"{name} · slip angle",
        heading=name,
        subtitle=f"{numbers['frames']['images']} images · estimator {estimation.estimator}",
        verdict=outcome_verdict(estimation.outcome),
        cards=number_cards(numbers, _NUMBERS, _ON_CARDS),
        sections=sections,
    ).html()


def _slip(log: Log) -> Figure:
    """The estimate with its band, the later estimate and the recording's own slip angle."""
    time, value, band = log["time"], np.degrees(log["slip_angle"]), 2.0 * np.degrees(log["slip_angle_std"])
    known = np.isfinite(value)
    with drawn("slip of a recording", 3.4) as (drawing, ax):
        ax.fill_between(
            time[known], (value - band)[known], (value + band)[known], color=BAND, linewidth=0.0, label="±2 σ stated"
        )
        ax.plot(time[known], value[known], ".", color=ESTIMATED, label="estimated")
        for name, colour, label in (
            ("slip_angle_lagged", _LAGGED, "estimated later"),
            ("slip_angle_reference", TRUE, "by the recording"),
        ):
            there = np.isfinite(log[name])
            if there.any():
                ax.plot(time[there], np.degrees(log[name][there]), color=colour, label=label)
        zero_line(ax)
        ax.set(xlabel="time [s]", ylabel="slip angle [°], + left")
        ax.margins(x=0.0)
    return drawing.content
