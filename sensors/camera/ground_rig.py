"""Two cameras under a trailer that look straight down at the ground (Miao's ground-watching navigation system).

One is near the fifth wheel, one near the follow point, as described in section 1.2 of C. de Saxe, D. Cebon,
"Estimation of trailer off-tracking using visual odometry", Vehicle System Dynamics, 2018.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sensors.camera.rig import StereoCalibration
from vehicle.frames import transform

# The image's columns run to the rear (x of C against x of S), its rows to the left, the camera looks down. The
# rear camera then lies on the front one's x axis, as the right camera of any pair lies on the left one's.
_R_SC = np.diag([-1.0, 1.0, -1.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundRig:
    """Two equal cameras below the chassis, on the trailer's axis, looking straight down."""

    width: int  # along the trailer [px]
    height: int  # across it [px]
    hfov: float  # field of view along the trailer [rad]
    front_x: float  # the front camera, from the hitch [m], negative behind it
    rear_x: float  # the rear camera [m]
    z: float  # both, above the ground [m]

    def calibration(self) -> StereoCalibration:
        """Exact calibration of this rig: ``left`` is the front camera, ``right`` the rear one.

        Raises:
            ValueError: if the rear camera is not behind the front one.
        """
        if not self.rear_x < self.front_x:
            raise ValueError(f"rear_x = {self.rear_x} m must be less than front_x = {self.front_x} m")
        return StereoCalibration(
            width=self.width,
            height=self.height,
            focal_length=0.5 * self.width / math.tan(0.5 * self.hfov),
            cx=0.5 * (self.width - 1),
            cy=0.5 * (self.height - 1),
            baseline=self.front_x - self.rear_x,
            X_SC=transform(_R_SC, np.array([self.front_x, 0.0, self.z])),
        )
