"""Off-tracking from the poses of a reference unit, by the same path buffer."""

from typing import ClassVar, NamedTuple, Self

import numpy as np

from estimators.context import TrailerContext
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from sensors.messages import BodyPose
from vehicle.frames import inverse, raised


class ReferenceMemory(NamedTuple):
    """The last pose and the buffer."""

    previous: BodyPose | None
    buffer: BufferMemory


class ReferenceOffTracking:
    """Off-tracking from the poses of a reference unit; the unit's own errors are not included in ``std``."""

    sensor: ClassVar[str] = "reference_pose"

    def __init__(self, follow_distance: float, *, path_height: float = 0.0) -> None:
        """For a follow point ``follow_distance`` [m] behind the hitch, and paths at ``path_height`` [m] in the body.

        At the height of its roll axis a body does not move to the side as it rolls.

        Raises:
            ValueError: if ``follow_distance`` is not positive.
        """
        self._X_SP = raised(path_height)
        self._buffer = OffTrackingBuffer(follow_distance)

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator for the context's trailer."""
        return cls(context.follow_distance)

    def init(self) -> ReferenceMemory:
        """Memory before the first pose."""
        return ReferenceMemory(None, self._buffer.init())

    def step(self, memory: ReferenceMemory, pose: BodyPose) -> tuple[ReferenceMemory, OffTracking | None]:
        """Memory with the pose in it, and the off-tracking at its tick; None for the first pose."""
        if memory.previous is None:
            return ReferenceMemory(pose, memory.buffer), None
        tick, X_PC = memory.previous.tick, inverse(memory.previous.X_WB @ self._X_SP) @ (pose.X_WB @ self._X_SP)
        exact = np.zeros((6, 6))
        motion = BodyMotion(tick=pose.tick, previous_tick=tick, X_PC=X_PC, covariance=exact, health=Health.OK)
        buffer, off_tracking = self._buffer.step(memory.buffer, motion)
        return ReferenceMemory(pose, buffer), off_tracking
