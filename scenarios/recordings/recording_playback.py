"""The playback of a recording of stereo images: its images, the odometry's path, and the estimates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from scenarios.player.playback import (
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
)
from scenarios.player.spans import health_spans
from scenarios.recordings.estimation import Estimation, FrameEstimate
from scenarios.recordings.left_images import camera_frame
from scenarios.results.log import Log
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
        yield Picture(frame.files.tick * TICK, shown.jpeg, shown.tracks, _caption(frame))


def _caption(frame: FrameEstimate) -> str:
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
