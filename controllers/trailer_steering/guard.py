"""Guard against unreliable estimates around a steering law, with the plausibility checks of estimates.

An estimate that is lost, too uncertain, too old, or in conflict with the wheels is ignored: for some time and distance
the law continues with the last good one. After that the fallback steers, without any estimate; also if no good one has
come when the path is long enough. After an implausible jump, estimates are ignored until later ones agree with each
other for some time. Then the law takes over again. Signals of the combination that are at fault are corrected first
(``estimators.off_tracking.signal_monitor``): for these checks, the law and the fallback.

At every handover between law and fallback the axles keep their angles: the difference between the two demands is added
to the new one and reduced at a rate that starts low and grows. The angles have no step, and the demands of the new law
are followed in full; a law that is held back would oscillate.

Wheel speeds and gyros of the combination show how fast the trailer really moves. A frozen camera is detected by them:
in its estimate the trailer stands still. Distance that the estimate lacks against the wheels is also missing in the
hitch path, until the follow point has passed that place.
"""

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from controllers.trailer import Combination, TrailerGeometry
from controllers.trailer_steering.fallback import Fallback, FallbackMemory, FallbackName
from controllers.trailer_steering.kinematics import HitchMotion, hitch_motion, reachable
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.parity import MotionReference
from estimators.off_tracking.signal_monitor import MonitorMemory, SignalMonitor
from sensors.messages import CombinationSignals
from vehicle.clock import TICK, elapsed_since
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
_GROWTH_TIME = 1.0  # in which the rate of a handover grows by its initial value [s]
_HOLD_DISTANCE = 0.25  # of the follow distance; beyond it the path of the hitch is a guess [-]
_GAP = 0.3  # accepted at any speed: two missing frames [s]


