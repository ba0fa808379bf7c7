"""A steering law with its safeguards, in the order in which a step passes them.

- Actuators: readings are compared with the demands that were sent (`actuators`). A law may ask for the state of the
  actuators (`controllers.trailer.ActuationAware`).
- Reverse lock: the laws steer the follow point onto the path of the hitch; in reverse the follow point leads. Real
  steered trailer axles are centred and locked in reverse by the signal of the reversing lights. Here they return to
  straight at the actuators' rate, and the law starts anew afterwards.
- Signals and estimate: checked and judged (`guard`), if the law uses estimates.
- Law: its output is checked; an exception or a wrong command ends the run in one line.
- Fallback: steers without an estimate, where there is none to rely on (`fallback`).
- Supervision: demands that make up for failed actuators (`actuators`).
"""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple, cast

import numpy as np

from controllers.checked import check_angles, checked_step
from controllers.trailer import (
    ActuationAware,
    Combination,
    SteerCommand,
    TrailerGeometry,
    TrailerSteering,
)
from controllers.trailer_steering.actuators import ActuatorFinding, ActuatorSupervision, SupervisionMemory
from controllers.trailer_steering.guard import Degradation, EstimateGuard, GuardMemory
from controllers.trailer_steering.kinematics import reachable
from estimators.estimates import OffTracking
from estimators.off_tracking.signal_monitor import Finding
from sensors.messages import CombinationSignals
from vehicle.clock import elapsed_since
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray

_BACKWARD: Final = -0.25  # below the 0.1 m/s at which a stopped combination rocks on its tyres [m/s]
_FORWARD: Final = 0.25  # [m/s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SafeguardedCommand(SteerCommand):
    """Demanded angles, and the findings of the safeguards so far."""

    by_fallback: bool = False  # True while the fallback steers in place of the law
    signal_findings: tuple[Finding, ...] = ()  # signals at fault, since the law has started
    actuator_findings: tuple[ActuatorFinding, ...] = ()  # faults of the steering actuators


class SafeguardMemory(NamedTuple):
    """State between two steps."""

    tick: int | None  # of the last step; None before the first
    law: Any  # memory of the law
    guard: GuardMemory | None  # None: the law uses no estimates
    is_locked: bool  # True in reverse
    wanted: tuple[float, ...]  # last angles before the supervision of the actuators [rad]
    actuators: SupervisionMemory | None  # None: the law's output is only checked


class Safeguarded:
    """A trailer steering law with its safeguards."""

    def __init__(
        self,
        law: TrailerSteering[Any],
        name: str,
        trailer: TrailerGeometry,
        combination: Combination,
        degradation: Degradation | None = None,
        *,
        checks_only: bool = False,
    ) -> None:
        """Safeguard a ``law``, which messages call ``name``, for a trailer of a combination.

        Args:
            law: steers the trailer.
            name: of the law in messages.
            trailer: to be steered. Without steered axles the law's output is only checked.
            combination: data sheet of the whole combination.
            degradation: criteria of the guard against bad estimates; None: the law uses no estimates.
            checks_only: no safeguards but the check of the law's output.
        """
        self.law, self._name, self._trailer = law, name, trailer
        self._supervision: ActuatorSupervision | None = None
        self._guard: EstimateGuard | None = None
        if trailer.steered_distances and not checks_only:
            self._supervision = ActuatorSupervision(trailer, combination)
            self._guard = None if degradation is None else EstimateGuard(trailer, combination, degradation)

    def init(self) -> SafeguardMemory:
        """Memory of a new run, wheels straight."""
        return SafeguardMemory(
            tick=None,
            law=self.law.init(),
            guard=None if self._guard is None else self._guard.init(),
            is_locked=False,
            wanted=self._trailer.straight,
            actuators=None if self._supervision is None else self._supervision.init(),
        )

    def step(
        self, memory: SafeguardMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[SafeguardMemory, SafeguardedCommand]:
        """New memory and command at ``tick``; ``off_tracking`` is the newest estimate, None before the first.

        Raises:
            LawError: if the law raises an exception, or returns anything but finite angles of the steered axles.
        """
        supervision, actuators = self._supervision, memory.actuators
        if supervision is None or actuators is None:
            law, wanted = self._by_law(memory.law, tick, off_tracking, signals)
            return memory._replace(law=law), SafeguardedCommand(angles=wanted)
        elapsed = elapsed_since(memory.tick, tick)
        actuators = supervision.measured(actuators, signals)
        if memory.tick is not None and hasattr(self.law, "actuated"):
            aware = cast("ActuationAware[Any]", self.law)
            memory = memory._replace(law=aware.actuated(memory.law, supervision.actuation(actuators, signals.angles)))
        memory = self._with_lock(memory, signals)
        if memory.is_locked:
            wanted = reachable(self._trailer, np.array(memory.wanted), np.zeros(len(memory.wanted)), elapsed)
        else:
            memory, wanted = self._steered(memory, tick, off_tracking, signals)
        actuators, demand = supervision.sent(actuators, wanted, signals, elapsed)
        memory = memory._replace(tick=tick, wanted=tuple(wanted.tolist()), actuators=actuators)
        return memory, _command(demand, memory.guard, actuators)

    def close(self) -> None:
        """Close the law."""
        close_part(self.law)

    def _with_lock(self, memory: SafeguardMemory, signals: CombinationSignals) -> SafeguardMemory:
        """Memory with the lock of this step; law and guard start anew after reversing."""
        locked = signals.speed < (_FORWARD if memory.is_locked else _BACKWARD)
        if memory.is_locked and not locked:
            fresh = self.init()
            memory = memory._replace(law=fresh.law, guard=fresh.guard)
        return memory._replace(is_locked=locked)

    def _steered(
        self, memory: SafeguardMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[SafeguardMemory, FloatArray]:
        """Memory and angles (n_steered,) [rad] of law or fallback."""
        guard, state = self._guard, memory.guard
        if guard is None or state is None:
            law, wanted = self._by_law(memory.law, tick, off_tracking, signals)
            return memory._replace(law=law), wanted
        state, signals = guard.signals_checked(state, off_tracking, signals)
        state, estimate = guard.estimate_checked(state, tick, off_tracking, signals)
        law, wanted = self._by_law(memory.law, tick, estimate, signals)
        state, wanted = guard.steered(state, tick, wanted, signals)
        return memory._replace(law=law, guard=state), wanted

    def _by_law(
        self, memory: Any, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[Any, FloatArray]:
        """Memory and checked angles (n_steered,) [rad] of the law."""
        name = self._name
        memory, command = checked_step(self.law, name, SteerCommand, tick, memory, tick, off_tracking, signals)
        check_angles(self.law, name, tick, command.angles, len(self._trailer.steered_distances))
        return memory, command.angles


def _command(demand: FloatArray, guard: GuardMemory | None, actuators: SupervisionMemory) -> SafeguardedCommand:
    return SafeguardedCommand(
        angles=demand,
        by_fallback=guard is not None and not guard.law_steers,
        signal_findings=() if guard is None else guard.monitor.findings,
        actuator_findings=actuators.monitor.findings,
    )
