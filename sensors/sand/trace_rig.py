"""Calibrated camera behind a rover's left rear wheel, and the nominal one of Reina 2008."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from sensors.camera.rig import CameraModel
from vehicle.frames import FloatArray, inverse, transform
from vehicle.rover.command import WheelPlace
from vehicle.rover.description import Rover


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
        return self.camera.matrix @ np.column_stack([X_CR[:3, 0], X_CR[:3, 1], X_CR[:3, 3]])


# The paper gives the field of view and says that the camera is a webcam on a frame on the body. The rest follows or is
# assumed.
_BEHIND: Final = 0.10  # from the wheel's centre back to the camera, above the wheel's rear edge [m]
_HEIGHT: Final = 0.75  # above hard ground [m]
_TILT: Final = math.radians(15.0)  # backwards from straight down
_FOCAL: Final = 620.0  # [px]: 0.80 m across in the middle, 0.63 m along
_DISTORTION: Final = (-0.09, 0.03, 0.0006, -0.0004, 0.0)  # of a webcam's lens: barrel, 2 % in the corners; assumed


def nominal_rig(rover: Rover) -> TraceRig:
    """Calibrated camera of a rover; the lower edge of the image is at the wheel, the right edge on the rover's left."""
    x, y = rover.wheel_places[rover.rear_left].tolist()
    right, ahead = np.array([0.0, 1.0, 0.0]), np.array([-math.sin(_TILT), 0.0, -math.cos(_TILT)])
    R_RC = np.column_stack([right, np.cross(ahead, right), ahead])
    return TraceRig(
        camera=CameraModel(width=640, height=480, fx=_FOCAL, fy=_FOCAL, cx=319.5, cy=239.5, distortion=_DISTORTION),
        X_RC=transform(R_RC, np.array([x - _BEHIND, y, _HEIGHT])),
        wheel=(x, y),
        wheel_radius=rover.radius,
        wheel_width=rover.width,
        wheels=rover.places,
        watched=rover.rear_left,
    )