class Degradation(PartParameters):
    """Criteria for ignoring estimates, and the response: limits of usable estimates, and the fallback law."""

    hold: float = quantity(
        1.0,
        "s",
        0.0,
        1.5,
        "Time for which the last good estimate is used; limited to a quarter of the follow distance.",
    )
    fade_rate: float = quantity(  # assumed: 3 deg/s end a turn within seconds
        0.05, "rad/s", 0.001, 1.0, "Initial rate of the change-over between laws."
    )
    max_age: float = quantity(  # 2 m of travel at 10 km/h
        0.6, "s", 0.1, 2.0, "Largest accepted age of an estimate on arrival."
    )
    max_std: float = quantity(  # command steer errs by 0.7 m RMS on a roundabout
        0.8, "m", 0.01, 5.0, "Largest accepted standard deviation of a degraded estimate."
    )
    max_jump: float = quantity(0.25, "m", 0.01, 10.0, "Largest accepted difference of an estimate from the prediction.")
    recovery: float = quantity(0.5, "s", 0.0, 10.0, "Duration of good estimates after which they are used again.")
    fallback: FallbackName = option(
        "Law without usable estimates; all but straight fade out between 30 and 50 km/h.", "dead_reckoning"
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
    vague = estimate.health is Health.DEGRADED and estimate.std > criteria.max_std
    lost = estimate.health is Health.LOST or not math.isfinite(estimate.value)
    return not (vague or lost) and estimate.age(tick) <= criteria.max_age


def motion_agrees(estimate: OffTracking, travel: Travel, motion: HitchMotion, follow_distance: float) -> bool:
    """True if the motion of the trailer in the estimate agrees with its wheels and gyro."""
    slower = abs(motion.v_x - estimate.v_x) > _SPEED + _SPEED_SHARE * abs(motion.v_x)
    turns = abs(motion.yaw_rate - estimate.yaw_rate) > _YAW_RATE
    return not (slower or turns or abs(travel.missing) > _MISSING * follow_distance)


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
    tick: int | None  # of the last step; None before the first
    demand: tuple[float, ...]  # last command [rad]
    travel: Travel
    sound: OffTracking | None  # newest estimate that agrees with the one before
    sound_since: int | None  # since when all estimates have agreed [ticks]; None: the newest does not
    good: OffTracking | None  # newest estimate for the law
    good_at: int  # its arrival, or the time when the first one was due [ticks]
    rolled: float  # distance without a first good estimate [m]
    trusted: bool  # True if sound estimates are used
    law_steers: bool  # False: the fallback steers
    changed_at: int  # last handover [ticks]
    difference: tuple[float, ...]  # remaining difference between the two demands at that handover [rad]


class EstimateGuard:
    """Guard of one trailer's law: checks signals and estimates, and chooses between law and fallback."""

    def __init__(self, trailer: TrailerGeometry, combination: Combination, degradation: Degradation) -> None:
        """For a trailer with steered axles."""
        self._trailer, self._combination, self._degradation = trailer, combination, degradation
        self._monitor = SignalMonitor(combination.vehicle, combination.unit, trailer.axle_distances)
        self._fallback = Fallback(trailer, combination=combination, name=degradation.fallback)

    def init(self) -> GuardMemory:
        """Memory without any estimate, wheels straight."""
        straight = self._trailer.straight
        return GuardMemory(
            monitor=self._monitor.init(),
            fallback=self._fallback.init(),
            tick=None,
            demand=straight,
            travel=Travel(),
            sound=None,
            sound_since=None,
            good=None,
            good_at=0,
            rolled=0.0,
            trusted=True,
            law_steers=True,
            changed_at=-1,
            difference=straight,
        )

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
        memory = memory._replace(monitor=monitor)
        if monitor.distrusted != before.distrusted:  # distance counted by signals that are no longer trusted
            memory = memory._replace(travel=Travel(newest))
        return memory, self._monitor.corrected(monitor, signals)

    def estimate_checked(
        self, memory: GuardMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[GuardMemory, OffTracking | None]:
        """Memory after the choice between law and fallback, and the estimate for the law.

        The law gets the newest good estimate, or the newest one marked as lost. While the fallback steers, the law gets
        sound estimates before it takes over, so that what it measures is not old.
        """
        motion = hitch_motion(self._combination, signals)
        if off_tracking is not None and _is_new(memory, off_tracking):
            memory = self._with_estimate(memory, tick, off_tracking, motion)
        memory = self._with_handover(memory, tick, motion)
        if memory.law_steers and memory.good is not None:
            return memory, memory.good
        if not memory.law_steers and memory.sound_since is not None:
            return memory, memory.sound
        return memory, None if off_tracking is None else replace(off_tracking, health=Health.LOST)

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
        elif difference.any():
            growth = 1.0 + (tick - memory.changed_at) * TICK / _GROWTH_TIME
            reduction = self._degradation.fade_rate * growth * elapsed
            difference -= np.clip(difference, -reduction, reduction)
        demand = reachable(self._trailer, last, wanted + difference, elapsed)
        memory = memory._replace(fallback=fallback, tick=tick)
        return memory._replace(demand=tuple(demand.tolist()), difference=tuple(difference.tolist())), demand

    def _with_estimate(self, memory: GuardMemory, tick: int, estimate: OffTracking, motion: HitchMotion) -> GuardMemory:
        """Memory with a new estimate, which is good if it and those before it are plausible."""
        d, length = self._degradation, self._trailer.follow_distance
        travel = travel_with(memory.travel, estimate, motion, length)
        memory = memory._replace(travel=travel)
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
        return memory._replace(good=estimate, good_at=tick) if memory.trusted else memory

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
            is_recent = (tick - memory.good_at) * TICK <= hold + _GAP
        else:
            held = (tick - memory.good_at) * TICK
            is_recent = held <= hold and (held <= _GAP or held * abs(motion.v_x) <= _HOLD_DISTANCE * length)
        if is_recent:
            return memory
        return memory._replace(law_steers=False, trusted=False, sound_since=None, changed_at=tick)


def _is_new(memory: GuardMemory, estimate: OffTracking) -> bool:
    return memory.travel.newest is None or estimate.tick > memory.travel.newest.tick
