"""Effect of what is not known of a pair's calibration on the motions measured with it."""

from __future__ import annotations

import numpy as np

from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray

_LEAST_DISTANCE = 0.01  # below it the trailer stands [m]
_CONSTANT_OVER = 14.0  # distance over which an error of the calibration is constant: its effects add linearly [m]
# All of these were measured with keyframe and circular odometry on rendered drives: by 0.15 deg of roll and yaw and 0.1
# deg of pitch, and by pairs 10 to 50 ms apart at 10 to 60 km/h.
_SEEN_DEPTH = 5.3  # depth at which a disparity error scales the motion, in camera heights
_ALONG = np.array([0.2, 1.0, 0.1])  # scale error by roll, yaw and pitch, relative to that by yaw
_ACROSS = np.array([0.3, 1.0, 0.6])  # the same for the directions that a scale error does not change
_SIDEWAYS, _TURN = 0.1, 0.006  # those errors: share of the distance, and per distance [rad/m]
# The same by a displacement of one baseline along the optical axis, by which depths are wrong in proportion to x.
_SHIFT_ALONG, _SHIFT_SIDEWAYS, _SHIFT_TURN = 0.4, 0.07, 0.006


def doubt_covariance(calibration: StereoCalibration, X: FloatArray, angles: FloatArray, shift: float) -> FloatArray:
    """Covariance (6, 6) of a motion X (4, 4) from errors of roll, yaw and pitch (3,) [rad] and of a shift [m].

    Mainly the translation is scaled. Errors are constant over a trailer length, but those of motions count as
    independent: hence the factor, the number of motions in that length.
    """
    p, depth = X[:3, 3], _SEEN_DEPTH * float(calibration.X_SC[2, 3])
    distance = float(np.linalg.norm(p))
    scale = depth / calibration.baseline * angles
    relative = shift / calibration.baseline
    along, across = (float(np.linalg.norm(share * scale)) for share in (_ALONG, _ACROSS))
    sideways = np.hypot(_SIDEWAYS * across, _SHIFT_SIDEWAYS * relative) * distance
    turn = np.hypot(_TURN * across, _SHIFT_TURN * relative) * distance
    covariance = np.diag([turn**2] * 3 + [sideways**2] * 3)
    covariance[3:, 3:] += (along**2 + (_SHIFT_ALONG * relative) ** 2) * np.outer(p, p)
    factored: FloatArray = max(1.0, _CONSTANT_OVER / max(distance, _LEAST_DISTANCE)) * covariance
    return factored
