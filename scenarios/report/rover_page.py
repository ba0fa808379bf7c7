"""The report of a rover's run: one HTML page that needs nothing but itself."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from html import escape
from typing import Final

import numpy as np

from scenarios.report import rover_figures as figures
from scenarios.report.numbers import Shown, cards_html, table_html
from scenarios.report.page import html_page, section_html
from scenarios.report.trace_view import traced
from scenarios.results.rover import RoverResult, rover_manifest
from scenarios.results.run import Summary

_NUMBERS: Final = (
    Shown("slip", "cross_track_rms_m", "Beside the path, RMS", "mm", 1e3, 1,
          "How far the rover typically was beside its path."),
    Shown("slip", "cross_track_max_m", "Beside the path, largest", "mm", 1e3, 1, "The largest such distance."),
    Shown("slip", "error_rms_deg", "Error of the slip angle, RMS", "°", 1, 2,
          "How far the estimate typically is from the truth at the moment the picture was taken."),
    Shown("slip", "error_max_deg", "The same, largest", "°", 1, 2, "The worst single estimate."),
    Shown("slip", "lagged_error_rms_deg", "Error of the estimate some seconds later, RMS", "°", 1, 2,
          "What is known of a moment's slip once more of its trace has been seen."),
    Shown("slip", "valid_fraction", "Frames with an estimate", "%", 100, 1,
          "Share of the pictures in which a trace was found."),
    Shown("slip", "within_2_5_sigma", "Errors within 2.5 σ", "%", 100, 1,
          "95 % or more if the estimator knows how good it is."),
    Shown("slip", "true_mean_deg", "True slip angle, mean", "°", 1, 2,
          "Direction of travel against the body's axis, + left."),
    Shown("slip", "reference_error_rms_deg", "Error of laser tracker and compass, RMS", "°", 1, 2,
          "The instruments that the field tests of the paper judged by."),
    Shown("position", "distance_m", "Way driven", "m", 1, 2, "Length of the way that the rover really made."),
    Shown("position", "wheels_error_m", "Position error by wheels and compass", "m", 1, 3, "At the end of the run."),
    Shown("position", "corrected_error_m", "The same with the slip angle", "m", 1, 3, "At the end of the run."),
    Shown("wheels", "slip_ratio_mean", "Longitudinal slip, mean", "%", 100, 1, "Of all wheels."),
    Shown("wheels", "sinkage_max_m", "Deepest sinkage", "mm", 1e3, 1, "Of any wheel."),
    Shown("timing", "realtime_factor", "Speed of the simulation", "× real time", 1, 2,
          "Above 1 it ran faster than reality."),
)  # fmt: skip
_ON_CARDS: Final = ("cross_track_rms_m", "error_rms_deg", "true_mean_deg", "realtime_factor")
_CARDS: Final = tuple(number for number in _NUMBERS if number.name in _ON_CARDS)
_STYLE: Final = (
    ".traces { display: grid; gap: .8rem; grid-template-columns: 1fr 1fr 1fr; } "
    ".traces img { width: 100%; border-radius: 6px; }"
)
_FRAMES: Final = (0.15, 0.5, 0.85)  # of the run, shown in the page


def rover_report_html(result: RoverResult, summary: Summary) -> str:
    """The whole page."""
    body = "\n".join([_heading(result), cards_html(summary, _CARDS), *_sections(result, summary)])
    return html_page(f"{result.scenario} · offtrack", body, _STYLE)


def _sections(result: RoverResult, summary: Summary) -> Iterator[str]:
    if len(result.log) > 1:
        yield from _drawn(result)
    yield section_html("All numbers", "", table_html(summary, _NUMBERS))
    timing = result.timing
    yield section_html(
        "Where the time went",
        f"{timing.simulated_s:.1f} s of driving took {timing.wall_s:.1f} s of computing: "
        f"physics {timing.physics_s:.1f} s, sand and camera {timing.render_s:.1f} s, "
        f"slip estimator {timing.odometry_s:.1f} s, of it {timing.odometry_beside_s:.1f} s beside the rest.",
    )
    yield (
        f"<section><details><summary>Resolved scenario</summary><pre>{escape(result.scenario_toml)}</pre></details>"
        f"</section><section><details><summary>Where these numbers come from</summary><pre>"
        f"{escape(str(rover_manifest(result)))}</pre></details></section>"
    )


def _drawn(result: RoverResult) -> Iterator[str]:
    log = result.log
    yield section_html("Plan view", "The path, the rover's way, and where its instruments believed it to be.",
                       figures.plan(result))  # fmt: skip
    if result.frames:
        words = "The trace behind the left rear wheel; the line is where the estimator sees its middle."
        yield section_html("What the camera saw", words, _pictures(result))
    yield section_html("Slip angle", "Between the way and the body's axis, + left.", figures.slip(result))
    if np.isfinite(result.slip_error).any():
        yield section_html("Error of the estimate", "About 95 of 100 errors should lie inside the band.",
                           figures.error(result))  # fmt: skip
    yield section_html("Beside the path", "", figures.cross_track(result))
    if np.isfinite(log["x_corrected"]).any():
        words = "Dead reckoning that takes the wheels at their word, and one that turns their way by the slip angle."
        yield section_html("Position error", words, figures.position(result))
    yield section_html("Wheels", "Longitudinal slip: encoders count more way than there was.", figures.wheels(result))


def _pictures(result: RoverResult) -> str:
    shown = [result.frames[round(share * (len(result.frames) - 1))] for share in _FRAMES]
    images = "".join(
        f'<img alt="ground behind the wheel at {frame.tick / 1e3:.1f} s" '
        f'src="data:image/jpeg;base64,{base64.b64encode(traced(result, frame)).decode()}">'
        for frame in shown
    )
    return f'<div class="traces">{images}</div>'


def _heading(result: RoverResult) -> str:
    good = " completed" if result.outcome == "completed" else ""
    return (
        f'<header>\n<h1>{escape(result.scenario)}<span class="outcome{good}">{escape(result.outcome)}</span></h1>\n'
        f"<p>{escape(result.rover)} · seed {result.seed} · {result.timing.simulated_s:.1f} s simulated</p>\n</header>"
    )
