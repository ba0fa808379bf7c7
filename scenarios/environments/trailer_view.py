"""What a trailer's cameras see, for people: left above right, with the features that an odometry follows."""

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
_HEIGHT: Final = 600  # as the plan beside it
_LINE: Final = 34  # of lettering [px]
_ROOM: Final = (_HEIGHT - 2 * _LINE) // 2  # for an image [px]


def stereo_view(frame: StereoFrame, estimate: Estimate | None) -> Picture:
    """Both images, and beneath what an estimator has last made of such ones."""
    picture = blank(WIDTH, _HEIGHT)
    motion = None if estimate is None else estimate.motion
    tracks: FloatArray = np.empty((0, 4)) if motion is None else motion.tracks.astype(np.float64)
    write(picture, "left camera above, right camera below", (12, 8), colour=SOFT)
    bottom = _LINE + _put(picture, frame.left, tracks, _LINE)
    bottom += _put(picture, frame.right, np.empty((0, 4)), bottom)
    if estimate is not None:
        words, colour = _told(estimate)
        write(picture, words, (12, bottom + 8), colour=colour)
    return picture


def _put(picture: Picture, image: GreyImage, tracks: FloatArray, top: int) -> int:
    """Draws an image; its height [px]."""
    scale = float(min(WIDTH / image.shape[1], _ROOM / image.shape[0]))
    width, height = int(scale * image.shape[1] + 0.5), int(scale * image.shape[0] + 0.5)
    shown = np.asarray(
        cv2.cvtColor(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2RGB), np.uint8
    )
    draw_flow(shown, scale * (tracks + 0.5) - 0.5)
    left = (WIDTH - width) // 2
    picture[top : top + height, left : left + width] = shown
    return height


def _told(estimate: Estimate) -> tuple[str, Colour]:
    seen = estimate.off_tracking
    if seen.health is Health.LOST:
        return "estimated off-tracking: none", INK
    return f"estimated off-tracking {seen.value:+.3f} m, standard deviation {1e3 * seen.std:.0f} mm", ESTIMATED
