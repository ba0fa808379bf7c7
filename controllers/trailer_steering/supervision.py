"""Supervision of the steering actuators, around any steering law with its guard.

The law says which angles it wants. The monitor (``actuator_monitor``) compares demands with measured angles, and finds
actuators at fault. While there are any, other demands are sent:

- where an axle stands beside its demand, the measured offset is subtracted;
- where an axle does not answer, or slowly, the others take over the steer moment that it lacks or has too much, as far
  as its tyres do not slide; none is steered beyond the slip at which its own side force is largest (``axle_grip``);
- an axle that does not answer gets the demand of the others, so that it joins them when it answers again.

A law may ask to be told what the actuators do (`controllers.trailer.ActuationAware`). Where all axles stand still,
nothing can be taken over: the path is then that of a trailer with fixed axles.
"""

from __future__ import annotations

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
from controllers.trailer_steering.axle_grip import AxleGrip, GripMemory
from controllers.trailer_steering.kinematics import AxleGroup
from controllers.trailer_steering.limits import reachable
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.closing import close_part
from vehicle.frames import FloatArray

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
