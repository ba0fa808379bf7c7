"""Ground truth of a vehicle, which sensors sample and metrics are computed from.

Only ``sensors`` and ``scenarios`` may import it; an import contract forbids it to estimators and controllers.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    load_transfer: (
        FloatArray  # (N,) right less left wheel loads of each unit over their sum; at +-1 it is about to roll over
    )
