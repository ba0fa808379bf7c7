"""Interface of stereo odometry: the motion from frame to frame."""

from __future__ import annotations

from typing import Protocol

from estimators.estimates import Motion
from estimators.protocol import Estimator, Memory
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame


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
