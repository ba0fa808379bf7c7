"""Repeated views of a rover: the previous image once more, under a new time, from a camera or link that is frozen.

They show the trace of a while ago, and no slip estimator can tell. Noise differs from image to image, also of a rover
that stands: equal images are repeated ones. A camera that shows no noise is only judged while the wheels turn.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from estimators.context import SlipEstimator
from estimators.estimates import SlipAngle, lost_slip
from estimators.odometry.repeated_frames import repeats, visible_noise
from estimators.protocol import Estimator
from sensors.messages import RoverView
from vehicle.clock import TICK
from vehicle.closing import close_part

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
                rolled = self._rolled(memory.last, message)
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

    def _rolled(self, last: RoverView, view: RoverView) -> float:
        """Distance that the wheels have rolled between two views [m]."""
        speed = 0.5 * (np.abs(last.wheel_speeds).mean() + np.abs(view.wheel_speeds).mean())
        return math.fabs(float(speed)) * self._radius * (view.tick - last.tick) * TICK
