"""Ground truth of a rover at one tick.

Frame R has its origin in the body centre's projection on the ground, x forward, y left, z up. Only ``sensors`` and
``scenarios`` may look at the truth.
"""

import math
from dataclasses import dataclass
from typing import Final

from vehicle.frames import FloatArray

_STANDING: Final = 0.01  # below this speed a rover settles and does not travel [m/s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverTruth:
    """True state of a rover."""

    tick: int
    pose: FloatArray  # (3,) x [m], y [m], psi [rad] of R in W, psi continuous
    velocity: FloatArray  # (3,) v_x, v_y [m/s] of R's origin along the body's axes, yaw rate [rad/s]
    X_WB: FloatArray  # (4, 4) pose of the body, with slope, roll, pitch and sinkage; on level hard ground that of R
    wheel_positions: FloatArray  # (n, 3) lowest point of each wheel in W [m], below the ground by the sinkage
    wheel_headings: FloatArray  # (n,) direction of each wheel in W [rad]
    wheel_velocities: FloatArray  # (n, 2) of each wheel's centre, along and across (+ left) its own heading [m/s]
    wheel_speeds: FloatArray  # (n,) of rotation, + forward [rad/s]
    wheel_turns: FloatArray  # (n,) angle rolled since the start [rad]
    steer: FloatArray  # (n,) against the body, + left [rad]
    slip_ratios: FloatArray  # (n,) (r omega - v_x) / r omega driving, / v_x braking [-]
    slip_angles: FloatArray  # (n,) direction of travel of each wheel against its heading, + left [rad]
    sinkages: FloatArray  # (n,) [m]
    loads: FloatArray  # (n,) force on each wheel normal to the ground [N]

    @property
    def slip_angle(self) -> float:
        """Direction of travel of R's origin relative to the body's x axis, + left; 0 at a standstill [rad].

        This is beta of Reina 2008, eq. 1.
        """
        v_x, v_y, _ = self.velocity.tolist()
        return math.atan2(v_y, v_x) if math.hypot(v_x, v_y) > _STANDING else 0.0
