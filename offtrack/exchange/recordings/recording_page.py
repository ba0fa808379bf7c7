"""Result directory of an off-tracking estimation: trajectories, table, summary, report with playback, and video."""

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.estimates import Health
from offtrack.exchange.recordings.estimation import Estimation, FrameEstimate, body_poses, summary
from offtrack.exchange.recordings.stereo_reader import kitti_text, tum_text
from offtrack.reports import canvas
from offtrack.reports.film import Film, Frames
from offtrack.reports.page import Items, Page, Player, Section, outcome_verdict, software_section, some
from offtrack.reports.player import playback as player
from offtrack.reports.player.encoding import ON_PAGE, encoded
from offtrack.reports.run_files import csv_text, write_results
from offtrack.reports.sections import number_cards, number_table
from scenarios.image_file import read_grey
from scenarios.progress import Progress, no_progress
from scenarios.results.log import HEALTH, HEALTH_WORDS, Log, Signal
from scenarios.results.run_summary import versions
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_SIGNALS: Final = (
    Signal("frame", "-", "number of the frame, counted from 0"),
    Signal("time", "s", "time of the frame as recorded"),
    Signal("dropped", "-", "1 where the frame could not be used"),
    Signal("off_tracking", "m", "lateral distance of the hitch's path from the follow point, + left"),
    Signal("off_tracking_std", "m", "standard deviation of off_tracking"),
    Signal("health", "-", "health of the off-tracking: 0 ok, 1 degraded, 2 lost"),
    Signal("matches", "-", "features matched"),
    Signal("inliers", "-", "matches that agree with the motion"),
    Signal("odometry_health", "-", "health of the motion since the previous frame: 0 ok, 1 degraded, 2 lost"),
    Signal("x", "m", "position of the hitch along the x axis of the first trailer frame, by the odometry"),
    Signal("y", "m", "position of the hitch along the y axis of the first trailer frame"),
    Signal("psi", "rad", "yaw of the trailer since the first frame, continuous"),
    Signal("v_x", "m/s", "velocity of the hitch along the trailer"),
    Signal("v_y", "m/s", "velocity of the hitch across the trailer, + left"),
    Signal("yaw_rate", "rad/s", "yaw rate of the trailer"),
    Signal("off_tracking_poses", "m", "off-tracking computed from the recording's poses"),
)
_ROTATION_SIGNALS: Final = (
    Signal("right_roll", "rad", "rotation of the right camera since its calibration, about its optical axis"),
    Signal("right_yaw", "rad", "rotation of the right camera about its y axis (down)"),
    Signal("right_pitch", "rad", "rotation of the right camera about its x axis (right)"),
    Signal("right_roll_std", "rad", "standard deviation of right_roll"),
    Signal("right_yaw_std", "rad", "standard deviation of right_yaw"),
    Signal("right_pitch_std", "rad", "standard deviation of right_pitch"),
    Signal("right_delay", "s", "time by which the right image is taken after the left one"),
    Signal("right_delay_std", "s", "standard deviation of right_delay"),
)
DROPPED: Final = 3.0  # stands for a health
ROW_WORDS: Final = HEALTH_WORDS | {DROPPED: "dropped"}


def estimate_log(estimation: Estimation) -> Log:
    """One row per frame, with the right camera's rotation if it was estimated; NaN where there is no value."""
    poses = body_poses(estimation.recording, estimation.X_C0C)
    psi = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    rows = [
        [k, frame.files.time, float(bool(frame.dropped)), *_estimated(frame), x, y, turn, *_velocity(frame), reference]
        for k, (frame, (x, y), turn, reference) in enumerate(
            zip(estimation.frames, poses[:, :2, 3], psi, estimation.reference, strict=True)
        )
    ]
    log = Log(_SIGNALS, np.array(rows, dtype=np.float64).reshape(-1, len(_SIGNALS)))
    if not any(isinstance(frame.motion, SelfCalibratedMotion) for frame in estimation.frames):
        return log
    rotations = np.array([_rotation(frame) for frame in estimation.frames])
    return Log((*_SIGNALS, *_ROTATION_SIGNALS), np.column_stack([log.rows, rotations]))


