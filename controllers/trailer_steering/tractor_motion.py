"""Motion of a tractor's rear axle from wheel speed, steer angle and yaw rate, with slip by the data sheet.

The rear axle slips in proportion to the lateral acceleration, and by the scrub of all tyres. The front wheels, whose
speed is measured, roll along the direction in which they point and not in that in which they travel; the yaw rate tells
the two apart.
"""

from __future__ import annotations

import math

from controllers.trailer import Combination
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals

# As in ``estimators.off_tracking.dead_reckoning``, where their spread is stated.
_REAR = -0.02  # slip of driven truck tyres per lateral acceleration: 1/(5 g) [rad s2/m]
_SCRUB = 0.9  # 1 if tyres are linear, 0.7 on friction of 0.3 [-]


class TractorMotion:
    """Velocity of a tractor's rear axle."""

    def __init__(self, combination: Combination) -> None:
        """For the signals of the combination's steered trailer."""
        self._front_x = combination.vehicle.units[0].steered_axles[0].x
        self._scrub = TyreScrub(combination.vehicle, combination.unit)

    def slip(self, signals: CombinationSignals) -> float:
        """Slip angle of the rear axle [rad], + when it moves to the left of its own direction of travel."""
        acceleration = signals.speed * float(signals.yaw_rates[0])
        return _REAR * acceleration + _SCRUB * self._scrub.slip(signals)

    def speed(self, signals: CombinationSignals, slip: float) -> float:
        """Speed of the rear axle [m/s] with its slip angle [rad].

        ``signals.speed`` is the rolling speed of the front wheels times the cosine of their angle.
        """
        c, s = math.cos(signals.steer), math.sin(signals.steer)
        return (signals.speed - self._front_x * float(signals.yaw_rates[0]) * s * c) / (c * c + slip * s * c)
