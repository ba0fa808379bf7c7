"""How the hitch of a trailer moves, by the sensors of the combination: speed, gyros and articulation angles.

From the tractor's rear axle back, every hitch adds its unit's yaw rate times its lever. That axle is taken to roll
without slip unless its lateral speed is given.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from controllers.trailer import Combination
from sensors.messages import CombinationSignals


class HitchMotion(NamedTuple):
    """Motion of a trailer, told at its hitch and along its own axes."""

    v_x: float  # [m/s]
    v_y: float  # + left [m/s]
    yaw_rate: float  # [rad/s]

    @property
    def direction(self) -> float:
        """Line along which the hitch travels, forwards or backwards, + left of the trailer's axis ahead [rad]."""
        return math.atan2(math.copysign(1.0, self.v_x) * self.v_y, abs(self.v_x))


def hitch_motion(combination: Combination, signals: CombinationSignals, sideways: float = 0.0) -> HitchMotion:
    """Motion of the steered trailer; ``sideways`` is the lateral speed of the tractor's rear axle [m/s]."""
    v_x, v_y = signals.speed, sideways
    towing = combination.vehicle.units[: combination.unit]
    for unit, angle, yaw_rate in zip(towing, signals.articulation.tolist(), signals.yaw_rates.tolist(), strict=False):
        v_y += yaw_rate * unit.rear_hitch[0]
        c, s = math.cos(angle), math.sin(angle)
        v_x, v_y = c * v_x - s * v_y, s * v_x + c * v_y
    return HitchMotion(v_x, v_y, float(signals.yaw_rates[combination.unit]))
