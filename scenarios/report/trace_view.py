"""A rover's camera image with the true and the estimated direction of travel drawn over it."""

from __future__ import annotations

import cv2

from scenarios.report.canvas import ESTIMATED, TRUE, Colour, Picture, curve, decoded
from scenarios.results.rover import RoverResult, TraceFrame
from scenarios.results.trace_lines import trace_line, trace_lines
from sensors.sand.trace_rig import TraceRig


def picture(result: RoverResult, frame: TraceFrame) -> Picture:
    """The image, RGB, with lines in the true and the estimated direction of travel at the wheel."""
    shown = decoded(frame.jpeg, frame.tick)
    true, estimate = trace_lines(result, frame.tick)
    curve(shown, true, TRUE, 2)
    if estimate is not None:
        curve(shown, estimate, ESTIMATED, 2)
    return shown


def traced(result: RoverResult, frame: TraceFrame) -> bytes:
    """The picture as JPEG."""
    return cv2.imencode(".jpg", cv2.cvtColor(picture(result, frame), cv2.COLOR_RGB2BGR))[1].tobytes()


def draw_trace(shown: Picture, rig: TraceRig, direction: float, offset: float, colour: Colour) -> None:
    """Draws the wheel's trace on the ground if it travels in ``direction`` relative to the body [rad], + left."""
    curve(shown, trace_line(rig, direction, offset), colour, 2)
