"""Motion of a trailer's hitch from the sensors of the combination: speed, gyros and articulation angles.

From the tractor's rear axle to the rear, every hitch adds its unit's yaw rate times its lever. The rear axle rolls
without slip unless its lateral speed is given.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from controllers.trailer import Combination
from sensors.messages import CombinationSignals


class HitchMotion(NamedTuple):
    """Motion of a trailer at its hitch, along its own axes."""

    v_x: float  # [m/s]
    v_y: float  # + left [m/s]
    yaw_rate: float  # [rad/s]

    @property
    def direction(self) -> float:
        """Direction of the line along which the hitch travels, either way, against the trailer's axis, + left [rad]."""
        return math.atan2(math.copysign(1.0, self.v_x) * self.v_y, abs(self.v_x))


def hitch_motion(combination: Combination, signals: CombinationSignals, lateral_speed: float = 0.0) -> HitchMotion:
    """Motion of the steered trailer; ``lateral_speed`` is that of the tractor's rear axle [m/s]."""
    v_x, v_y = signals.speed, lateral_speed
    towing = combination.vehicle.units[: combination.unit]
    for unit, angle, yaw_rate in zip(towing, signals.articulation.tolist(), signals.yaw_rates.tolist(), strict=False):
        v_y += yaw_rate * unit.rear_hitch[0]
        c, s = math.cos(angle), math.sin(angle)
        v_x, v_y = c * v_x - s * v_y, s * v_x + c * v_y
    return HitchMotion(v_x, v_y, float(signals.yaw_rates[combination.unit]))
