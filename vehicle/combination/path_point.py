"""Points of a trailer that off-tracking is about.

Hitch and follow point lie on the trailer's axis at the height of its roll axis, ``Unit.roll_axis_height``: points
there do not move to the side as the body rolls. The off-tracking is measured in plan, seen from above: where the path
of the first passes the second, square to the trailer's heading. On level ground this is the path on the ground. On a
bank both points lie beside those on the ground, by bank times height (18 mm at 2.5 % and 0.7 m); the difference
matters only where the bank changes along the path, or turns with it.

The true off-tracking, exact reference poses and the estimates from motions of the body all mean these points.
"""

from __future__ import annotations

import numpy as np

from vehicle.frames import FloatArray


def plan_pose(X_WB: FloatArray, height: float) -> FloatArray:
    """Position x, y [m] and heading psi [rad] in W (..., 3) of the hitch of bodies at X_WB (..., 4, 4).

    The point is at ``height`` [m] in the body. The origin of B is on the ground below the hitch. The heading is that of
    the body's x axis.
    """
    position = X_WB[..., :2, 3] + height * X_WB[..., :2, 2]
    heading = np.arctan2(X_WB[..., 1, 0], X_WB[..., 0, 0])
    return np.concatenate([position, heading[..., None]], axis=-1)
