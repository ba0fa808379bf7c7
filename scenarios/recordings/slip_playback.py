"""The playback of a rover's recording: its images with the estimated trace, and the estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from scenarios.player.playback import Chart, Curve, Picture, Playback, PlayedRun, Reading
from scenarios.player.spans import health_spans
from scenarios.recordings.slip_estimation import SlipEstimation
from scenarios.results.log import Log
from scenarios.results.trace_lines import trace_line

_MOST_PICTURES = 240  # each is read again
_DEGREES = 180.0 / np.pi


def slip_playback(estimation: SlipEstimation, name: str) -> Playback:
    """Everything that a page shows of the recording over time."""
    rows = estimation.log.rows.copy()
    at = estimation.log.names.index("time")
    rows[:, at] -= rows[0, at]
    log = Log(estimation.log.signals, rows)
    slip = (
        Curve("slip_angle_std", "±2 σ", "estimated", "band", _DEGREES, base="slip_angle"),
        Curve("slip_angle", "estimated", "estimated", "dots", _DEGREES),
        Curve("slip_angle_lagged", "estimated later", "third", "dots", _DEGREES),
        Curve("slip_angle_reference", "by the recording", "true", scale=_DEGREES),
    )
    return Playback(
        title=name,
        runs=(
            PlayedRun(
                name=name,
                log=log,
                bodies=(),
                spans=tuple(health_spans(log, "health")),
                pictures=list(_pictures(estimation, log)),
            ),
        ),
        charts=(
            Chart("Slip angle, + left", "°", slip, 2),
            Chart("Offset of the trace, + left", "mm", (Curve("trace_offset", "offset", "true", scale=1e3),), 1),
            Chart("Confidence in the trace", "-", (Curve("confidence", "confidence", "true"),), 2),
        ),
        readings=(
            Reading("slip angle", "slip_angle", "°", _DEGREES, 2, "estimated"),
            Reading("its σ", "slip_angle_std", "°", _DEGREES, 2, "estimated"),
            Reading("by the recording", "slip_angle_reference", "°", _DEGREES, 2, "true"),
            Reading("confidence", "confidence", "-", 1.0, 2),
        ),
    )


def _pictures(estimation: SlipEstimation, log: Log) -> Iterator[Picture]:
    recording = estimation.recording
    for k in range(0, len(log), max(1, -(-len(log) // _MOST_PICTURES))):
        view = recording.view(k)
        if isinstance(view, str):  # the reason why there is no image
            continue
        strokes, lines = np.zeros((0, 4)), tuple[int, ...]()
        slip = float(log["wheel_slip"][k])
        if math.isfinite(slip):
            direction = math.radians(recording.readings[k, 8]) + slip
            line = trace_line(recording.rig, direction, float(log["trace_offset"][k]))
            strokes, lines = np.hstack([line[:-1], line[1:]]), (0, len(line) - 1)  # no true line
        jpeg = cv2.imencode(".jpg", view.image)[1].tobytes()
        yield Picture(float(log["time"][k]), jpeg, strokes.astype(np.float32), f"image {k}", lines)
