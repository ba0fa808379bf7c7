"""The report of a rover's run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from scenarios.report import rover_figures as figures
from scenarios.report.numbers import number_table
from scenarios.report.page import Photo, Photos, Section
from scenarios.report.run_sections import provenance_sections, run_html, timing_section
from scenarios.report.trace_view import traced
from scenarios.results.manifest import manifest
from scenarios.results.numbers import Summary
from scenarios.results.rover import RoverResult
from vehicle.clock import TICK

_ON_CARDS: Final = ("slip.cross_track_rms_m", "slip.error_rms_deg", "slip.true_mean_deg", "timing.realtime_factor")
_SHOWN: Final = (0.15, 0.5, 0.85)  # frames on the page, as shares of the run


def rover_report_html(result: RoverResult, summary: Summary) -> str:
    """The page as HTML."""
    return run_html(result, result.rover, summary, _ON_CARDS, _sections(result, summary))


def _sections(result: RoverResult, summary: Summary) -> Iterator[Section]:
    if len(result.log) > 1:
        yield from _drawn(result)
    yield Section("All numbers", content=[number_table(summary)])
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
