"""The report of a rover's run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from scenarios.report import rover_figures as figures
from scenarios.report.numbers import ShownNumber, number_cards, number_table
from scenarios.report.page import Page, Photo, Photos, Section, outcome_verdict
from scenarios.report.run_sections import provenance_sections, timing_section
from scenarios.report.trace_view import traced
from scenarios.results.numbers import Summary
from scenarios.results.rover import RoverResult
from scenarios.results.writer import manifest
from vehicle.clock import TICK

_NUMBERS: Final = (
    ShownNumber("slip", "cross_track_rms_m", "Cross-track error, RMS", "mm", 1e3, 1,
          "Lateral distance of the rover from its path."),
    ShownNumber("slip", "cross_track_max_m", "Cross-track error, maximum", "mm", 1e3, 1, "The largest such distance."),
    ShownNumber("slip", "error_rms_deg", "Slip angle error, RMS", "°", 1, 2,
          "Estimated minus true slip angle at the time the image was taken."),
    ShownNumber("slip", "error_max_deg", "Slip angle error, maximum", "°", 1, 2,
          "The largest error of a single estimate."),
    ShownNumber("slip", "lagged_error_rms_deg", "Error of the later estimate, RMS", "°", 1, 2,
          "Error of the slip angle estimated some seconds later, once more of its trace has been seen."),
    ShownNumber("slip", "valid_fraction", "Images with an estimate", "%", 100, 1,
          "Share of the images in which a trace was found."),
    ShownNumber("slip", "within_2_5_sigma", "Errors within 2.5 σ", "%", 100, 1,
          "Share of the errors below 2.5 stated standard deviations: 95 % or more if these are correct."),
    ShownNumber("slip", "true_mean_deg", "True slip angle, mean", "°", 1, 2,
          "Direction of travel relative to the body's axis, + left."),
    ShownNumber("slip", "reference_error_rms_deg", "Error of laser tracker and compass, RMS", "°", 1, 2,
          "Slip angle error of the reference instruments of the paper's field tests."),
    ShownNumber("position", "distance_m", "Distance driven", "m", 1, 2, "Length of the path that the rover drove."),
    ShownNumber("position", "wheels_error_m", "Position error, wheels and compass", "m", 1, 3,
          "Error of dead reckoning at the end of the run."),
    ShownNumber("position", "corrected_error_m", "Position error, corrected", "m", 1, 3,
          "The same for dead reckoning corrected by the slip angle."),
    ShownNumber("wheels", "slip_ratio_mean", "Longitudinal slip, mean", "%", 100, 1, "Of all wheels."),
    ShownNumber("wheels", "sinkage_max_m", "Sinkage, maximum", "mm", 1e3, 1, "Of any wheel."),
    ShownNumber("timing", "realtime_factor", "Simulation speed", "× real time", 1, 2,
          "Simulated time divided by computing time."),
)  # fmt: skip
_ON_CARDS: Final = ("cross_track_rms_m", "error_rms_deg", "true_mean_deg", "realtime_factor")
_SHOWN: Final = (0.15, 0.5, 0.85)  # frames on the page, as shares of the run


def rover_report_html(result: RoverResult, summary: Summary) -> str:
    """The page as HTML."""
    return Page(
        title=result.scenario,
        heading=result.scenario,
        subtitle=f"{result.rover} · seed {result.seed} · {result.timing.simulated_s:.1f} s simulated",
        verdict=outcome_verdict(result.outcome),
        cards=number_cards(summary, _NUMBERS, _ON_CARDS),
        sections=list(_sections(result, summary)),
    ).html()


def _sections(result: RoverResult, summary: Summary) -> Iterator[Section]:
    if len(result.log) > 1:
        yield from _drawn(result)
    yield Section("All numbers", content=[number_table(summary, _NUMBERS)])
    yield timing_section(result.timing, ("physics", "sand and camera", "slip estimator"))
    yield from provenance_sections(result.scenario_toml, manifest(result))


def _drawn(result: RoverResult) -> Iterator[Section]:
    yield Section("Plan view", "The path to follow, the path driven, and two estimates of it by dead reckoning.",
                  [figures.plan(result)])  # fmt: skip
    if result.frames:
        wheel = result.rig.wheels[result.rig.watched].name
        text = (
            f"Ground behind the {wheel.replace('_', ' ')} wheel. Blue: true direction of travel. Orange: direction "
            "estimated from the trace."
        )
        yield Section("Camera images", text, [_photos(result)])
    yield Section("Slip angle", "Angle from the body's axis to the direction of travel, + left.",
                  [figures.slip(result)])  # fmt: skip
    if np.isfinite(result.slip_error).any():
        text = "About 95 % of the errors lie inside the band if the estimator states its standard deviation correctly."
        yield Section("Error of the estimate", text, [figures.error(result)])
    yield Section("Cross-track error", "Lateral distance of the rover from its path.", [figures.cross_track(result)])
    if np.isfinite(result.log["x_corrected"]).any():
        text = (
            "Dead reckoning by wheels and compass assumes that the rover moves along its axis. The corrected one turns "
            "each step by the estimated slip angle."
        )
        yield Section("Position error", text, [figures.position(result)])
    yield Section("Wheels", "Slip ratio: share of a wheel's rolling distance by which the rover does not advance.",
                  [figures.wheels(result)])  # fmt: skip


def _photos(result: RoverResult) -> Photos:
    shown = [result.frames[round(share * (len(result.frames) - 1))] for share in _SHOWN]
    size = result.rig.camera.width, result.rig.camera.height
    return Photos(
        [Photo(traced(result, one), size, f"ground behind the wheel at {one.tick * TICK:.1f} s") for one in shown]
    )
