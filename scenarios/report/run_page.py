"""The report of a trailer's run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from scenarios.player.encoding import encoded
from scenarios.player.trailer import trailer_playback
from scenarios.report import run_figures as figures
from scenarios.report.flow import flow_photos
from scenarios.report.numbers import groups, number_table
from scenarios.report.page import Column, Items, Player, Row, Section, Table
from scenarios.report.run_sections import provenance_sections, run_html, timing_section
from scenarios.results.manifest import manifest
from scenarios.results.numbers import Summary
from scenarios.results.run_result import CameraFrame, RunResult
from scenarios.results.summary import all_warnings, trailer_summaries
from vehicle.clock import TICK

_ON_CARDS: Final = (
    "off_tracking.true_rms_m",
    "off_tracking.estimate_error_rms_m",
    "swept_path.max_width_m",
    "timing.realtime_factor",
)


def report_html(result: RunResult, summary: Summary) -> str:
    """The page as HTML; ``summary`` is the run in numbers as :func:`scenarios.results.summary.summary` gives it."""
    return run_html(result, summary, _ON_CARDS, _sections(result, summary))


def _sections(result: RunResult, summary: Summary) -> Iterator[Section]:
    if warnings := all_warnings(result):
        yield Section("Warnings", content=[Items(warnings)])
    if len(result.log) > 1:
        yield Section("Playback", content=[Player(encoded(trailer_playback(result)))])
        yield from _drawn(result)
    else:
        yield Section("Nothing to draw", "The run ended before the vehicle had moved.")
    yield Section("All numbers", content=[number_table(summary)])
    if result.trailers_ahead:
        yield Section("Trailers", _TRAILERS, [_trailers(result)])
    yield timing_section(result.timing, ("physics", "rendering", "odometry"))
    yield from provenance_sections(result.scenario_toml, manifest(result))


def _drawn(result: RunResult) -> Iterator[Section]:
    yield Section("Plan view", _PLAN.format(result.follow_distance), [figures.plan_view(result)])
    yield Section("Off-tracking", _OFF_TRACKING, [figures.off_tracking(result)])
    if np.isfinite(result.signal("health")).any():
        yield Section("Error of the estimate", _ERROR, [figures.estimate_error(result)])
    else:
        yield Section("No estimate", "This run had no estimator of the off-tracking.")
    if result.steer_signals():
        yield Section("Steer angles", _STEER, [figures.steer(result)])
    if result.frames:
        frame = _shown_frame(result)
        yield Section("Camera image", _caption(frame), [flow_photos(frame)])
    else:
        yield Section("No camera images", "This run kept no camera images.")
    if np.isfinite(result.signal("matches")).any():
        yield Section("Features", _MATCHES, [figures.matches(result)])


_PLAN: Final = (
    "The follow point lies {:.1f} m behind the hitch. It should retrace the hitch's path; it does where orange covers "
    "blue."
)
_OFF_TRACKING: Final = (
    "Lateral distance from the follow point to the hitch's path, in the trailer's frame. It is known once the trailer "
    "has driven its own length. Each estimate is drawn at the time its image was taken."
)
_ERROR: Final = "About 95 % of the errors lie inside the band if the estimator states its standard deviation correctly."
_STEER: Final = "Solid: actual angles of the road wheels. Dashed: angles that the controller commanded."
_TRAILERS: Final = (
    "Each trailer follows its own hitch. The figures above show the last trailer. The off-tracking and steering in the "
    "table above belong to the trailer with the largest off-tracking."
)
_MATCHES: Final = "Features matched in all images of a frame, and the inliers: matches that agree on one motion."


def _trailers(result: RunResult) -> Table:
    """Off-tracking and steering of every watched trailer side by side."""
    of_each = trailer_summaries(result)
    rows: list[Row] = []
    for group, prefix in (("off_tracking", ""), ("steer", "steer_")):
        for name, number in groups()[group].numbers.items():
            values = [numbers.get(prefix + name) for numbers in of_each.values()]
            if any(value is not None for value in values):
                rows.append([number.label, *(number.text(value) for value in values)])
    return Table((Column("name"), *(Column("number", name) for name in of_each)), rows)


def _shown_frame(result: RunResult) -> CameraFrame:
    """The frame taken where the off-tracking was largest: in the middle of the turn, where the image flows most."""
    true = result.signal("off_tracking_true")
    if not np.isfinite(true).any():
        return result.frames[len(result.frames) // 2]
    worst = 1e3 * float(result.log["time"][np.nanargmax(np.abs(true))])
    return min(result.frames, key=lambda frame: abs(frame.tick - worst))


def _caption(frame: CameraFrame) -> str:
    time = f"{frame.tick * TICK:.1f} s"
    if not len(frame.tracks):
        return f"Left camera at {time}."
    return (
        f"Left camera at {time}, where the off-tracking was largest: {frame.matches} matches, {frame.inliers} of them "
        "inliers. Each stroke runs from a feature's position in the previous frame to its position in this one."
    )
