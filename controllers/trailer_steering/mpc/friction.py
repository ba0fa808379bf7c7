"""Friction and disturbing moment of a trailer, from what an accelerometer at its axles says the tyres must be doing.

About the hitch the side forces of the tyres balance m c times the specific force at the centre of percussion, where
loaded semitrailers have their axles. A model of the tyres on their measured way says what they would do on ground of
a given friction. The difference tells friction where the tyres slide enough for it to matter, and otherwise a moment
that nothing explains, which is carried on: the prediction then has no offset. An extended Kalman filter of the two.
A hitch that suddenly travels elsewhere than was thought looks like a loss of friction; the filter is told of it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from vehicle.frames import FloatArray

_FIRST: Final = 0.45  # friction before any is felt: between a dry road and packed snow [-]
_SPREAD: Final = 0.5  # of its log at most, 1 sigma: two of them reach from 0.17 to 1.2
_RANGE: Final = (math.log(0.12), math.log(1.0))  # of its log: wet ice, dry asphalt
_FRICTION_WANDER: Final = 0.15  # of its log per root metre: a change is noticed within the length of a trailer
_MOMENT_SPREAD: Final = 0.03  # of the disturbance [-]: a stiffness of the tyres known to a tenth or two
_MOMENT_LENGTH: Final = 20.0  # over which it is forgotten; else friction and it would drift against each other [m]
_NOISE: Final = 0.04  # of a measurement over a metre [-]: accelerometer, load transfer, stiffness of the tyres


class FrictionMemory(NamedTuple):
    """The estimate."""

    log_friction: float = math.log(_FIRST)
    disturbance: float = 0.0  # yaw moment that nothing explains, over the load moment, + left [-]
    variance: tuple[float, float, float] = (_SPREAD**2, 0.0, _MOMENT_SPREAD**2)  # of both: 11, 12, 22

    @property
    def friction(self) -> float:
        """The friction coefficient [-]."""
        return math.exp(self.log_friction)


def updated(memory: FrictionMemory, surplus: float, by_friction: float, way: float, doubt: float) -> FrictionMemory:
    """The estimate ``way`` [m] further on.

    Args:
        memory: the estimate before.
        surplus: moment of the model's tyres less the disturbance and the moment measured, over the load moment [-].
        by_friction: what the tyres' moment changes by per log of the friction [-].
        way: made since [m].
        doubt: what the model's moment may err by for the tyres' way not being known, 1 sigma [-].
    """
    if way <= 0.0:
        return memory
    a, b, c = memory.variance
    kept = math.exp(-way / _MOMENT_LENGTH)
    a, c = min(a + _FRICTION_WANDER**2 * way, _SPREAD**2), _MOMENT_SPREAD**2 + (c - _MOMENT_SPREAD**2) * kept**2
    P: FloatArray = np.array([[a, b * kept], [b * kept, c]])
    h = np.array([by_friction, -1.0])
    gain = P @ h / (h @ P @ h + (_NOISE**2 + doubt**2) / way)
    P = P - np.outer(gain, h @ P)
    log_friction = memory.log_friction - float(gain[0]) * surplus
    return FrictionMemory(
        log_friction=max(_RANGE[0], min(_RANGE[1], log_friction)),
        disturbance=memory.disturbance * kept - float(gain[1]) * surplus,
        variance=(float(P[0, 0]), float(P[0, 1]), float(P[1, 1])),
    )
