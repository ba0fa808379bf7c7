"""Off-tracking from exact poses of the trailer body: the same buffer, without any odometry before it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.estimates import Health, OffTracking
from estimators.off_tracking import BodyMotion, BufferMemory, OffTrackingBuffer
from sensors.messages import BodyPose
from vehicle.frames import inverse


class ReferenceMemory(NamedTuple):
    """The last pose and the buffer."""

    previous: BodyPose | None
    buffer: BufferMemory


class ReferenceOffTracking:
    """The off-tracking that the poses of a reference unit show; its own errors are not modelled in ``std``."""

    def __init__(self, follow_distance: float) -> None:
        """For a follow point ``follow_distance`` [m] behind the hitch.

        Raises:
            ValueError: if ``follow_distance`` is not positive.
        """
        self._buffer = OffTrackingBuffer(follow_distance)

    def init(self) -> ReferenceMemory:
        """Memory before the first pose."""
        return ReferenceMemory(None, self._buffer.init())

    def step(self, memory: ReferenceMemory, pose: BodyPose) -> tuple[ReferenceMemory, OffTracking | None]:
        """Memory with the pose in it, and the off-tracking at its tick; None for the first pose."""
        if memory.previous is None:
            return ReferenceMemory(pose, memory.buffer), None
        motion = BodyMotion(
            tick=pose.tick,
            previous_tick=memory.previous.tick,
            X_PC=inverse(memory.previous.X_WB) @ pose.X_WB,
            covariance=np.zeros((6, 6)),
            health=Health.OK,
        )
        buffer, off_tracking = self._buffer.step(memory.buffer, motion)
        return ReferenceMemory(pose, buffer), off_tracking
