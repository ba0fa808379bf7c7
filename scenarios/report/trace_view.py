"""The rover camera's picture with the trace that was estimated drawn over it."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from scenarios.report.canvas import ESTIMATED, TRUE, Picture, fixed_point
from scenarios.results.rover import RoverResult, TraceFrame
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_NEAR, _FAR = 0.12, 0.66  # behind the wheel's centre: where the line is drawn [m]
_SHIFT: Final = 4


def picture(result: RoverResult, frame: TraceFrame) -> Picture:
    """The picture, RGB, with the estimated direction of travel at the wheel, and the true one beside it."""
    image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"frame of tick {frame.tick} is no JPEG image")
    shown = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    log = result.log
    row = int(np.searchsorted(log["tick"], frame.tick))
    pointed = float(log[f"steer_{result.rig.wheels[result.rig.watched].name}"][row])
    draw_trace(shown, result.rig, pointed + float(log["wheel_slip_true"][row]), 0.0, TRUE)
    estimate = float(log["wheel_slip_estimate"][row])
    if math.isfinite(estimate):
        draw_trace(shown, result.rig, pointed + estimate, float(log["trace_offset"][row]), ESTIMATED)
    return shown


def traced(result: RoverResult, frame: TraceFrame) -> bytes:
    """The same as JPEG."""
    return cv2.imencode(".jpg", cv2.cvtColor(picture(result, frame), cv2.COLOR_RGB2BGR))[1].tobytes()


def draw_trace(shown: Picture, rig: TraceRig, direction: float, offset: float, colour: tuple[int, int, int]) -> None:
    """A line on the ground through the wheel, which travels in ``direction`` against the body [rad], + left."""
    behind = np.linspace(_NEAR, _FAR, 12)
    x, y = rig.wheel[0] - behind, rig.wheel[1] + offset - behind * math.tan(direction)
    pixels = _pixels(rig, np.column_stack([x, y]))
    cv2.polylines(shown, [fixed_point(pixels)], False, colour, 2, cv2.LINE_AA, _SHIFT)


def _pixels(rig: TraceRig, ground: FloatArray) -> FloatArray:
    """Pixels (n, 2) of ground points (n, 2) in R [m]."""
    R_RC, p_RC = rig.X_RC[:3, :3], rig.X_RC[:3, 3]
    points = np.column_stack([ground, np.zeros(len(ground))])
    return rig.camera.project((points - p_RC) @ R_RC)
