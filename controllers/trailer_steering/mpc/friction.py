"""Friction and disturbance moment of a trailer, estimated with an accelerometer at its axles.

About the hitch the side forces of the tyres balance m c times the specific force at the centre of percussion, close to
the axles of a loaded semitrailer. A tyre model on the measured motion predicts the side forces for a given friction.
The difference is due to friction where the tyres slide enough for it to matter, and otherwise to an unknown moment,
which is kept so that the prediction has no offset. An extended Kalman filter estimates both. An unexpected direction of
the hitch's travel looks like a loss of friction; ``uncertainty`` tells the filter.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from vehicle.frames import FloatArray

_FIRST: Final = 0.45  # friction before any measurement: between a dry road and packed snow [-]
_SPREAD: Final = 0.5  # standard deviation of its log at most: 2 sigma reach from 0.17 to 1.2
_RANGE: Final = (math.log(0.12), math.log(1.0))  # of its log: wet ice, dry asphalt
_FRICTION_WALK: Final = 0.15  # random walk of its log per root metre: detects a change within a trailer's length
_MOMENT_SPREAD: Final = 0.03  # standard deviation of the disturbance [-]: tyre stiffness known to 10 or 20 %
_MOMENT_LENGTH: Final = 20.0  # over which it decays; otherwise it and the friction would drift apart [m]
_NOISE: Final = 0.04  # of a measurement over a metre [-]: accelerometer, load transfer, stiffness of the tyres


class FrictionMemory(NamedTuple):
    """The estimate."""

    log_friction: float = math.log(_FIRST)
    disturbance: float = 0.0  # unknown yaw moment over the load moment, + left [-]
    variance: tuple[float, float, float] = (_SPREAD**2, 0.0, _MOMENT_SPREAD**2)  # of both: 11, 12, 22

    @property
    def friction(self) -> float:
        """The friction coefficient [-]."""
        return math.exp(self.log_friction)


def updated(
    memory: FrictionMemory, surplus: float, by_friction: float, distance: float, uncertainty: float
) -> FrictionMemory:
    """The estimate after a ``distance`` [m].

    Args:
        memory: the estimate before.
        surplus: moment of the model's tyres less the disturbance and the moment measured, over the load moment [-].
        by_friction: derivative of the tyres' moment by the log of the friction [-].
        distance: travelled since the estimate before [m].
        uncertainty: standard deviation of the model's moment due to the tyres' motion [-].
    """
    if distance <= 0.0:
        return memory
    a, b, c = memory.variance
    kept = math.exp(-distance / _MOMENT_LENGTH)
    a, c = min(a + _FRICTION_WALK**2 * distance, _SPREAD**2), _MOMENT_SPREAD**2 + (c - _MOMENT_SPREAD**2) * kept**2
    P: FloatArray = np.array([[a, b * kept], [b * kept, c]])
    h = np.array([by_friction, -1.0])
    gain = P @ h / (h @ P @ h + (_NOISE**2 + uncertainty**2) / distance)
    P = P - np.outer(gain, h @ P)
    log_friction = memory.log_friction - float(gain[0]) * surplus
    return FrictionMemory(
        log_friction=max(_RANGE[0], min(_RANGE[1], log_friction)),
        disturbance=memory.disturbance * kept - float(gain[1]) * surplus,
        variance=(float(P[0, 0]), float(P[0, 1]), float(P[1, 1])),
    )
