"""Camera images drawn over: strokes of moved features, and a rover's true and estimated direction of travel."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from offtrack.reports.canvas import ESTIMATED, INK, PAPER, TRUE, WIDTH, Colour, Picture, curve, decoded, write
from offtrack.reports.page import Photo, Photos, Stroke
from scenarios.results.rover_result import RoverResult, TraceFrame, trace_line, trace_lines
from scenarios.results.trailer_result import CameraFrame
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_TALLEST: Final = 480  # of a camera image in a video [px]
_STILL, _FAST = 200.0, 35.0  # hues of features on a page: blue and orange [deg]
_COLOURS = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]  # in a video


def flow_photos(frame: CameraFrame) -> Photos:
    """The image for a page, with a stroke from the previous to the current position of each feature."""
    height, width = decoded(frame.jpeg, frame.tick).shape[:2]
    tracks = frame.tracks.astype(np.float64)
    hues = _STILL + (_FAST - _STILL) * _relative_length(tracks)
    strokes = [
        Stroke((u0, v0), (u1, v1), f"hsl({hue:.0f} 95% 58%)")
        for (u0, v0, u1, v1), hue in zip((tracks + 0.5).tolist(), hues, strict=True)  # SVG counts from a pixel's corner
    ]
    return Photos([Photo(frame.jpeg, (width, height), "camera image with its features", strokes)])


def camera_picture(frame: CameraFrame) -> Picture:
    """The image across the width of a video, with its features and their number."""
    image = decoded(frame.jpeg, frame.tick)
    scale = min(WIDTH / image.shape[1], _TALLEST / image.shape[0])
    size = (2 * round(0.5 * scale * image.shape[1]), 2 * round(0.5 * scale * image.shape[0]))  # H.264 wants even sizes
    shown = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    draw_flow(shown, scale * (frame.tracks.astype(np.float64) + 0.5) - 0.5)
    picture = np.full((size[1], WIDTH, 3), INK, np.uint8)
    left = (WIDTH - size[0]) // 2
    picture[:, left : left + size[0]] = shown
    strip = picture[:32]
    strip[:] = strip // 5 * 2
    title = "left camera" + (" and the motion of its features" if len(frame.tracks) else "")
    write(picture, title, (16, 6), size=16, colour=PAPER)
    if frame.matches:
        counts = f"{frame.inliers} inliers of {frame.matches} matches"
        write(picture, counts, (WIDTH - 16, 6), size=16, colour=PAPER, anchor=1.0)
    return picture


def draw_flow(picture: Picture, tracks: FloatArray) -> None:
    """Draws a stroke from the previous to the current position of each feature (m, 4) [px]."""
    shade = 40.0 + 190.0 * _relative_length(tracks)
    ends = np.rint(16.0 * tracks).astype(np.int32)
    for (u0, v0, u1, v1), k in zip(ends.tolist(), shade.astype(int).tolist(), strict=True):
        colour = _COLOURS[k].tolist()
        cv2.line(picture, (u0, v0), (u1, v1), colour, 1, cv2.LINE_AA, 4)
        cv2.circle(picture, (u1, v1), 32, colour, -1, cv2.LINE_AA, 4)


def _relative_length(tracks: FloatArray) -> FloatArray:
    """Length of each stroke relative to the long ones, 0 … 1, shape (m,)."""
    if not len(tracks):
        return np.zeros(0)
    length = np.hypot(*(tracks[:, 2:] - tracks[:, :2]).T)
    relative: FloatArray = np.clip(length / max(float(np.percentile(length, 95)), 1e-9), 0.0, 1.0)
    return relative


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
