"""Calibrated camera behind a rover's left rear wheel, with the dimensions of the rover."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.camera.lens import CameraModel
from vehicle.frames import FloatArray, inverse
from vehicle.rover.command import WheelPlace


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TraceRig:
    """Calibrated camera, its pose on the rover, and the wheel whose trace it watches.

    R is the rover's frame: body centre on the ground, x forward, y left, z up. The pose is that on level hard ground.
    """

    camera: CameraModel
    X_RC: FloatArray  # (4, 4)
    wheel: tuple[float, float]  # B, place of the watched wheel in R [m]
    wheel_radius: float  # [m]
    wheel_width: float  # [m]
    wheels: tuple[WheelPlace, ...]  # all wheels of the rover
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
