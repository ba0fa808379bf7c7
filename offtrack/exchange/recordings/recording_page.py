"""The report of a stereo recording, with its playback."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from offtrack.exchange.recordings import recording_pictures as figures
from offtrack.exchange.recordings.estimation import Estimation, FrameEstimate
from offtrack.exchange.recordings.recording_pictures import camera_frame
from offtrack.reports.camera_pictures import flow_photos
from offtrack.reports.page import Items, Page, Player, Section, outcome_verdict, software_section
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import (
    SERIES,
    Body,
    Camera,
    Chart,
    Curve,
    EstimatedPath,
    Line,
    Picture,
    Playback,
    PlayedRun,
    Reading,
    Trail,
    health_spans,
)
from offtrack.reports.sections import number_cards, number_table
from scenarios.results.log import Log
from scenarios.results.run_summary import versions
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_MOST_PICTURES = 240  # each is read and straightened again
_DEGREES = 180.0 / np.pi
_WIDTH, _HEIGHTS = 0.5, (0.3, 0.6)  # of the bar from hitch to follow point [m], for drawings only


def recording_playback(estimation: Estimation, log: Log) -> Playback:
    """Everything that a page shows of the recording over time."""
    recording, c = estimation.recording, estimation.recording.calibration
    follow = recording.follow_distance
    half = 0.5 * _WIDTH
    outline: FloatArray = np.array([[0.0, half], [0.0, -half], [-follow, -half], [-follow, half]])
    elapsed = _elapsed(log)
    true = estimation.true_X_S0S
    compared = bool(np.isfinite(log["off_tracking_poses"]).any())
    return Playback(
        title=recording.sequence.directory.name,
        runs=(
            PlayedRun(
                name=recording.sequence.directory.resolve().name,
                log=elapsed,
                bodies=(Body(name="trailer", outline=outline, wheels=(), pose=("x", "y", "psi"), heights=_HEIGHTS),),
                trails=(
                    Trail("path of the hitch, odometry", "true", 0),
                    Trail("path of the follow point, odometry", "estimated", 0, (-follow, 0.0)),
                ),
                estimated=EstimatedPath(
                    "estimated path of the hitch", 0, (-follow, 0.0), "off_tracking", "off_tracking_std", "health"
                ),
                spans=tuple(health_spans(elapsed, "health")),
                pictures=list(_pictures(estimation)),
                cameras=(Camera(0, c.X_SC, 0.5 * c.width / c.focal_length, 0.5 * c.height / c.focal_length),),
                lines=() if true is None else (Line("path of the hitch, recorded poses", "grey", true[:, :2, 3]),),
            ),
        ),
        charts=tuple(_charts(log, compared=compared)),
        readings=(
            Reading("off-tracking", "off_tracking", "m", 1.0, 3, "estimated"),
            Reading("its σ", "off_tracking_std", "mm", 1e3, 1, "estimated"),
            *((Reading("by the recorded poses", "off_tracking_poses", "m", 1.0, 3, "true"),) if compared else ()),
            Reading("speed", "v_x", "m/s", 1.0, 2),
            Reading("yaw rate", "yaw_rate", "°/s", _DEGREES, 2),
            Reading("inliers", "inliers", "-", 1.0, 0),
        ),
        nearest=60.0,
    )


def _elapsed(log: Log) -> Log:
    """The log with times since its first frame."""
    rows = log.rows.copy()
    at = log.names.index("time")
    rows[:, at] -= rows[0, at]
    return Log(log.signals, rows)


def _pictures(estimation: Estimation) -> Iterator[Picture]:
    usable = [frame for frame in estimation.frames if not frame.dropped]
    for frame in usable[:: max(1, -(-len(usable) // _MOST_PICTURES))]:
        try:
            shown = camera_frame(estimation, frame)
        except ValueError:  # the image has disappeared since
            continue
        yield Picture(frame.files.tick * TICK, shown.jpeg, shown.tracks, _picture_caption(frame))


def _picture_caption(frame: FrameEstimate) -> str:
    counts = f" · {frame.motion.inliers} inliers of {frame.motion.matches} matches" if frame.motion else ""
    return f"{frame.files.left.name}{counts}"


def _charts(log: Log, *, compared: bool) -> Iterator[Chart]:
    yield Chart(
        "Off-tracking, + when the hitch's path lies left",
        "m",
        (
            Curve("off_tracking_std", "±2 σ", "estimated", "band", base="off_tracking"),
            Curve("off_tracking", "estimated", "estimated", "dots"),
            *((Curve("off_tracking_poses", "by the recorded poses", "true"),) if compared else ()),
        ),
    )
    if compared:
        error = Curve("off_tracking", "error", "estimated", "dots", 1e3, less="off_tracking_poses")
        band = Curve("off_tracking_std", "±2 σ", "estimated", "band", 1e3)
        yield Chart("Error against the recorded poses", "mm", (band, error), 1)
    yield Chart("Speed of the hitch", "m/s", (Curve("v_x", "forward", "true"), Curve("v_y", "to the left", "third")), 2)
    yield Chart("Yaw rate", "°/s", (Curve("yaw_rate", "yaw rate", "true", scale=_DEGREES),), 2)
    features = Curve("matches", "matches", "grey"), Curve("inliers", "inliers", "true")
    yield Chart("Features per frame", "-", features, 0)
    if "right_yaw" in log:
        rotation = tuple(
            Curve(f"right_{name}", name, colour, scale=_DEGREES)
            for name, colour in zip(("roll", "yaw", "pitch"), SERIES, strict=False)
        )
        yield Chart("Rotation of the right camera since its calibration", "°", rotation, 3)


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
