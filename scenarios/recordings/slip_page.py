"""The report of a rover's recording."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from scenarios.player.encoding import encoded
from scenarios.recordings.slip_estimation import SlipEstimation
from scenarios.recordings.slip_playback import slip_playback
from scenarios.report.numbers import number_cards, number_table
from scenarios.report.page import Figure, Items, Page, Player, Section, outcome_verdict, software_section
from scenarios.report.plots import BAND, ESTIMATED, TRUE, drawn, zero_line
from scenarios.results.log import Log
from scenarios.results.manifest import versions

_LAGGED: Final = "#12935f"
_ON_CARDS: Final = ("slip.error_rms_deg", "slip.mean_deg", "slip.valid_fraction", "timing.estimator_ms_per_image")


def report_page(estimation: SlipEstimation, numbers: dict[str, Any]) -> str:
    """The page as HTML; ``numbers`` is the summary."""
    name = numbers["recording"]
    playback = Section("Playback", content=[Player(encoded(slip_playback(estimation, name)))])
    sections = [
        *([playback] if len(estimation.log) > 1 else []),
        Section(
            "Slip angle", "Angle from the body's axis to the direction of travel, + left.", [_slip(estimation.log)]
        ),
    ]
    if estimation.dropped:
        dropped = [f"image {k}: {reason}" for k, reason in estimation.dropped.items()]
        sections.append(Section("Images that could not be used", content=[Items(dropped)]))
    sections += [Section("All numbers", content=[number_table(numbers)]), software_section(versions())]
    return Page(
        title=f"{name} · slip angle",
        heading=name,
        subtitle=f"{numbers['frames']['images']} images · estimator {estimation.estimator}",
        verdict=outcome_verdict(estimation.outcome),
        cards=number_cards(numbers, _ON_CARDS),
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
