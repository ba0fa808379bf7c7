"""Check of a claimed standstill by the images alone, without any calibration of the pair.

A yaw error that makes disparities too large moves far scenery near. At high speed it is then the only part of the view
that is found again, and it agrees with no motion at all.
"""

from __future__ import annotations

import numpy as np

from estimators.odometry.corners import detect_corners
from estimators.odometry.local_planes import rays_through
from estimators.odometry.point_tracking import LEVELS_NEAR, track
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage

STANDING = 0.1  # motion that counts as none: it shifts the ground in view by less than 3 px [m]
_STILL = 3.0  # largest shift of a corner that stands [px]
_NEAR = 0.12  # slope of a ray to the ground, downwards: nearer than some eight camera heights
_FEWEST = 20  # corners on the ground
_SHARE = 0.5  # of them, that stand in the images of a camera that stands
_PER_BUCKET = 2


def ground_moves(calibration: StereoCalibration, before: GreyImage, now: GreyImage) -> bool:
    """True if most of the ground in two successive left images has moved on; False if that cannot be seen."""
    corners = detect_corners(before, per_bucket=_PER_BUCKET)
    down = -rays_through(calibration, corners) @ calibration.X_SC[2, :3]
    ground = corners[down > _NEAR]
    if len(ground) < _FEWEST:
        return False
    found, tracked = track(before, now, ground, ground, LEVELS_NEAR)
    still = tracked & (np.abs(found - ground).max(axis=1) < _STILL)
    return bool(np.count_nonzero(still) < _SHARE * len(ground))
