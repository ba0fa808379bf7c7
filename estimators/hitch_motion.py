"""Velocity of a trailer's hitch from the combination's own signals, carried backwards from hitch to hitch."""

import math
from collections.abc import Sequence
from typing import NamedTuple


class HitchMotion(NamedTuple):
    """Motion of a unit at its front hitch (of the tractor at its rear axle), along its own axes."""

    v_x: float  # [m/s]
    v_y: float  # + left [m/s]
    yaw_rate: float  # [rad/s]

    @property
    def direction(self) -> float:
        """Direction of the line along which the hitch travels, either way, against the unit's axis, + left [rad]."""
        return math.atan2(math.copysign(1.0, self.v_x) * self.v_y, abs(self.v_x))


def hitch_motions(
    v_x: float, v_y: float, levers: Sequence[float], yaw_rates: Sequence[float], articulations: Sequence[float]
) -> list[HitchMotion]:
    """Motion of the tractor and of every unit behind it, from the velocity [m/s] of the tractor's rear axle.

    There are n ``levers`` (`Vehicle.hitch_levers`), n + 1 yaw rates [rad/s] and n articulations [rad] or more.
    """
    motions = [HitchMotion(v_x, v_y, yaw_rates[0])]
    for k, (lever, articulation) in enumerate(zip(levers, articulations, strict=False)):
        v_y += yaw_rates[k] * lever
        c, s = math.cos(articulation), math.sin(articulation)
        v_x, v_y = c * v_x - s * v_y, s * v_x + c * v_y
        motions.append(HitchMotion(v_x, v_y, yaw_rates[k + 1]))
    return motions
