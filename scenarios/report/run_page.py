"""The report of a trailer's run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from scenarios.report import run_figures as figures
from scenarios.report.flow import flow_photos
from scenarios.report.numbers import ShownNumber, number_cards, number_table
from scenarios.report.page import Column, Page, Row, Section, Table, outcome_verdict
from scenarios.report.run_sections import provenance_sections, timing_section
from scenarios.results.numbers import Summary
from scenarios.results.run_result import CameraFrame, RunResult
from scenarios.results.summary import trailer_summaries
from scenarios.results.writer import manifest
from vehicle.clock import TICK

_NUMBERS: Final = (
    ShownNumber("off_tracking", "true_rms_m", "True off-tracking, RMS", "m", 1, 3,
          "Distance of the trailer's follow point from the path of its hitch."),
    ShownNumber("off_tracking", "true_max_m", "True off-tracking, maximum", "m", 1, 3, "The largest such distance."),
    ShownNumber("off_tracking", "estimate_error_rms_m", "Estimate error, RMS", "mm", 1e3, 1,
          "Estimated minus true off-tracking when the image was taken."),
    ShownNumber("off_tracking", "estimate_error_max_m", "Estimate error, maximum", "mm", 1e3, 1,
          "The largest error of a single estimate."),
    ShownNumber("off_tracking", "valid_fraction", "Valid estimates", "%", 100, 1,
          "Share of usable estimates, counted from when the trailer has driven its own length."),
    ShownNumber("swept_path", "max_width_m", "Swept width", "m", 1, 2,
          "The widest strip of ground that the bodies of the combination cover."),
    ShownNumber("swept_path", "min_inner_radius_m", "Inner radius", "m", 1, 2,
          "The smallest distance of any body from the centre of the roundabout."),
    ShownNumber("swept_path", "tail_swing_m", "Tail swing", "m", 1, 3,
          "The largest distance of a rear corner beyond the straight before or after the turn."),
    ShownNumber("swept_path", "tail_swing_entry_m", "Tail swing at entry", "m", 1, 3,
          "Beyond the straight before the first turn."),
    ShownNumber("swept_path", "tail_swing_exit_m", "Tail swing at exit", "m", 1, 3,
          "Beyond the straight after the last turn."),
    ShownNumber("steer", "max_deg", "Trailer steer angle, maximum", "°", 1, 1,
          "The largest steer angle of any trailer axle."),
    ShownNumber("steer", "max_rate_deg_s", "Trailer steer rate, maximum", "°/s", 1, 1,
          "The largest steer rate of any trailer axle."),
    ShownNumber("tyres", "friction_used_max", "Friction used", "%", 100, 0,
          "The largest share of the available friction that any tyre used."),
    ShownNumber("odometry", "matches_mean", "Matches per frame", "", 1, 0,
          "Features matched in all images of a frame, on average."),
    ShownNumber("odometry", "inliers_mean", "Inliers per frame", "", 1, 0,
          "Matches that agree on one motion of the camera, on average."),
    ShownNumber("odometry", "lost_frames", "Lost frames", "", 1, 0, "Frames from which no motion could be estimated."),
    ShownNumber("odometry", "drift_percent", "Drift", "%", 1, 3,
          "Position error of the odometry over one follow distance, as a share of that distance."),
    ShownNumber("timing", "realtime_factor", "Simulation speed", "× real time", 1, 2,
          "Simulated time divided by computing time."),
)  # fmt: skip
_GROUPS: Final = {
    "off_tracking": "Off-tracking",
    "swept_path": "Swept path",
    "steer": "Steering",
    "tyres": "Tyres",
    "odometry": "Visual odometry",
    "timing": "Timing",
}
_ON_CARDS: Final = ("true_rms_m", "estimate_error_rms_m", "max_width_m", "realtime_factor")


def report_html(result: RunResult, summary: Summary) -> str:
    """The page as HTML; ``summary`` is the run in numbers as :func:`scenarios.results.summary.summary` gives it."""
    combination = " + ".join(unit.name for unit in result.units)
    return Page(
        title=result.scenario,
        heading=result.scenario,
        subtitle=f"{combination} · seed {result.seed} · {result.timing.simulated_s:.1f} s simulated",
        verdict=outcome_verdict(result.outcome),
        cards=number_cards(summary, _NUMBERS, _ON_CARDS),
        sections=list(_sections(result, summary)),
    ).html()


def _sections(result: RunResult, summary: Summary) -> Iterator[Section]:
    if len(result.log) > 1:
        yield from _drawn(result)
    else:
        yield Section("Nothing to draw", "The run ended before the vehicle had moved.")
    yield Section("All numbers", content=[number_table(summary, _NUMBERS, _GROUPS)])
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
    for number in _NUMBERS:
        key = f"steer_{number.name}" if number.group == "steer" else number.name
        values = [numbers.get(key) for numbers in of_each.values()]
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
