"""Interface of every estimator, and of stereo odometry."""

from __future__ import annotations

from typing import Protocol, TypeVar, runtime_checkable

from estimators.estimates import Motion
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame

Memory = TypeVar("Memory")
MessageT_contra = TypeVar("MessageT_contra", contravariant=True)
EstimateT_co = TypeVar("EstimateT_co", covariant=True)


class Estimator(Protocol[Memory, MessageT_contra, EstimateT_co]):
    """Recursive estimator without hidden state: everything it remembers is in the memory passed in and returned."""

    def init(self) -> Memory:
        """Memory before the first message."""

    def step(self, memory: Memory, message: MessageT_contra, /) -> tuple[Memory, EstimateT_co | None]:
        """Memory after the message, and the estimate at its tick if there is a new one."""


@runtime_checkable
class FusesSignals(Protocol):
    """Declaration of an estimator of stereo frames that can use the signals of the combination as well."""

    fuses_signals: bool  # True: its messages are `sensors.messages.TrailerView` instead of `StereoFrame`


class Odometry(Estimator[Memory, StereoFrame, Motion], Protocol[Memory]):
    """Motion of the left camera from frame to frame, constructed from a `StereoCalibration`; None for the first."""


def above_ground(calibration: StereoCalibration) -> StereoCalibration:
    """Return the calibration if its left camera is above the ground.

    Raises:
        ValueError: if the left camera is not above the ground.
    """
    height = float(calibration.X_SC[2, 3])
    if not height > 0.0:
        raise ValueError(f"camera height X_SC[2, 3] = {height} m must be positive")
    return calibration