def _estimated(frame: FrameEstimate) -> tuple[float, ...]:
    e, motion = frame.off_tracking, frame.motion
    if e is None:
        return (math.nan,) * 6
    value, std = (math.nan, math.nan) if e.health is Health.LOST else (e.value, e.std)
    of_motion = (motion.matches, motion.inliers, HEALTH[motion.health]) if motion else (math.nan,) * 3
    return (value, std, HEALTH[e.health], *of_motion)


def _velocity(frame: FrameEstimate) -> tuple[float, ...]:
    e = frame.off_tracking
    return (e.v_x, e.v_y, e.yaw_rate) if e is not None else (math.nan,) * 3


def _rotation(frame: FrameEstimate) -> tuple[float, ...]:
    if not isinstance(frame.motion, SelfCalibratedMotion):
        return (math.nan,) * len(_ROTATION_SIGNALS)
    motion = frame.motion
    return (*motion.right_rotation, *motion.right_rotation_std, motion.right_delay, motion.right_delay_std)


def table_text(log: Log) -> str:
    """The table as CSV: column names end in the unit, missing values are empty, health is in words."""
    shown = [k for k, signal in enumerate(log.signals) if signal.name != "dropped"]
    rows = log.rows.copy()
    healths = [k for k in shown if log.names[k].endswith("health")]
    rows[np.ix_(np.flatnonzero(log["dropped"]), np.array(healths))] = DROPPED
    return csv_text(
        Log(tuple(log.signals[k] for k in shown), rows[:, shown]), ROW_WORDS, {"-": ".0f", "rad": ".8f"}, ".6f"
    )


