"""Estimates of the slip angle in a rover's recording, image by image, and their result directory."""

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from estimators.context import Estimator
from estimators.estimates import Health, SlipAngle
from offtrack.exchange.recordings.image_checks import Flow, ground_flow
from offtrack.exchange.recordings.recording_page import DROPPED, ROW_WORDS, page_text
from offtrack.exchange.recordings.writers import RoverRecording
from offtrack.reports.canvas import write_video as write_film
from offtrack.reports.film import Film, Frames
from offtrack.reports.player import playback as player
from offtrack.reports.run_files import csv_text, write_results
from scenarios.progress import Progress, no_progress
from scenarios.results import metrics
from scenarios.results.log import HEALTH, LOST, Log, Signal
from scenarios.results.rover_result import trace_line
from scenarios.results.run_summary import number
from vehicle.clock import TICK

_SIGNALS: Final = (
    Signal("time", "s", "time of the image"),
    Signal("slip_angle", "rad", "slip angle of the body, + left"),
    Signal("slip_angle_std", "rad", "its standard deviation"),
    Signal("health", "-", "0 ok, 1 degraded, 2 lost, 3 no usable image"),
    Signal("wheel_slip", "rad", "slip angle of the left rear wheel, + left"),
    Signal("trace_offset", "m", "lateral offset of the trace from the wheel's centre, + left"),
    Signal("confidence", "-", "confidence that the trace is the wheel's own"),
    Signal("slip_angle_lagged", "rad", "slip angle at this time, estimated with later images too"),
    Signal("slip_angle_lagged_std", "rad", "its standard deviation"),
    Signal("slip_angle_reference", "rad", "slip angle in the recording's own slip.csv"),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipEstimation:
    """Estimates from a recording, up to its end or an interrupt."""

    recording: RoverRecording
    estimator: str
    outcome: str  # "completed" or "interrupted"
    dropped: dict[int, str]  # unusable images and the reasons
    log: Log  # one row per image
    seconds: float  # of the estimator alone


def estimate_slip(
    recording: RoverRecording, name: str, source: Estimator[Any, Any, SlipAngle], progress: Progress = no_progress
) -> SlipEstimation:
    """Estimate the slip angle in every image; an interrupt ends this early and keeps the images so far.

    Raises:
        ValueError: one line, if no image can be used.
    """
    memory, seconds, outcome = source.init(), 0.0, "completed"
    estimates: list[SlipAngle | None] = []
    dropped: dict[int, str] = {}
    try:
        for k in range(len(recording.images)):
            view = recording.view(k)
            if isinstance(view, str):
                dropped[k] = view
                estimates.append(None)
            else:
                start = time.perf_counter()
                memory, estimate = source.step(memory, view)
                seconds += time.perf_counter() - start
                estimates.append(estimate)
            progress(k + 1, len(recording.images), f"image {k + 1} of {len(recording.images)}")
    except KeyboardInterrupt:
        outcome = "interrupted"
    if estimates and all(estimate is None for estimate in estimates):
        raise ValueError(f"{recording.directory}: no image can be used. First reason: {dropped[0]}")
    return SlipEstimation(
        recording=recording,
        estimator=name,
        outcome=outcome,
        dropped=dropped,
        log=_log(recording, estimates),
        seconds=seconds,
    )


def slip_summary(estimation: SlipEstimation) -> dict[str, Any]:
    """Summary of an estimation for JSON."""
    log, flow = estimation.log, ground_flow(estimation.recording)
    error = np.degrees(log["slip_angle"] - log["slip_angle_reference"])
    lagged = np.degrees(log["slip_angle_lagged"] - log["slip_angle_reference"])
    used = log["health"] < DROPPED
    return {
        "outcome": estimation.outcome,
        "recording": estimation.recording.directory.resolve().name,
        "estimator": estimation.estimator,
        "frames": {
            "images": len(log),
            "dropped": len(estimation.dropped),
            "duration_s": number(float(log["time"][-1] - log["time"][0])) if len(log) else None,
        },
        "slip": {
            "mean_deg": number(math.degrees(metrics.mean(log["slip_angle"]))),
            "max_deg": number(math.degrees(metrics.peak(log["slip_angle"]))),
            "std_mean_deg": number(math.degrees(metrics.mean(log["slip_angle_std"]))),
            "valid_fraction": number(float(np.mean(log["health"][used] < LOST))) if used.any() else None,
            "error_rms_deg": number(metrics.rms(error)),
            "error_max_deg": number(metrics.peak(error)),
            "lagged_error_rms_deg": number(metrics.rms(lagged)),
            "within_2_5_sigma": number(metrics.within_sigmas(error, np.degrees(log["slip_angle_std"]))),
        },
        "timing": {"estimator_ms_per_image": number(1e3 * estimation.seconds / max(1, int(used.sum())))},
        "warnings": _warnings(estimation, flow),
        "notes": list(flow.notes),
        "dropped_images": [{"image": k, "reason": reason} for k, reason in estimation.dropped.items()],
    }


def _warnings(estimation: SlipEstimation, flow: Flow) -> list[str]:
    """What is doubtful about the recording, a line each; the worst first."""
    lost = int(np.sum(estimation.log["health"] >= LOST))
    total = len(estimation.log)
    found = list(flow.warnings)
    if 2 * lost <= total:
        return found
    cause = "see the next line" if found else "is the trace of the wheel in view, and is the rig that of these images?"
    return [f"{lost} of {total} images gave no slip angle: {cause}", *found]


def _log(recording: RoverRecording, estimates: list[SlipAngle | None]) -> Log:
    times = recording.readings[: len(estimates), 0]
    table = np.full((len(estimates), len(_SIGNALS)), np.nan)
    table[:, 0] = times
    rows = {round(time / TICK): k for k, time in enumerate(times)}
    for k, estimate in enumerate(estimates):
        table[k, 3] = DROPPED if estimate is None else HEALTH[estimate.health]
        if estimate is None or estimate.health is Health.LOST:
            continue
        table[k, 1:3] = estimate.value, estimate.std
        table[k, 4:7] = estimate.wheel_slip, estimate.trace_offset, estimate.confidence
        if estimate.lagged_tick in rows:
            table[rows[estimate.lagged_tick], 7:9] = estimate.lagged_value, estimate.lagged_std
    if recording.slip is not None and len(recording.slip):
        known = (times >= recording.slip[0, 0]) & (times <= recording.slip[-1, 0])
        table[known, 9] = np.radians(np.interp(times[known], recording.slip[:, 0], recording.slip[:, 1]))
    return Log(_SIGNALS, table)


_MOST_PICTURES = 240  # each is read again
_DEGREES = 180.0 / np.pi


def slip_playback(estimation: SlipEstimation, name: str, *, pictures: bool = True) -> player.Playback:
    """Everything that a page shows of the recording over time."""
    log = player.elapsed(estimation.log)
    every = max(1, -(-len(log) // _MOST_PICTURES))
    shown = (_picture(estimation, k) for k in range(0, len(log) if pictures else 0, every))
    slip = (
        player.Curve("slip_angle_std", "±2 σ", "estimated", "band", _DEGREES, base="slip_angle"),
        player.Curve("slip_angle", "estimated", "estimated", "dots", _DEGREES),
        player.Curve("slip_angle_lagged", "estimated later", "third", "dots", _DEGREES),
        player.Curve("slip_angle_reference", "by the recording", "true", scale=_DEGREES),
    )
    return player.Playback(
        title=name,
        runs=(
            player.PlayedRun(
                name=name,
                log=log,
                peak=player.peak_of(log, "slip_angle"),
                bodies=(),
                spans=tuple(player.health_spans(log, "health")),
                pictures=[picture for picture in shown if picture],
            ),
        ),
        charts=(
            player.Chart("Slip angle, + left", "°", slip, 2),
            player.Chart(
                "Offset of the trace, + left", "mm", (player.Curve("trace_offset", "offset", "true", scale=1e3),), 1
            ),
            player.Chart("Confidence in the trace", "-", (player.Curve("confidence", "confidence", "true"),), 2),
        ),
        readings=(
            player.Reading("slip angle", "slip_angle", "°", _DEGREES, 2, "estimated"),
            player.Reading("its σ", "slip_angle_std", "°", _DEGREES, 2, "estimated"),
            player.Reading("by the recording", "slip_angle_reference", "°", _DEGREES, 2, "true"),
            player.Reading("confidence", "confidence", "-", 1.0, 2),
        ),
    )


def _picture(estimation: SlipEstimation, k: int) -> player.Picture | None:
    """The k-th image with the estimated trace; None if it can not be used."""
    recording, log = estimation.recording, estimation.log
    view = recording.view(k)
    if isinstance(view, str):
        return None
    strokes, lines = np.zeros((0, 4)), tuple[int, ...]()
    slip = float(log["wheel_slip"][k])
    if math.isfinite(slip):
        direction = math.radians(recording.readings[k, 8]) + slip
        line = trace_line(recording.rig, direction, float(log["trace_offset"][k]))
        strokes, lines = np.hstack([line[:-1], line[1:]]), (0, len(line) - 1)  # no true line
    jpeg = cv2.imencode(".jpg", view.image)[1].tobytes()
    return player.Picture(float(log["time"][k] - log["time"][0]), jpeg, strokes.astype(np.float32), f"image {k}", lines)


def write_video(estimation: SlipEstimation, path_without_suffix: Path, *, progress: Progress = no_progress) -> Path:
    """Write a video with a picture for every image and return its path."""
    playback = slip_playback(estimation, estimation.recording.directory.resolve().name, pictures=False)
    times = playback.runs[0].log["time"]
    frames = Frames(times, lambda k: _picture(estimation, k))
    return write_film(Film(playback, frames).picture, times, _RATE, path_without_suffix, progress)


_RATE: Final = 10  # pictures of the video a second
_ON_CARDS: Final = ("slip.mean_deg", "slip.max_deg", "slip.error_rms_deg", "slip.valid_fraction", "slip.std_mean_deg")


def write_slip_estimation(
    estimation: SlipEstimation, directory: Path, *, video: bool, progress: Progress = no_progress
) -> dict[str, Any]:
    """Writes everything and returns the summary; ``progress`` counts the frames of the video.

    Raises:
        ValueError: if the directory can not take it.
    """
    numbers, moving = slip_summary(estimation), len(estimation.log) > 1
    name = numbers["recording"]
    subtitle = f"{len(estimation.log)} images · estimator {estimation.estimator}"
    text = "The slip angle runs from the body's axis to the direction of travel, + left."
    playback = slip_playback(estimation, name) if moving else None
    page = page_text(f"{name} · slip angle", name, subtitle, numbers, _ON_CARDS, playback, text)
    texts = {"slip.csv": table_text(estimation.log), "report.html": page}
    film = (lambda path: write_video(estimation, path, progress=progress)) if video and moving else None
    write_results(directory, "slip", estimation.log, numbers, texts, film)
    return numbers


def table_text(log: Log) -> str:
    """The table as CSV: angles in degrees, empty where there is no value, health in words."""
    angles = [signal.unit == "rad" for signal in log.signals]
    signals = tuple(replace(one, unit="deg") if one.unit == "rad" else one for one in log.signals)
    return csv_text(Log(signals, np.where(angles, np.degrees(log.rows), log.rows)), ROW_WORDS, {}, ".6g")
