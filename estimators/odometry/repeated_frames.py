"""Repeated frames: the previous image once more, under a new time.

A frozen camera or a transmission that repeats messages looks like standstill. At a true standstill the noise of the
images is new in every frame, so equal images are repeated ones. If a camera shows no noise (strong compression), equal
images are believed of a vehicle that stands or can have stopped. Before the first motion they say nothing.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimators.estimates import Motion
from estimators.odometry.exposure import cell_means
from sensors.messages import GreyImage
from vehicle.clock import TICK

_EQUAL = 0.005  # mean difference of equal images, some transmission errors included [grey levels]
_ALIKE = 0.1  # the same for images compressed anew; a moving camera's differ by 1 and more [grey levels]
_LEAST_NOISE = 0.3  # below it nothing is known of the camera's noise [grey levels]
_BRAKING = 8.0  # deceleration of full braking [m/s2]


def visible_noise(before: GreyImage, image: GreyImage) -> float:
    """Least mean difference of the cells of two images [grey levels]: the noise, if some cell shows no motion."""
    difference = np.asarray(cv2.absdiff(before, image), dtype=np.uint8)
    shown = cell_means(difference, clipped=False)[np.isfinite(cell_means(image))]
    return float(shown.min()) if shown.size else 0.0


def is_repeated(before: GreyImage, image: GreyImage, noise: float, last: Motion | None) -> bool:
    """True if an image repeats the one before, for the camera's ``noise`` [grey levels] and the last known motion."""
    if last is None:
        return repeats(before, image, math.inf, must_differ=False)
    return repeats(before, image, noise, must_differ=_must_move(last))


def repeats(before: GreyImage, image: GreyImage, noise: float, *, must_differ: bool) -> bool:
    """True if an image is the one before, once more.

    Args:
        before: an image of the same camera.
        image: a later one.
        noise: of the camera, 0 if none has been seen yet [grey levels].
        must_differ: the camera has moved, so that even without noise its images differ.
    """
    difference = cv2.norm(before, image, cv2.NORM_L1) / image.size
    if must_differ:
        return bool(difference < _ALIKE)
    return bool(difference < _EQUAL and noise > _LEAST_NOISE)


def _must_move(last: Motion) -> bool:
    """True if the vehicle was too fast to stand one frame later."""
    span = (last.tick - last.previous_tick) * TICK
    return float(np.linalg.norm(last.X_PC[:3, 3])) > _BRAKING * span**2
