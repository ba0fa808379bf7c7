"""A steering law with its safeguards, in the order in which a step passes them, and its guard against bad estimates.

- Actuators: readings are compared with the demands that were sent (`actuators`). A law may ask for the state of the
  actuators (`controllers.trailer.ActuationAware`).
- Reverse lock: the laws steer the follow point onto the path of the hitch; in reverse the follow point leads. Real
  steered trailer axles are centred and locked in reverse by the signal of the reversing lights. Here they return to
  straight at the actuators' rate, and the law starts anew afterwards.
- Signals and estimate: checked and judged (`guard`), if the law uses estimates.
- Law: its output is checked; an exception or a wrong command ends the run in one line.
- Fallback: steers without an estimate, where there is none to rely on (`fallback`).
- Supervision: demands that make up for failed actuators (`actuators`).

An estimate that is lost, too uncertain, too old, or in conflict with the wheels is ignored: for some time and distance
the law continues with the last good one, unless a signal is found at fault meanwhile. After that the fallback steers,
without any estimate; also if no good one has come when the path is long enough. After an implausible jump, estimates
are ignored until later ones agree with each other for some time. Then the law takes over again. Signals of the
combination that are at fault are corrected first (``estimators.off_tracking.signal_monitor``): for these checks, the
law and the fallback.

At every handover between law and fallback the axles keep their angles: the difference between the two demands is added
to the new one and reduced at a rate that starts low and grows. The angles have no step, and the demands of the new law
are followed in full; a law that is held back would oscillate.

Wheel speeds and gyros of the combination show how fast the trailer really moves. A frozen camera is detected by them:
in its estimate the trailer stands still. Distance that the estimate lacks against the wheels is also missing in the
hitch path, until the follow point has passed that place.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, cast

import numpy as np

from controllers.checked import check_angles, checked_step
from controllers.trailer import ActuationAware, Combination, SteerCommand, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.actuators import ActuatorFinding, ActuatorSupervision, SupervisionMemory
from controllers.trailer_steering.kinematics import TractorMotion, hitch_motion, reachable
from controllers.trailer_steering.signal_laws import Fallback, FallbackMemory, FallbackName
from estimators.estimates import Health, OffTracking
from estimators.hitch_motion import HitchMotion
from estimators.off_tracking.parity import MotionReference
from estimators.off_tracking.signal_fusion import DIRECTION
from estimators.off_tracking.signal_monitor import Finding, MonitorMemory, SignalMonitor
from sensors.messages import CombinationSignals
from vehicle.clock import TICK, elapsed_since
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray
from vehicle.option import PartParameters, option, quantity

# assumed: several times the errors of wheel speeds, gyros and odometry, and the change of motion of a braking or
# turning trailer within the 0.3 s by which an estimate is late.
_SPEED: Final = 0.3  # [m/s]
_SPEED_SHARE: Final = 0.15  # [-]
_YAW_RATE: Final = 0.1  # [rad/s]
_MISSING: Final = 0.1  # of the follow distance: a path error of about 0.1 rad times that in a tight turn [-]
_INTERVAL: Final = 100  # between estimates, if it is not known [ticks]
_LONGEST_INTERVAL: Final = 300  # over which the motion in an estimate is a mean [ticks]
_SIGMAS: Final = 3.0  # of an estimate's own standard deviation: no jump
_USUAL: Final = 0.15  # off-tracking without an estimate, by the fallback, 1 sigma [m]
_GROWTH_TIME = 1.0  # in which the rate of a handover grows by its initial value [s]
_HOLD_DISTANCE = 0.25  # of the follow distance; beyond it the path of the hitch is a guess [-]
_GAP = 0.3  # accepted at any speed: two missing frames [s]


class Degradation(PartParameters):
    """Criteria for ignoring estimates, and the response: limits of usable estimates, and the fallback law."""

    hold: float = quantity(
        1.0, "s", 0.0, 1.5, "Time for which the last good estimate is used; at most a quarter of the follow distance."
    )
    fade_rate: float = quantity(  # assumed: 3 deg/s end a turn within seconds
        0.05, "rad/s", 0.001, 1.0, "Initial rate of the change-over between laws."
    )
    max_age: float = quantity(  # 2 m of travel at 10 km/h
        0.6, "s", 0.1, 2.0, "Largest accepted age of an estimate on arrival."
    )
    max_std: float = quantity(  # the fallback errs by as much
        0.15, "m", 0.01, 5.0, "Largest accepted standard deviation of an estimate."
    )
    max_jump: float = quantity(0.25, "m", 0.01, 10.0, "Largest accepted difference of an estimate from the prediction.")
    recovery: float = quantity(0.5, "s", 0.0, 10.0, "Duration of good estimates after which they are used again.")
    fallback: FallbackName = option(
        "Law without usable estimates; all but straight fade out between 25 and 40 km/h.", "dead_reckoning"
    )


class Travel(NamedTuple):
    """Distance travelled according to estimates and wheels."""

    newest: OffTracking | None = None  # estimate that arrived last
    missing: float = 0.0  # distance of the estimates less than that of the wheels [m]


def travel_with(travel: Travel, estimate: OffTracking, motion: HitchMotion, follow_distance: float) -> Travel:
    """Travel with a new estimate; missing distance decays over a follow distance."""
    if travel.newest is None:
        return Travel(estimate)
    interval = (estimate.tick - travel.newest.tick) * TICK
    rolled = abs(motion.v_x) * interval
    kept = travel.missing * math.exp(-rolled / follow_distance)
    # A lost motion is bridged at the velocity before it.
    return Travel(estimate, kept + (motion.v_x - estimate.v_x) * interval)


def motion_reference(estimate: OffTracking, before: OffTracking | None) -> MotionReference | None:
    """The motion in an estimate, to compare signals with; None if it is lost, or taken from the signals themselves.

    Its velocities are means since the estimate ``before``. While the path is still short the estimate is lost, but its
    motion is not: the path grows.
    """
    values = (estimate.v_x, estimate.v_y, estimate.yaw_rate)
    grows = before is not None and len(estimate.path) > len(before.path)
    if (estimate.health is Health.LOST and not grows) or estimate.bridged > 0.0 or not all(map(math.isfinite, values)):
        return None
    previous = estimate.tick - _INTERVAL if before is None else max(before.tick, estimate.tick - _LONGEST_INTERVAL)
    return MotionReference(estimate.tick, previous, *values)


def usable(estimate: OffTracking, tick: int, criteria: Degradation) -> bool:
    """True if the estimate is healthy enough and not too old."""
    lost = estimate.health is Health.LOST or not math.isfinite(estimate.value)
    return not lost and estimate.std <= criteria.max_std and estimate.age(tick) <= criteria.max_age


def _is_slower(estimate: OffTracking, motion: HitchMotion) -> bool:
    return abs(motion.v_x - estimate.v_x) > _SPEED + _SPEED_SHARE * abs(motion.v_x)


def motion_agrees(estimate: OffTracking, travel: Travel, motion: HitchMotion, follow_distance: float) -> bool:
    """True if the motion of the trailer in the estimate agrees with its wheels and gyro."""
    turns = abs(motion.yaw_rate - estimate.yaw_rate) > _YAW_RATE
    return not (_is_slower(estimate, motion) or turns or abs(travel.missing) > _MISSING * follow_distance)


def jumps(before: OffTracking, estimate: OffTracking, follow_distance: float, largest: float) -> bool:
    """True if the estimate deviates by more than ``largest`` [m] from the previous one, carried on by the motion.

    The path stands still while the follow point moves: in the trailer's frame a point of the path at (-L_f, e) has the
    lateral speed -v_y + r L_f, and the path, inclined by its tangent, passes at v_x - r e.
    """
    interval = (estimate.tick - before.tick) * TICK
    tangent = math.tan(0.5 * (before.path_tangent + estimate.path_tangent))
    rate = estimate.yaw_rate * follow_distance - estimate.v_y
    rate += tangent * (estimate.v_x - estimate.yaw_rate * estimate.value)
    deviation = estimate.value - before.value - rate * interval
    return abs(deviation) > largest + _SIGMAS * estimate.std


class GuardMemory(NamedTuple):
    """State of the guard between two steps."""

    monitor: MonitorMemory  # of the signals
    fallback: FallbackMemory
    demand: tuple[float, ...]  # last command [rad]
    difference: tuple[float, ...]  # remaining difference between the two demands at the last handover [rad]
    tick: int | None = None  # of the last step; None before the first
    travel: Travel = Travel()
    bridged: bool = False  # True: the path was dead-reckoned in part since the last good estimate
    sound: OffTracking | None = None  # newest estimate that agrees with the one before
    sound_since: int | None = None  # since when all estimates have agreed [ticks]; None: the newest does not
    good: OffTracking | None = None  # newest estimate for the law
    expected: OffTracking | None = None  # what is to be expected with it
    good_at: int = 0  # its arrival, or the time when the first one was due [ticks]
    rolled: float = 0.0  # distance without a first good estimate [m]
    trusted: bool = True  # True if sound estimates are used
    law_steers: bool = True  # False: the fallback steers
    changed_at: int = -1  # last handover [ticks]


class EstimateGuard:
    """Guard of one trailer's law: checks signals and estimates, and chooses between law and fallback."""

    def __init__(
        self,
        trailer: TrailerGeometry,
        combination: Combination,
        degradation: Degradation,
        *,
        beyond_reach: bool = False,
    ) -> None:
        """For a trailer with steered axles, and a law that is or is not held within the actuators' reach."""
        self._beyond_reach = beyond_reach
        self._trailer, self._combination, self._degradation = trailer, combination, degradation
        self._monitor = SignalMonitor(combination.vehicle, combination.unit)
        self._tractor = TractorMotion(combination)
        self._fallback = Fallback(trailer, combination=combination, name=degradation.fallback)

    def init(self) -> GuardMemory:
        """Memory without any estimate, wheels straight."""
        straight = self._trailer.straight
        return GuardMemory(self._monitor.init(), self._fallback.init(), demand=straight, difference=straight)

    def signals_checked(
        self, memory: GuardMemory, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[GuardMemory, CombinationSignals]:
        """Memory and corrected signals, compared with each other and with the motion in a new estimate."""
        before, newest = memory.monitor, memory.travel.newest
        monitor = self._monitor.received(before, signals)
        if off_tracking is not None and _is_new(memory, off_tracking):
            reference = motion_reference(off_tracking, newest)
            if reference is not None:
                monitor = self._monitor.compared(monitor, reference)
        # not the distance counted by signals that are no longer trusted
        travel = memory.travel if monitor.distrusted == before.distrusted else Travel(newest)
        return memory._replace(monitor=monitor, travel=travel), self._monitor.corrected(monitor, signals)

    def estimate_checked(
        self, memory: GuardMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[GuardMemory, OffTracking | None]:
        """Memory after the choice between law and fallback, and the estimate for the law.

        The law gets the newest good estimate, or the newest one marked as lost. While the fallback steers, the law gets
        sound estimates before it takes over, so that what it measures is not old.
        """
        motion = hitch_motion(self._combination, signals)
        if off_tracking is not None and _is_new(memory, off_tracking):
            # front wheels that slide to the side turn slower than the vehicle travels
            travelled = self._tractor.of_hitch(signals) if _is_slower(off_tracking, motion) else motion
            memory = self._with_estimate(memory, tick, off_tracking, travelled)
        memory = self._with_handover(memory, tick, motion)
        if memory.law_steers and memory.good is not None:
            return memory, memory.expected
        if not memory.law_steers and memory.sound_since is not None and memory.sound is not None:
            return memory, self._expected(memory.sound)
        if off_tracking is None or memory.bridged:  # it shows nothing that the signals do not
            return memory, None
        return memory, replace(off_tracking, health=Health.LOST)

    def _expected(self, estimate: OffTracking) -> OffTracking:
        """The off-tracking that is to be expected with a vague estimate: the least squares of it and of none at all."""
        believed = _USUAL**2 / (_USUAL**2 + estimate.std**2)
        return estimate.sheared((believed - 1.0) * estimate.value, self._trailer.follow_distance)

    def steered(
        self, memory: GuardMemory, tick: int, wanted: FloatArray, signals: CombinationSignals
    ) -> tuple[GuardMemory, FloatArray]:
        """Memory and angles (n_steered,) [rad]: those ``wanted`` by the law, or those of the fallback.

        The remaining difference of the last handover is added.
        """
        elapsed = elapsed_since(memory.tick, tick)
        last, difference = np.array(memory.demand), np.array(memory.difference)
        fallback = self._fallback.observed(memory.fallback, tick, memory.good if memory.trusted else None, signals)
        if not memory.law_steers:
            fallback, wanted = self._fallback.steered(fallback, tick, signals, last)
        if tick == memory.changed_at:
            difference = last - wanted
        elif any(memory.difference):
            growth = 1.0 + (tick - memory.changed_at) * TICK / _GROWTH_TIME
            reduction = self._degradation.fade_rate * growth * elapsed
            difference -= np.clip(difference, -reduction, reduction)
        span = math.inf if self._beyond_reach and memory.law_steers else elapsed
        demand = reachable(self._trailer, last, wanted + difference, span)
        sent = tuple(demand.tolist())
        memory = memory._replace(fallback=fallback, tick=tick, demand=sent, difference=tuple(difference.tolist()))
        return memory, demand

    def _with_estimate(self, memory: GuardMemory, tick: int, estimate: OffTracking, motion: HitchMotion) -> GuardMemory:
        """Memory with a new estimate, which is good if it and those before it are plausible."""
        d, length = self._degradation, self._trailer.follow_distance
        travel = travel_with(memory.travel, estimate, motion, length)
        memory = memory._replace(travel=travel, bridged=memory.bridged or estimate.bridged > 0.0)
        if not (usable(estimate, tick, d) and motion_agrees(estimate, travel, motion, length)):
            return memory._replace(sound_since=None)
        before = memory.sound
        comparable = before is not None and (estimate.tick - before.tick) * TICK <= d.hold
        if before is not None and comparable and jumps(before, estimate, length, d.max_jump):
            return memory._replace(sound=estimate, sound_since=None, trusted=False)
        since = tick if memory.sound_since is None else memory.sound_since
        memory = memory._replace(sound=estimate, sound_since=since)
        if not memory.trusted and (tick - since) * TICK >= d.recovery:
            memory = memory._replace(trusted=True, law_steers=True, changed_at=tick)
        if not memory.trusted:
            return memory
        return memory._replace(good=estimate, expected=self._expected(estimate), good_at=tick, bridged=False)

    def _with_handover(self, memory: GuardMemory, tick: int, motion: HitchMotion) -> GuardMemory:
        """Memory after a handover to the fallback, if the last good estimate is out of date.

        The first estimate is due when the path reaches back to the follow point.
        """
        if not memory.law_steers:
            return memory
        hold, length = self._degradation.hold, self._trailer.follow_distance
        if memory.good is None:
            rolled = memory.rolled + abs(motion.v_x) * elapsed_since(memory.tick, tick)
            memory = memory._replace(rolled=rolled, good_at=memory.good_at if rolled > length else tick)
            newest = memory.travel.newest
            is_turned = newest is not None and DIRECTION in newest.doubts  # the path that grows is turned
            is_recent = (tick - memory.good_at) * TICK <= hold + _GAP and not is_turned
        else:
            held = (tick - memory.good_at) * TICK
            # with a signal that was wrong since then, the law has foreseen another motion
            misled = any(one.tick > memory.good_at for one in memory.monitor.findings)
            is_near = not misled and held * abs(motion.v_x) <= _HOLD_DISTANCE * length
            is_recent = held <= hold and (held <= _GAP or is_near)
        if is_recent:
            return memory
        return memory._replace(law_steers=False, trusted=False, sound_since=None, changed_at=tick)


def _is_new(memory: GuardMemory, estimate: OffTracking) -> bool:
    return memory.travel.newest is None or estimate.tick > memory.travel.newest.tick


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

    law: Any  # memory of the law
    guard: GuardMemory | None  # None: the law uses no estimates
    wanted: tuple[float, ...]  # last angles before the supervision of the actuators [rad]
    actuators: SupervisionMemory | None  # None: the law's output is only checked
    tick: int | None = None  # of the last step; None before the first
    is_locked: bool = False  # True in reverse


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
            beyond = getattr(law, "beyond_reach", False)
            if degradation is not None:
                self._guard = EstimateGuard(trailer, combination, degradation, beyond_reach=beyond)

    def init(self) -> SafeguardMemory:
        """Memory of a new run, wheels straight."""
        return SafeguardMemory(
            law=self.law.init(),
            guard=None if self._guard is None else self._guard.init(),
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
        return memory if locked == memory.is_locked else memory._replace(is_locked=locked)

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
