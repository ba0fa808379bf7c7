"""The camera behind a rover's left rear wheel, as it is calibrated, and what it has to know of the wheel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.camera.lens import CameraModel
from vehicle.frames import FloatArray, inverse
from vehicle.rover.command import WheelPlace


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TraceRig:
    """Calibrated camera, its place on the rover, and the wheel whose trace it watches.

    R is the rover's frame: body centre on the ground, x forward, y left, z up; the camera's place is that on a rover
    that stands level on hard ground.
    """

    camera: CameraModel
    X_RC: FloatArray  # (4, 4)
    wheel: tuple[float, float]  # B, where the wheel stands, in R [m]
    wheel_radius: float  # [m]
    wheel_width: float  # [m]
    wheels: tuple[WheelPlace, ...]  # all of the rover's
    watched: int  # index of the wheel whose trace is in view

    @property
    def wheelbase(self) -> float:
        """Distance from the rearmost to the foremost wheels [m]."""
        return max(wheel.x for wheel in self.wheels) - min(wheel.x for wheel in self.wheels)

    def image_of_ground(self) -> FloatArray:
        """Homography (3, 3) from ground points (x, y, 1) in R [m] to undistorted pixels (u, v, w)."""
        X_CR = inverse(self.X_RC)
        H: FloatArray = self.camera.matrix @ np.column_stack([X_CR[:3, 0], X_CR[:3, 1], X_CR[:3, 3]])
        return H
