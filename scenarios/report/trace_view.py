"""A rover's camera image with the true and the estimated direction of travel drawn over it."""

from __future__ import annotations

import math

import cv2
import numpy as np

from scenarios.report.canvas import ESTIMATED, TRUE, Colour, Picture, curve, decoded
from scenarios.results.rover import RoverResult, TraceFrame
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_NEAR, _FAR = 0.12, 0.66  # ends of the line, behind the wheel's centre [m]


def picture(result: RoverResult, frame: TraceFrame) -> Picture:
    """The image, RGB, with lines in the true and the estimated direction of travel at the wheel."""
    shown = decoded(frame.jpeg, frame.tick)
    log = result.log
    row = int(np.searchsorted(log["tick"], frame.tick))
    pointed = float(log[f"steer_{result.rig.wheels[result.rig.watched].name}"][row])
    draw_trace(shown, result.rig, pointed + float(log["wheel_slip_true"][row]), 0.0, TRUE)
    estimate = float(log["wheel_slip_estimate"][row])
    if math.isfinite(estimate):
        draw_trace(shown, result.rig, pointed + estimate, float(log["trace_offset"][row]), ESTIMATED)
    return shown


def traced(result: RoverResult, frame: TraceFrame) -> bytes:
    """The picture as JPEG."""
    return cv2.imencode(".jpg", cv2.cvtColor(picture(result, frame), cv2.COLOR_RGB2BGR))[1].tobytes()


def draw_trace(shown: Picture, rig: TraceRig, direction: float, offset: float, colour: Colour) -> None:
    """Draws the wheel's trace on the ground if it travels in ``direction`` relative to the body [rad], + left."""
    behind = np.linspace(_NEAR, _FAR, 12)
    x, y = rig.wheel[0] - behind, rig.wheel[1] + offset - behind * math.tan(direction)
    curve(shown, _pixels(rig, np.column_stack([x, y])), colour, 2)


def _pixels(rig: TraceRig, ground: FloatArray) -> FloatArray:
    """Pixels (n, 2) of ground points (n, 2) in R [m]."""
    R_RC, p_RC = rig.X_RC[:3, :3], rig.X_RC[:3, 3]
    points = np.column_stack([ground, np.zeros(len(ground))])
    return rig.camera.project((points - p_RC) @ R_RC)
