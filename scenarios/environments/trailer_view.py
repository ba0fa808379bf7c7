"""Camera view of a trailer for people: left above right image, with the features that an odometry follows."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from estimators.estimates import Health
from scenarios.report.canvas import ESTIMATED, INK, SOFT, Colour, Picture, blank, write
from scenarios.report.flow import draw_flow
from scenarios.results.trailer_signals import Estimate
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray

WIDTH: Final = 840  # [px]
_HEIGHT: Final = 600  # as the top view
_LINE: Final = 34  # height of a text line [px]
_IMAGE_HEIGHT: Final = (_HEIGHT - 2 * _LINE) // 2  # at most [px]


def stereo_view(frame: StereoFrame, estimate: Estimate | None) -> Picture:
    """Both images, with the newest estimate below."""
    picture = blank(WIDTH, _HEIGHT)
    motion = None if estimate is None else estimate.motion
    tracks: FloatArray = np.empty((0, 4)) if motion is None else motion.tracks.astype(np.float64)
    write(picture, "left camera above, right camera below", (12, 8), colour=SOFT)
    bottom = _LINE + _draw_image(picture, frame.left, tracks, _LINE)
    bottom += _draw_image(picture, frame.right, np.empty((0, 4)), bottom)
    if estimate is not None:
        caption, colour = _caption(estimate)
        write(picture, caption, (12, bottom + 8), colour=colour)
    return picture


def _draw_image(picture: Picture, image: GreyImage, tracks: FloatArray, top: int) -> int:
    """Draw an image; return its height [px]."""
    scale = float(min(WIDTH / image.shape[1], _IMAGE_HEIGHT / image.shape[0]))
    width, height = int(scale * image.shape[1] + 0.5), int(scale * image.shape[0] + 0.5)
    shown = np.asarray(
        cv2.cvtColor(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2RGB), np.uint8
    )
    draw_flow(shown, scale * (tracks + 0.5) - 0.5)
    left = (WIDTH - width) // 2
    picture[top : top + height, left : left + width] = shown
    return height


def _caption(estimate: Estimate) -> tuple[str, Colour]:
    off_tracking = estimate.off_tracking
    if off_tracking.health is Health.LOST:
        return "estimated off-tracking: none", INK
    value, std = off_tracking.value, 1e3 * off_tracking.std
    return f"estimated off-tracking {value:+.3f} m, standard deviation {std:.0f} mm", ESTIMATED