def write_estimation(
    estimation: Estimation,
    odometry: str,
    directory: Path,
    *,
    video: bool,
    estimator: str = "viso_ot",
    agreement: dict[str, float | None] | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write all results and return the summary; ``progress`` counts the frames of the video.

    ``agreement`` of the odometry with itself goes into the summary, if it was computed.

    An interrupt while the video is drawn keeps all other results and the part of the video that is finished.

    Raises:
        ValueError: if the directory exists and is not empty.
    """
    log = estimate_log(estimation)
    numbers = {**summary(estimation, log, odometry), "estimator": estimator, "agreement": agreement or {}}
    manifest = {"recording": numbers["recording"], "estimator": estimator, "odometry": odometry, "versions": versions()}
    texts = {
        "off_tracking.csv": table_text(log),
        "report.html": report_page(estimation, log, numbers),
        "manifest.json": json.dumps(manifest, indent=2) + "\n",
    }
    if estimation.states_motions or not estimation.frames:
        used = [k for k, frame in enumerate(estimation.frames) if not frame.dropped]
        times = [estimation.frames[k].files.time for k in used]
        texts |= {
            "trajectory_tum.txt": tum_text(times, estimation.X_C0C[used]),
            "trajectory_kitti.txt": kitti_text(estimation.X_C0C),
        }
    film = (lambda path: write_video(estimation, log, path, progress=progress)) if video and len(log) > 1 else None
    write_results(directory, "off_tracking", log, numbers, texts, film)
    return numbers


_DEGREES: Final = 180.0 / np.pi
_WIDTH, _HEIGHTS = 0.5, (0.3, 0.6)  # of the bar from hitch to follow point [m], for drawings only


def recording_playback(estimation: Estimation, log: Log, *, pictures: bool = True) -> player.Playback:
    """Everything that a page shows of the recording over time."""
    recording, c = estimation.recording, estimation.recording.calibration
    follow = recording.follow_distance
    half = 0.5 * _WIDTH
    outline: FloatArray = np.array([[0.0, half], [0.0, -half], [-follow, -half], [-follow, half]])
    since_first = player.elapsed(log)
    true = None if recording.poses is None else body_poses(recording, recording.poses[: len(log)])
    compared = bool(np.isfinite(log["off_tracking_poses"]).any())
    return player.Playback(
        title=recording.sequence.directory.name,
        runs=(
            player.PlayedRun(
                name=recording.sequence.directory.resolve().name,
                log=since_first,
                peak=player.peak_of(since_first, "off_tracking"),
                bodies=(
                    player.Body(name="trailer", outline=outline, wheels=(), pose=("x", "y", "psi"), heights=_HEIGHTS),
                ),
                trails=(
                    player.Trail("path of the hitch, odometry", "true", 0),
                    player.Trail("path of the follow point, odometry", "estimated", 0, (-follow, 0.0)),
                ),
                estimated=player.EstimatedPath(
                    "estimated path of the hitch", 0, (-follow, 0.0), "off_tracking", "off_tracking_std", "health"
                ),
                spans=(
                    *player.health_spans(since_first, "health"),
                    *player.health_spans(since_first, "odometry_health", "odometry"),
                ),
                pictures=list(_pictures(estimation)) if pictures else [],
                cameras=(player.Camera(0, c.X_SC, 0.5 * c.width / c.focal_length, 0.5 * c.height / c.focal_length),),
                lines=()
                if true is None
                else (player.Line("path of the hitch, recorded poses", "grey", true[:, :2, 3]),),
            ),
        ),
        charts=tuple(_charts(log, compared=compared)),
        readings=(
            player.Reading("off-tracking", "off_tracking", "m", 1.0, 3, "estimated"),
            player.Reading("its σ", "off_tracking_std", "mm", 1e3, 1, "estimated"),
            *[player.Reading("by the recorded poses", "off_tracking_poses", "m", 1.0, 3, "true")] * compared,
            player.Reading("speed", "v_x", "m/s", 1.0, 2),
            player.Reading("yaw rate", "yaw_rate", "°/s", _DEGREES, 2),
            player.Reading("inliers", "inliers", "-", 1.0, 0),
        ),
        nearest=60.0,
    )


def _pictures(estimation: Estimation) -> Iterator[player.Picture]:
    scale = min(1.0, ON_PAGE.width / estimation.recording.size[0])
    return (_picture(frame, frame.jpeg, scale) for frame in estimation.frames if frame.jpeg)


def _picture(frame: FrameEstimate, jpeg: bytes, scale: float = 1.0) -> player.Picture:
    """A left image with its tracks, whose pixels are ``scale`` to those of the camera."""
    counts = f" · {frame.motion.inliers} inliers of {frame.motion.matches} matches" if frame.motion else ""
    tracks = scale * (frame.tracks + 0.5) - 0.5
    return player.Picture(frame.files.tick * TICK, jpeg, tracks, f"{frame.files.left.name}{counts}")


def _read_again(estimation: Estimation, frame: FrameEstimate) -> player.Picture | None:
    """The left image, read again and rectified, with its tracks; None if it can no longer be read."""
    try:
        left = read_grey(frame.files.left, frame.files.bits)
    except ValueError:
        return None
    image = estimation.recording.rectified(StereoFrame(tick=0, left=left, right=left)).left
    return _picture(frame, cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes())


def write_video(
    estimation: Estimation, log: Log, path_without_suffix: Path, *, progress: Progress = no_progress
) -> Path:
    """Write a video in real time with a picture for every frame, whose images are read again, and return its path."""
    playback, times = recording_playback(estimation, log, pictures=False), player.elapsed(log)["time"]
    rate = int(np.clip(round(1.0 / float(np.median(np.diff(times)))), 1, 60))
    used = [frame for frame in estimation.frames if not frame.dropped]
    frames = Frames(np.array([frame.files.tick * TICK for frame in used]), lambda k: _read_again(estimation, used[k]))
    return canvas.write_video(Film(playback, frames).picture, times, rate, path_without_suffix, progress)


def _charts(log: Log, *, compared: bool) -> Iterator[player.Chart]:
    reference = player.Curve("off_tracking_poses", "by the recorded poses", "true") if compared else None
    yield from player.off_tracking_charts(
        "the hitch's path", "off_tracking", reference, "Error against the recorded poses"
    )
    yield player.Chart(
        "Speed of the hitch",
        "m/s",
        (player.Curve("v_x", "forward", "true"), player.Curve("v_y", "to the left", "third")),
        2,
    )
    yield player.Chart("Yaw rate", "°/s", (player.Curve("yaw_rate", "yaw rate", "true", scale=_DEGREES),), 2)
    features = player.Curve("matches", "matches", "grey"), player.Curve("inliers", "inliers", "true")
    yield player.Chart("Features per frame", "-", features, 0)
    if "right_yaw" in log:
        rotation = [
            curve
            for name, colour in zip(("roll", "yaw", "pitch"), player.SERIES, strict=False)
            for curve in (
                player.Curve(f"right_{name}_std", "±2 σ", colour, "band", _DEGREES, base=f"right_{name}"),
                player.Curve(f"right_{name}", name, colour, scale=_DEGREES),
            )
        ]
        yield player.Chart("Rotation of the right camera since its calibration", "°", rotation, 3)


_LISTED = 50  # dropped frames named on the page; the summary names all

_ON_CARDS: Final = (
    "off_tracking.max_m",
    "off_tracking.estimate_error_rms_m",
    "off_tracking.std_mean_m",
    "odometry.drift_percent",
    "off_tracking.valid_fraction",
    "odometry.inliers_mean",
)


def report_page(estimation: Estimation, log: Log, numbers: dict[str, Any]) -> str:
    """The page as HTML; ``numbers`` is the summary."""
    recording, c = estimation.recording, estimation.recording.calibration
    subtitle = (
        f"{len(estimation.frames)} stereo frames of {c.width}×{c.height} px in "
        f"{numbers['frames']['duration_s']:.1f} s · baseline {c.baseline:.3g} m · "
        f"follow point {recording.follow_distance:g} m behind the hitch · odometry {numbers['odometry']['name']}"
    )
    playback = recording_playback(estimation, log) if len(log) > 1 else None
    name = recording.sequence.directory.resolve().name
    return page_text(f"{name} · off-tracking", name, subtitle, numbers, _ON_CARDS, playback)


_ASSUMED: Final = (
    "The recording does not state these values, and off-tracking depends on them. The option in brackets sets each."
)


def page_text(
    title: str,
    heading: str,
    subtitle: str,
    numbers: dict[str, Any],
    cards: Sequence[str],
    playback: player.Playback | None,
    text: str = "",
) -> str:
    """The page of a recording as HTML; ``numbers`` is the summary, ``text`` stands above the playback."""
    dropped = [f"frame {one['frame']} dropped: {one['reason']}" for one in numbers.get("dropped_frames", ())]
    dropped += [f"image {one['image']} dropped: {one['reason']}" for one in numbers.get("dropped_images", ())]
    before = {"Warnings": numbers["warnings"], "Assumed values": numbers.get("assumed", ())}
    notes = [*numbers.get("notes", ()), *some(dropped, _LISTED)]
    return Page(
        title=title,
        heading=heading,
        subtitle=subtitle,
        verdict=outcome_verdict(numbers["outcome"]),
        cards=number_cards(numbers, cards),
        sections=[
            *(Section(name, _ASSUMED * (name != "Warnings"), [Items(rows)]) for name, rows in before.items() if rows),
            *([Section("Playback", text, [Player(encoded(playback))])] if playback else ()),
            *([Section("Notes on the recording", content=[Items(notes)])] if notes else ()),
            Section("All numbers", content=[number_table(numbers)]),
            software_section(versions()),
        ],
        wide=True,
    ).html()
