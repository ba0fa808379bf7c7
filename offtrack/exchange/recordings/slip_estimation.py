"""Estimates of the slip angle in a rover's recording, image by image."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from estimators.context import Estimator
from estimators.estimates import Health, SlipAngle
from offtrack.exchange.recordings.rover_recording import RoverRecording
from scenarios.progress import Progress, no_progress
from scenarios.results import metrics
from scenarios.results.log import HEALTH, HEALTH_WORDS, LOST, Log, Signal
from scenarios.results.summary_numbers import number
from vehicle.clock import TICK

_DROPPED: Final = 3.0
ROW_WORDS: Final = HEALTH_WORDS | {_DROPPED: "dropped"}
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
    log = estimation.log
    error = np.degrees(log["slip_angle"] - log["slip_angle_reference"])
    lagged = np.degrees(log["slip_angle_lagged"] - log["slip_angle_reference"])
    used = log["health"] < _DROPPED
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
        "dropped_images": [{"image": k, "reason": reason} for k, reason in estimation.dropped.items()],
    }


def _log(recording: RoverRecording, estimates: list[SlipAngle | None]) -> Log:
    times = recording.readings[: len(estimates), 0]
    table = np.full((len(estimates), len(_SIGNALS)), np.nan)
    table[:, 0] = times
    rows = {round(time / TICK): k for k, time in enumerate(times)}
    for k, estimate in enumerate(estimates):
        table[k, 3] = _DROPPED if estimate is None else HEALTH[estimate.health]
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
