"""Ground truth of a vehicle, which sensors sample and metrics are computed from, and the points it is about.

Only ``sensors`` and ``scenarios`` may import it; an import contract forbids it to estimators and controllers.

Hitch and follow point lie on the trailer's axis at the height of its roll axis, ``Unit.roll_axis_height``: points
there do not move to the side as the body rolls. The off-tracking is measured in plan, seen from above: where the path
of the first passes the second, square to the trailer's heading. On level ground this is the path on the ground. On a
bank both points lie beside those on the ground, by bank times height (18 mm at 2.5 % and 0.7 m); the difference
matters only where the bank changes along the path, or turns with it.

The true off-tracking, exact reference poses and the estimates from motions of the body all mean these points.
"""

from dataclasses import dataclass

import numpy as np

from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """True state of a chain of N units at one tick; unit 0 is the tractor, each unit i > 0 is towed by unit i - 1."""

    tick: int
    poses: FloatArray  # (N, 3) x [m], y [m], psi [rad] of each unit's frame (T, S, ...) in W
    velocities: FloatArray  # (N, 3) v_x, v_y [m/s] of each frame's origin along the unit's axes, yaw rate [rad/s]
    bodies: FloatArray  # (N, 4, 4) X_WB: pose of each sprung body, ground slope, pitch, roll and heave included
    steer: FloatArray  # (n_steered,) road-wheel angle of every steered axle, front to rear [rad]
    wheel_loads: FloatArray  # (n_wheels,) vertical tyre force [N]
    wheel_slip_angles: FloatArray  # (n_wheels,) slip angle of every wheel [rad]
    friction_used: FloatArray  # (n_wheels,) horizontal tyre force / (mu F_z) [-]
    # (N,) right less left wheel loads of each unit over their sum; at +-1 it is about to roll over
    load_transfer: FloatArray
    wheel_speeds: FloatArray | None = None  # (n_wheels,) of the tread, by the rotation [m/s]; None: it is not modelled


def plan_pose(X_WB: FloatArray, height: float) -> FloatArray:
    """Position x, y [m] and heading psi [rad] in W (..., 3) of the hitch of bodies at X_WB (..., 4, 4).

    The point is at ``height`` [m] in the body. The origin of B is on the ground below the hitch. The heading is that of
    the body's x axis.
    """
    position = X_WB[..., :2, 3] + height * X_WB[..., :2, 2]
    heading = np.arctan2(X_WB[..., 1, 0], X_WB[..., 0, 0])
    return np.concatenate([position, heading[..., None]], axis=-1)
