"""What any odometry of a stereo rig is: the motions between its frames, from init and step alone."""

from __future__ import annotations

from typing import Protocol, TypeVar

from estimators.estimates import Motion
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame

Memory = TypeVar("Memory")


class Odometry(Protocol[Memory]):
    """Motion of the left camera from frame to frame; all that it remembers is in the memory handed in and out."""

    def init(self) -> Memory:
        """Memory before the first frame."""
        ...

    def step(self, memory: Memory, frame: StereoFrame) -> tuple[Memory, Motion | None]:
        """Memory with the frame in it, and the motion that ends at it; None for the first frame."""
        ...


def above_ground(calibration: StereoCalibration) -> StereoCalibration:
    """The calibration, if its cameras can see the ground from above.

    Raises:
        ValueError: if the left camera is not above the ground.
    """
    height = float(calibration.X_SC[2, 3])
    if not height > 0.0:
        raise ValueError(f"camera height X_SC[2, 3] = {height} m must be positive")
    return calibration
