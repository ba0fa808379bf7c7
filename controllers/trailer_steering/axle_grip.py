"""Grip of a trailer's axles: how far they can be steered before their side force falls.

About the hitch the side forces of the tyres balance the inertia of the trailer, which the accelerometer above its axles
measures. The tyres' laws give the forces of the measured slip for a given friction; a Kalman filter finds the friction
that explains them (``controllers.trailer_steering.mpc.friction``). It is only known where tyres slide enough for it to
matter, and until then the benefit of the doubt is given: one standard deviation more.

The largest side force is reached at a slip in proportion to the friction. Beyond it an axle only brakes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from controllers.trailer import Combination
from controllers.trailer_steering.hitch_motion import hitch_motion
from controllers.trailer_steering.mpc.friction import FrictionMemory, updated
from controllers.trailer_steering.tractor_motion import TractorMotion
from sensors.messages import CombinationSignals
from vehicle.combination.description import GRAVITY
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.rollover import roll_gradients
from vehicle.frames import FloatArray
from vehicle.tyres import Planar

_SLOWEST: Final = 1.0  # below this speed directions of travel are noise [m/s]
_SLIPS: Final = np.arange(0.01, 1.0, 0.01)  # at which side forces are compared [rad]
_ENOUGH: Final = 0.95  # of the largest side force; the rest would take half as much slip again [-]
_MOTION_ERROR: Final = 0.01  # of directions of travel by the signals, 1 sigma [rad]
_STEP: Final = 0.05  # of the log of the friction, for derivatives


class GripMemory(NamedTuple):
    """Estimated friction, and the directions in which the steered axles travel."""

    friction: FrictionMemory = FrictionMemory()
    travel: FloatArray | None = None  # (n_steered,) directions in which the steered axles travel [rad]; None: unknown


class AxleGrip:
    """Grip of the axles of one trailer."""

    def __init__(self, combination: Combination) -> None:
        """For the signals of the combination's steered trailer."""
        vehicle = combination.vehicle
        unit = vehicle.units[combination.unit]
        self._combination, self._tractor = combination, TractorMotion(combination)
        self._tyres = [axle.tyre for axle in unit.axles]
        self._x = np.array([axle.x for axle in unit.axles])
        self._steered = np.array([axle.steered for axle in unit.axles])
        self._loads = np.array(static_axle_loads(vehicle)[combination.unit])
        self._share = self._x * self._loads / float(self._x @ self._loads)  # of the moment about the hitch [-]
        self._lean = 1.0 + GRAVITY * roll_gradients(vehicle)[combination.unit]
        self._stiffness = float(self._forces(np.full(len(self._x), 1e-3), 1.0) @ self._share) / 1e-3
        self._slip = self._slip_of_enough()

    def measured(self, memory: GripMemory, signals: CombinationSignals, elapsed: float) -> GripMemory:
        """Memory with new signals, ``elapsed`` [s] after those before."""
        slip = self._tractor.slip(signals)
        speed = self._tractor.speed(signals, slip)
        motion = hitch_motion(self._combination, replace(signals, speed=speed), speed * slip)
        if motion.v_x < _SLOWEST:
            return memory._replace(travel=None)
        travel = np.arctan((motion.v_y + self._x * motion.yaw_rate) / motion.v_x)
        angles = np.zeros(len(travel))
        angles[self._steered] = signals.angles
        friction = memory.friction
        lever = self._share * np.cos(angles)
        now, more = (
            float(lever @ self._forces(angles - travel, friction.friction * math.exp(step))) for step in (0.0, _STEP)
        )
        surplus = now - friction.disturbance - signals.lateral_acceleration / (self._lean * GRAVITY)
        friction = updated(
            friction, surplus, (more - now) / _STEP, motion.v_x * elapsed, self._stiffness * _MOTION_ERROR
        )
        return GripMemory(friction, travel[self._steered])

    def limited(self, memory: GripMemory, angles: FloatArray) -> FloatArray:
        """The angles (n_steered,) [rad], as far as the side force of their axles grows."""
        if memory.travel is None:
            return angles
        friction = memory.friction.friction * math.exp(math.sqrt(memory.friction.variance[0]))
        slip = friction * self._slip
        limited: FloatArray = np.clip(angles, memory.travel - slip, memory.travel + slip)
        return limited

    def _forces(self, slip: FloatArray, friction: float) -> FloatArray:
        """Side forces (n_axles,) over loads, + left, of axles that point left of their travel by ``slip`` [rad]."""
        tangents = np.tan(slip).tolist()
        return np.array(
            [
                float(tyre.steady_force(Planar(0.0, tangent), 0.5 * load, friction).y) / (0.5 * load)
                for tyre, load, tangent in zip(self._tyres, self._loads.tolist(), tangents, strict=True)
            ]
        )

    def _slip_of_enough(self) -> float:
        """Slip at which nearly the largest side force is reached, over the friction [rad]."""
        forces = np.array([self._forces(np.full(len(self._x), slip), 1.0) @ self._share for slip in _SLIPS])
        return float(_SLIPS[np.argmax(forces >= _ENOUGH * forces.max())])
