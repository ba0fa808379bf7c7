"""Motion of a tractor's rear axle from wheel speed, steer angle and yaw rate, with slip by the data sheet.

The rear axle slips in proportion to the lateral acceleration, and by the scrub of all tyres. Steered axles of a trailer
whose angles are not among the signals are assumed to roll. The front wheels, whose speed is measured, roll along the
direction in which they point and not in that in which they travel; the yaw rate tells the two apart.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from controllers.trailer import Combination
from controllers.trailer_steering.hitch_motion import hitch_motion
from controllers.trailer_steering.kinematics import limited_direction
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from vehicle.frames import FloatArray

# As in ``estimators.off_tracking.dead_reckoning``, where their spread is stated.
_REAR = -0.02  # slip of driven truck tyres per lateral acceleration: 1/(5 g) [rad s2/m]
_SCRUB = 0.9  # 1 if tyres are linear, 0.7 on friction of 0.3 [-]
_SLOWEST = 0.5  # a direction below this speed is noise [m/s]


class TractorMotion:
    """Velocity of a tractor's rear axle."""

    def __init__(self, combination: Combination) -> None:
        """For the signals of the combination's steered trailer."""
        units = combination.vehicle.units
        self._unit, self._front_x = combination.unit, units[0].steered_axles[0].x
        towed = range(1, combination.unit + 1)
        steered = next(k for k in towed if k == combination.unit or any(axle.steered for axle in units[k].axles))
        self._foremost = Combination(combination.vehicle, steered)
        self._axles = np.array([axle.x for axle in units[steered].axles if axle.steered])
        self._scrub = TyreScrub(combination.vehicle, steered)

    def slip(self, signals: CombinationSignals) -> float:
        """Slip angle of the rear axle [rad], + when it moves to the left of its own direction of travel."""
        acceleration = signals.speed * float(signals.yaw_rates[0])
        return _REAR * acceleration + _SCRUB * self._scrub.slip(self._known(signals))

    def speed(self, signals: CombinationSignals, slip: float) -> float:
        """Speed of the rear axle [m/s] with its slip angle [rad].

        ``signals.speed`` is the rolling speed of the front wheels times the cosine of their angle.
        """
        c, s = math.cos(signals.steer), math.sin(signals.steer)
        return (signals.speed - self._front_x * float(signals.yaw_rates[0]) * s * c) / (c * c + slip * s * c)

    def _known(self, signals: CombinationSignals) -> CombinationSignals:
        """The signals with the angles of the foremost steered trailer."""
        if self._foremost.unit == self._unit:
            return signals
        return replace(signals, angles=self._rolling(signals))

    def _rolling(self, signals: CombinationSignals) -> FloatArray:
        v_x, v_y, yaw_rate = hitch_motion(self._foremost, signals)
        travel = (v_y + self._axles * yaw_rate) / math.copysign(max(abs(v_x), _SLOWEST), v_x)
        return np.array([limited_direction(math.atan(direction)) for direction in travel.tolist()])
