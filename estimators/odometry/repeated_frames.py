"""Repeated frames and views: the previous image once more, under a new time.

A frozen camera or a transmission that repeats messages looks like standstill. At a true standstill the noise of the
images is new in every frame, so equal images are repeated ones. If a camera shows no noise (strong compression), equal
images are believed of a vehicle that stands or can have stopped. Before the first motion they say nothing.

They show the trace of a while ago, and no slip estimator can tell. Noise differs from image to image, also of a rover
that stands: equal images are repeated ones. A camera that shows no noise is only judged while the wheels turn.
"""

import math
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from estimators.context import Estimator, SlipEstimator
from estimators.estimates import Motion, SlipAngle, lost_slip
from estimators.odometry.exposure import CLIPPED, unclipped_range
from sensors.messages import GreyImage, RoverView
from vehicle.clock import TICK
from vehicle.foundation.own_parts import close_part

_CELL = 24  # small enough for cells without motion and without clipped pixels [px]
_EQUAL = 0.005  # mean difference of equal images, some transmission errors included [grey levels]
_ALIKE = 0.1  # the same for images compressed anew; a moving camera's differ by 1 and more [grey levels]
_LEAST_NOISE = 0.3  # below it nothing is known of the camera's noise [grey levels]
_BRAKING = 8.0  # deceleration of full braking [m/s2]


def visible_noise(before: GreyImage, image: GreyImage) -> float:
    """Least mean difference of the cells of two images [grey levels]: the noise, if some cell shows no motion."""
    cells = [max(side // _CELL, 1) for side in reversed(image.shape)]
    difference, inside = (
        cv2.resize(of_all, cells, interpolation=cv2.INTER_AREA)
        for of_all in (cv2.absdiff(before, image), cv2.inRange(image, *unclipped_range(image).tolist()))
    )
    shown = difference[inside >= 255.0 * (1.0 - CLIPPED)]
    return float(shown.min()) if shown.size else 0.0


def is_repeated(before: GreyImage, image: GreyImage, noise: float, last: Motion | None) -> bool:
    """True if an image repeats the one before, for the camera's ``noise`` [grey levels] and the last known motion."""
    if last is None:
        return repeats(before, image, math.inf, must_differ=False)
    span = (last.tick - last.previous_tick) * TICK
    too_fast = float(np.linalg.norm(last.X_PC[:3, 3])) > _BRAKING * span**2  # to stand one frame later
    return repeats(before, image, noise, must_differ=too_fast)


def repeats(before: GreyImage, image: GreyImage, noise: float, *, must_differ: bool) -> bool:
    """True if an image is the one before, once more.

    Args:
        before: an image of the same camera.
        image: a later one.
        noise: of the camera, 0 if none has been seen yet [grey levels].
        must_differ: the camera has moved, so that even without noise its images differ.
    """
    if not must_differ and noise <= _LEAST_NOISE:
        return False
    most = (_ALIKE if must_differ else _EQUAL) * image.size  # sum of all differences; some rows may exceed it
    return all(cv2.norm(before[rows], image[rows], cv2.NORM_L1) < most for rows in (slice(None, None, 8), slice(None)))


# By the rims; the ground then moves by several pixels. The image shows the wheel, so that one that slips in place is
# seen to turn [m]
_MOVED: Final = 0.005


class NewViewsMemory(NamedTuple):
    """Memory between two messages."""

    estimator: Any
    last: RoverView | None  # newest view with an image of its own
    noise: float  # of the camera, seen at standstill; 0: not known [grey levels]


class NewViews(Estimator[NewViewsMemory, Any, SlipAngle]):
    """A slip estimator that gets no repeated views; in their place the slip angle is lost."""

    def __init__(self, estimator: SlipEstimator, wheel_radius: float) -> None:
        """Pass the views of a rover with this ``wheel_radius`` [m] on to an ``estimator``; all other messages, too."""
        self.wrapped, self._radius = estimator, wheel_radius

    def init(self) -> NewViewsMemory:
        """Before the first message."""
        return NewViewsMemory(self.wrapped.init(), None, 0.0)

    def step(self, memory: NewViewsMemory, message: Any) -> tuple[NewViewsMemory, SlipAngle]:
        """Memory and slip angle; LOST for a repeated view, which leaves the estimator's memory as it was."""
        if isinstance(message, RoverView):
            if memory.last is not None:
                speeds = np.abs(memory.last.wheel_speeds).mean() + np.abs(message.wheel_speeds).mean()
                rolled = math.fabs(0.5 * float(speeds)) * self._radius * (message.tick - memory.last.tick) * TICK
                if repeats(memory.last.image, message.image, memory.noise, must_differ=rolled > _MOVED):
                    return memory, lost_slip(message.tick)
                if rolled == 0.0:
                    memory = memory._replace(noise=visible_noise(memory.last.image, message.image))
            memory = memory._replace(last=message)
        inner, estimate = self.wrapped.step(memory.estimator, message)
        return memory._replace(estimator=inner), estimate

    def close(self) -> None:
        """Close the estimator."""
        close_part(self.wrapped)
