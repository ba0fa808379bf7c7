"""The report of a recording: one HTML page that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Any, Final

import cv2
import numpy as np

from scenarios.recordings import recording_figures as figures
from scenarios.recordings.estimation import Estimation, FrameEstimate
from scenarios.recordings.images import read_grey
from scenarios.report.numbers import Shown, cards_html, table_html
from scenarios.report.page import html_page, section_html
from scenarios.report.run_page import camera_svg
from scenarios.results.log import Log
from scenarios.results.run import CameraFrame, versions
from vehicle.clock import TICK

_LISTED = 50  # dropped frames named on the page; the summary names all

_NUMBERS: Final = (
    Shown("off_tracking", "estimate_error_rms_m", "Error, RMS", "mm", 1e3, 1,
          "How far the estimated off-tracking typically is from that of the recording's own poses."),
    Shown("off_tracking", "estimate_error_max_m", "Error, largest", "mm", 1e3, 1, "The worst single estimate."),
    Shown("off_tracking", "within_2_5_sigma", "Errors within 2.5 σ", "%", 100, 1,
          "Share of the errors below 2.5 stated standard deviations: 95 % or more if the estimator knows itself."),
    Shown("off_tracking", "rms_m", "Off-tracking, RMS", "m", 1, 3,
          "How far the hitch's path typically lies beside the follow point."),
    Shown("off_tracking", "max_m", "Off-tracking, largest", "m", 1, 3, "The largest such distance."),
    Shown("off_tracking", "std_mean_m", "Stated standard deviation", "mm", 1e3, 1, "Mean over the estimates."),
    Shown("off_tracking", "valid_fraction", "Valid estimates", "%", 100, 1,
          "Share of the frames with a usable estimate, once the trailer had driven its own length."),
    Shown("odometry", "distance_m", "Way driven", "m", 1, 1, "Length of the hitch's path, by the odometry."),
    Shown("odometry", "matches_mean", "Matches per frame", "", 1, 0, "Features found again, on average."),
    Shown("odometry", "inliers_mean", "Inliers per frame", "", 1, 0, "Those of them that agree on one motion."),
    Shown("odometry", "degraded_frames", "Degraded frames", "", 1, 0, "Frames whose motion is doubtful."),
    Shown("odometry", "lost_frames", "Lost frames", "", 1, 0, "Frames from which no motion could be found."),
    Shown("frames", "dropped", "Dropped frames", "", 1, 0, "Frames whose images were missing or broken."),
    Shown("odometry", "drift_percent", "Drift over the trailer's length", "%", 1, 3,
          "Position error over one follow distance, as a share of it."),
    Shown("odometry", "drift_deg_per_m", "The same in rotation", "°/m", 1, 5, "Angle error over the same way."),
    Shown("kitti", "drift_percent", "Drift as KITTI defines it", "%", 1, 3,
          "Position error over all stretches of 100, 200, … 800 m that the way was long enough for."),
    Shown("kitti", "drift_deg_per_m", "The same in rotation", "°/m", 1, 5, "Angle error over the same stretches."),
    Shown("timing", "odometry_ms_per_frame", "Odometry per frame", "ms", 1, 1, "Computing time on this machine."),
)  # fmt: skip
_ON_CARDS: Final = ("estimate_error_rms_m", "rms_m", "drift_percent", "odometry_ms_per_frame")
_CARDS: Final = tuple(number for number in _NUMBERS if number.name in _ON_CARDS)


def report_page(estimation: Estimation, log: Log, numbers: dict[str, Any]) -> str:
    """The whole page; ``numbers`` is the summary."""
    name = estimation.recording.sequence.directory.resolve().name
    body = "\n".join([_heading(estimation, numbers), cards_html(numbers, _CARDS), *_sections(estimation, log, numbers)])
    return html_page(f"{name} · off-tracking · offtrack", body)


def _heading(estimation: Estimation, numbers: dict[str, Any]) -> str:
    recording = estimation.recording
    good = " completed" if estimation.outcome == "completed" else ""
    c = recording.calibration
    return (
        f"<header>\n<h1>{escape(recording.sequence.directory.resolve().name)}"
        f'<span class="outcome{good}">{escape(estimation.outcome)}</span></h1>\n'
        f"<p>{len(estimation.frames)} stereo frames of {c.width}×{c.height} px in "
        f"{numbers['frames']['duration_s']:.1f} s · baseline {c.baseline:.3g} m · "
        f"follow point {recording.follow_distance:g} m behind the hitch · "
        f"odometry {escape(numbers['odometry']['name'])}</p>\n</header>"
    )


def _sections(estimation: Estimation, log: Log, numbers: dict[str, Any]) -> Iterator[str]:
    if estimation.recording.assumed:
        told = (
            "Nothing in the recording says so, and off-tracking depends on it; name in brackets the option to set it."
        )
        yield section_html("Assumed", told, _listed(estimation.recording.assumed))
    if len(log) > 1:
        yield from _drawn(estimation, log)
    if numbers["dropped_frames"] or numbers["notes"]:
        yield section_html("Noticed in the recording", "", _listed(_noticed(numbers)))
    yield section_html("All numbers", "", table_html(numbers, _NUMBERS))
    yield section_html("Made with", ", ".join(f"{name} {version}" for name, version in versions().items()))


def _drawn(estimation: Estimation, log: Log) -> Iterator[str]:
    yield section_html("Trajectory", _TRAJECTORY, figures.plan_view(estimation))
    yield section_html("Off-tracking", _OFF_TRACKING, figures.off_tracking(log))
    if np.isfinite(log["off_tracking_poses"]).any():
        yield section_html("Error against the recording's poses", _ERROR, figures.error(log))
    yield section_html("Features and health", _FEATURES, figures.features(log))
    if "right_yaw" in log:
        yield section_html("Rotation of the right camera", _ROTATION, figures.right_rotation(log))
    frame = _most_telling(estimation)
    if frame is not None:
        yield section_html("What the left camera saw", _caption(frame), _camera(estimation, frame))


_TRAJECTORY: Final = "From above, in the frame that the trailer had at the first image; the dot marks the start."
_OFF_TRACKING: Final = (
    "Lateral distance of the hitch's path from the follow point, seen from the trailer. It starts once the trailer has "
    "driven its own length."
)
_ERROR: Final = "About 95 of 100 errors should lie inside the band; if they do, the estimator knows how good it is."
_ROTATION: Final = "Since its calibration, as it was learned while driving; the bands are ±2 σ as stated."
_FEATURES: Final = "Features found again in the images of a frame, and those of them that agree on one motion."


def _noticed(numbers: dict[str, Any]) -> list[str]:
    dropped = [f"frame {entry['frame']} dropped: {entry['reason']}" for entry in numbers["dropped_frames"]]
    more = len(dropped) - _LISTED
    return [*numbers["notes"], *dropped[:_LISTED], *([f"and {more} more, see summary.json"] if more > 0 else [])]


def _listed(lines: list[str] | tuple[str, ...]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _most_telling(estimation: Estimation) -> FrameEstimate | None:
    """The frame with the most tracks in the middle half of those there are: neither standing still nor lost."""
    seen = [frame for frame in estimation.frames if len(frame.tracks)]
    middle = seen[len(seen) // 4 : 1 + (3 * len(seen)) // 4]
    return max(middle, key=lambda frame: len(frame.tracks), default=None)


def _caption(frame: FrameEstimate) -> str:
    counts = f"{frame.motion.matches} matches, {frame.motion.inliers} of them inliers" if frame.motion else ""
    return (
        f"{escape(frame.files.left.name)}, {frame.files.tick * TICK:.1f} s after the first frame: {counts}. "
        "Each stroke leads from where a feature was a frame ago to where it is."
    )


def _camera(estimation: Estimation, frame: FrameEstimate) -> str:
    try:
        return camera_svg(camera_frame(estimation, frame))
    except ValueError:  # gone since it was estimated from
        return ""


def camera_frame(estimation: Estimation, frame: FrameEstimate) -> CameraFrame:
    """The left image, rectified, with its tracks, read once more.

    Raises:
        ValueError: if it can not be read any more.
    """
    image = estimation.recording.rectified_left(read_grey(frame.files.left))
    jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
    motion = frame.motion
    return CameraFrame(
        tick=frame.files.tick,
        jpeg=jpeg,
        tracks=frame.tracks,
        matches=motion.matches if motion else 0,
        inliers=motion.inliers if motion else 0,
    )
