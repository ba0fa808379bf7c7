"""The report of a recording of stereo images."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from scenarios.player.encoding import encoded
from scenarios.recordings import recording_figures as figures
from scenarios.recordings.estimation import Estimation, FrameEstimate
from scenarios.recordings.left_images import camera_frame
from scenarios.recordings.recording_playback import recording_playback
from scenarios.report.flow import flow_photos
from scenarios.report.numbers import number_cards, number_table
from scenarios.report.page import Items, Page, Player, Section, outcome_verdict, software_section
from scenarios.results.log import Log
from scenarios.results.manifest import versions
from vehicle.clock import TICK

_LISTED = 50  # dropped frames named on the page; the summary names all

_ON_CARDS: Final = (
    "off_tracking.estimate_error_rms_m",
    "off_tracking.rms_m",
    "odometry.drift_percent",
    "timing.odometry_ms_per_frame",
)


def report_page(estimation: Estimation, log: Log, numbers: dict[str, Any]) -> str:
    """The page as HTML; ``numbers`` is the summary."""
    recording, c = estimation.recording, estimation.recording.calibration
    name = recording.sequence.directory.resolve().name
    return Page(
        title=f"{name} · off-tracking",
        heading=name,
        subtitle=(
            f"{len(estimation.frames)} stereo frames of {c.width}×{c.height} px in "
            f"{numbers['frames']['duration_s']:.1f} s · baseline {c.baseline:.3g} m · "
            f"follow point {recording.follow_distance:g} m behind the hitch · odometry {numbers['odometry']['name']}"
        ),
        verdict=outcome_verdict(estimation.outcome),
        cards=number_cards(numbers, _ON_CARDS),
        sections=list(_sections(estimation, log, numbers)),
    ).html()


def _sections(estimation: Estimation, log: Log, numbers: dict[str, Any]) -> Iterator[Section]:
    if numbers["warnings"]:
        yield Section("Warnings", content=[Items(numbers["warnings"])])
    if estimation.recording.assumed:
        yield Section("Assumed values", _ASSUMED, [Items(estimation.recording.assumed)])
    if len(log) > 1:
        yield from _drawn(estimation, log)
    if numbers["dropped_frames"] or numbers["notes"]:
        yield Section("Notes on the recording", content=[Items(_notes(numbers))])
    yield Section("All numbers", content=[number_table(numbers)])
    yield software_section(versions())


def _drawn(estimation: Estimation, log: Log) -> Iterator[Section]:
    yield Section("Playback", content=[Player(encoded(recording_playback(estimation, log)))])
    yield Section("Trajectory", _TRAJECTORY, [figures.plan_view(estimation)])
    yield Section("Off-tracking", _OFF_TRACKING, [figures.off_tracking(log)])
    if np.isfinite(log["off_tracking_poses"]).any():
        yield Section("Error against the recorded poses", _ERROR, [figures.error(log)])
    yield Section("Features and health", _FEATURES, [figures.features(log)])
    if "right_yaw" in log:
        yield Section("Rotation of the right camera", _ROTATION, [figures.right_rotation(log)])
    frame = _shown_frame(estimation)
    if frame is not None:
        try:
            shown = [flow_photos(camera_frame(estimation, frame))]
        except ValueError:  # the image has disappeared since
            shown = []
        yield Section("Image of the left camera", _caption(frame), shown)


_ASSUMED: Final = (
    "The recording does not state these values, and off-tracking depends on them. The option in brackets sets each."
)
_TRAJECTORY: Final = "Seen from above, in the trailer's frame at the first image. The dot marks the start."
_OFF_TRACKING: Final = (
    "Lateral distance from the follow point to the hitch's path, in the trailer's frame. It is known once the trailer "
    "has driven its own length."
)
_ERROR: Final = "About 95 % of the errors lie inside the band if the estimator states its standard deviation correctly."
_ROTATION: Final = "Change since the calibration, estimated while driving. The bands are ±2 stated standard deviations."
_FEATURES: Final = "Features matched in all images of a frame, and the inliers: matches that agree on one motion."


def _notes(numbers: dict[str, Any]) -> list[str]:
    dropped = [f"frame {entry['frame']} dropped: {entry['reason']}" for entry in numbers["dropped_frames"]]
    more = len(dropped) - _LISTED
    return [*numbers["notes"], *dropped[:_LISTED], *([f"and {more} more, see summary.json"] if more > 0 else [])]


def _shown_frame(estimation: Estimation) -> FrameEstimate | None:
    """The frame with the most tracks in the middle half of those with tracks: neither standing still nor lost."""
    tracked = [frame for frame in estimation.frames if len(frame.tracks)]
    middle = tracked[len(tracked) // 4 : 1 + (3 * len(tracked)) // 4]
    return max(middle, key=lambda frame: len(frame.tracks), default=None)


def _caption(frame: FrameEstimate) -> str:
    counts = f": {frame.motion.matches} matches, {frame.motion.inliers} of them inliers" if frame.motion else ""
    return (
        f"{frame.files.left.name}, {frame.files.tick * TICK:.1f} s after the first frame{counts}. "
        "Each stroke runs from a feature's position in the previous frame to its position in this one."
    )
