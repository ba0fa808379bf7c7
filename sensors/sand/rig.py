"""Nominal camera of Reina 2008: it sees 0.60 m by 0.80 m of ground behind the left rear wheel."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from sensors.camera.lens import CameraModel
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import transform
from vehicle.rover.description import Rover

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
