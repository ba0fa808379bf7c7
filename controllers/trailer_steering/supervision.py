"""Supervision of a steering law: failed actuators, grip of the axles, and the lock in reverse.

The law says which angles it wants. The monitor (``actuator_monitor``) compares demands with measured angles, and finds
actuators at fault. While there are any, other demands are sent:

- where an axle stands beside its demand, the measured offset is subtracted;
- where an axle does not answer, or slowly, the others take over the steer moment that it lacks or has too much, as far
  as its tyres do not slide; none is steered beyond the slip at which its own side force is largest (``axle_grip``);
- an axle that does not answer gets the demand of the others, so that it joins them when it answers again.

A law may ask to be told what the actuators do (`controllers.trailer.ActuationAware`). Where all axles stand still,
nothing can be taken over: the path is then that of a trailer with fixed axles.

About the hitch the side forces of the tyres balance the inertia of the trailer, which the accelerometer above its axles
measures. The tyres' laws give the forces of the measured slip for a given friction; a Kalman filter finds the friction
that explains them (``controllers.trailer_steering.mpc.observer``). It is only known where tyres slide enough for it to
matter, and until then the benefit of the doubt is given: one standard deviation more.

The largest side force is reached at a slip in proportion to the friction. Beyond it an axle only brakes.

The laws steer the follow point onto the path of the hitch; in reverse the follow point leads. Real steered trailer
axles are centred and locked in reverse by the signal of the reversing lights.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.trailer import (
    Actuation,
    Combination,
    SteerCommand,
    TrailerGeometry,
    TrailerSteering,
    told_actuation,
)
from controllers.trailer_steering.actuator_monitor import ActuatorFinding, ActuatorMemory, ActuatorMonitor
from controllers.trailer_steering.kinematics import AxleGroup, reachable
from controllers.trailer_steering.mpc.observer import FrictionMemory, updated
from controllers.trailer_steering.reckoned_motion import TractorMotion, hitch_motion
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.roll import roll_gradients
from vehicle.foundation.own_parts import close_part
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


# Slip by the linear law beyond which side force of a faulty axle is not counted on: tyres on ice, 0.14/4.6 [rad]. What
# is taken over too little, the law's feedback adds.
_SLIDING: Final = 0.03


class SupervisionMemory(NamedTuple):
    """State between two steps."""

    law: Any  # memory of the law
    tick: int | None  # of the last step; None before the first
    sent: tuple[float, ...]  # last demands [rad]
    differs: bool  # True if they were not what the law wanted
    monitor: ActuatorMemory
    grip: GripMemory  # of the axles, while there is a fault
    at_grip: NDArray[np.bool_]  # (n_steered,) True for axles that could not be steered as far as wanted


class Supervised:
    """A law whose demands are sent to actuators that may not do what they are told."""

    def __init__(self, law: TrailerSteering[Any], trailer: TrailerGeometry, combination: Combination) -> None:
        """Supervise the actuators of a trailer with steered axles, under a ``law``."""
        self.law, self._trailer = law, trailer
        self._monitor, self._axles = ActuatorMonitor(trailer), AxleGroup.of(trailer)
        self._grip = AxleGrip(combination)
        self._all = np.ones(len(trailer.steered_distances), dtype=bool)

    def init(self) -> SupervisionMemory:
        """Memory of a new run: all actuators sound, wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return SupervisionMemory(self.law.init(), None, straight, False, self._monitor.init(), GripMemory(), ~self._all)

    def step(
        self, memory: SupervisionMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[SupervisionMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        monitor = self._monitor.measured(memory.monitor, signals.tick, self._trailer.actuator_angles(signals.angles))
        inner = memory.law
        if memory.tick is not None:
            inner = told_actuation(self.law, inner, self._actuation(memory, monitor, signals.angles))
        inner, command = self.law.step(inner, tick, off_tracking, signals)
        wanted, differs, grip, at_grip = command.angles, False, GripMemory(), ~self._all
        if memory.differs or monitor.at_fault:
            grip = self._grip.measured(memory.grip, signals, elapsed)
            target, at_grip = self._allocated(monitor, grip, wanted, signals.angles)
            demand = reachable(self._trailer, np.array(memory.sent), target, elapsed)
            differs = not np.array_equal(demand, wanted)
            command = SteerCommand(angles=demand)
        monitor = self._monitor.sent(monitor, self._trailer.actuator_angles(command.angles))
        sent = tuple(command.angles.tolist())
        return SupervisionMemory(inner, tick, sent, differs, monitor, grip, at_grip), command

    def close(self) -> None:
        """Close the law."""
        close_part(self.law)

    def _actuation(self, memory: SupervisionMemory, monitor: ActuatorMemory, angles: FloatArray) -> Actuation:
        sent = np.array(memory.sent)
        if not monitor.at_fault:
            return Actuation(goal=sent, able=self._all)
        able = self._of_axles(self._monitor.max_rates(monitor) > 0.0)
        goal = np.where(able | ~able.any(), sent + self._trailer.axle_angles(monitor.offsets), angles)
        return Actuation(goal=goal, able=able, at_grip=memory.at_grip)

    def _allocated(
        self, monitor: ActuatorMemory, grip: GripMemory, wanted: FloatArray, angles: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Demands (n_steered,) [rad] for the angles wanted, by what is known of actuators and grip.

        The mask has the axles that are steered less far than would be wanted, as their side force does not grow.
        """
        trailer, rates = self._trailer, self._monitor.max_rates(monitor)
        able, sound = (self._of_axles(mask) for mask in (rates > 0.0, rates == trailer.max_steer_rate))
        lacking = _SLIDING * np.tanh((np.tan(wanted) - np.tan(angles)) / _SLIDING)
        missing = float(self._axles.steered @ np.where(sound, 0.0, lacking))
        target = self._axles.with_moment(wanted, missing, sound)
        gripping = self._axles.linked(self._grip.limited(grip, target))
        at_grip = sound & (gripping != target) & ~sound.all()
        target = np.where(at_grip, gripping, target)
        if able.any() and not able.all():
            like_others = trailer.axle_angles(np.full(len(rates), trailer.actuator_angles(target)[rates > 0.0].mean()))
            target = np.where(able, target, like_others)
        return target - trailer.axle_angles(monitor.offsets), at_grip

    def _of_axles(self, actuators: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Mask (n_steered,) of the axles of these actuators."""
        mask = np.zeros(len(self._trailer.steered_distances), dtype=bool)
        for is_in, group in zip(actuators, self._trailer.groups, strict=True):
            mask[list(group)] = is_in
        return mask


def actuator_findings(memory: object) -> tuple[ActuatorFinding, ...]:
    """Changes of what is known of the actuators, by the memory of a supervised law."""
    return memory.monitor.findings if isinstance(memory, SupervisionMemory) else ()


_BACKWARD: Final = -0.25  # below the 0.1 m/s at which a stopped combination rocks on its tyres [m/s]
_FORWARD: Final = 0.25  # [m/s]


class ReverseLockMemory(NamedTuple):
    """State between two steps."""

    law: Any  # memory of the law
    tick: int | None  # of the last step; None before the first
    locked: bool
    demand: tuple[float, ...]  # last command [rad]


class ReverseLock:
    """A law that steers forwards only and starts with a new memory after reversing."""

    def __init__(self, law: TrailerSteering[Any], trailer: TrailerGeometry) -> None:
        """Lock a ``law`` for a trailer with steered axles."""
        self.law, self._trailer = law, trailer

    def init(self) -> ReverseLockMemory:
        """Memory of a new run, wheels straight."""
        return ReverseLockMemory(self.law.init(), None, False, (0.0,) * len(self._trailer.steered_distances))

    def actuated(self, memory: ReverseLockMemory, actuation: Actuation) -> ReverseLockMemory:
        """Memory with the law told what its actuators do."""
        return memory._replace(law=told_actuation(self.law, memory.law, actuation))

    def step(
        self, memory: ReverseLockMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[ReverseLockMemory, SteerCommand]:
        """New memory and command at ``tick``; in reverse the wheels return to straight at the actuators' rate."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        locked = signals.speed < (_FORWARD if memory.locked else _BACKWARD)
        if locked:
            straight = np.zeros(len(memory.demand))
            command = SteerCommand(angles=reachable(self._trailer, np.array(memory.demand), straight, elapsed))
            return ReverseLockMemory(memory.law, tick, True, tuple(command.angles.tolist())), command
        law, command = self.law.step(self.law.init() if memory.locked else memory.law, tick, off_tracking, signals)
        return ReverseLockMemory(law, tick, False, tuple(command.angles.tolist())), command

    def close(self) -> None:
        """Close the law."""
        close_part(self.law)
