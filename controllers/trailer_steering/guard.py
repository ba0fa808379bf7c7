"""One answer to estimates that can not be relied on, around any steering law that uses them.

An estimate that is lost, degraded beyond use, too old, or at odds with the wheels is passed over: for a while, and a
way, the law goes on with the last good one. After that the trailer is steered without any: the axles go over to the
fallback; so it is where the first good one does not come when the path is long enough. An implausible jump is passed
over in the same way, until what comes after it agrees with itself for some time. Either way the law then takes over
again. At every change of hands the axles stay where they are: the difference between the two hands is added to what the
new one asks for, and given up at a slow rate that quickens. So there is no jerk, and the new hand's own moves are made
in full: a law whose moves were held back would swing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from controllers.trailer import Combination, SteerCommand, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.command_steer import CommandSteerMemory
from controllers.trailer_steering.fallback import Fallback, FallbackName
from controllers.trailer_steering.hitch_motion import HitchMotion, hitch_motion
from controllers.trailer_steering.limits import reachable
from controllers.trailer_steering.plausibility import Limits, Way, jumps, moved_on, moves_as_told, usable
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option

_QUICKENING = 1.0  # in which the rate of a change of hands grows by as much as it began with [s]
_HELD_WAY = 0.25  # of the follow distance: further on, where the hitch goes is a guess [-]
_GAP = 0.3  # two frames may be missing at any speed [s]
LIMITS: Final = {
    "hold": (0.0, 1.5, "s"),
    "fade_rate": (0.001, 1.0, "rad/s"),
    "max_age": (0.1, 2.0, "s"),
    "max_std": (0.01, 5.0, "m"),
    "max_jump": (0.01, 10.0, "m"),
    "recovery": (0.0, 10.0, "s"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Degradation:
    """When an estimate is not relied on, and what happens then.

    Raises:
        ValueError: if a value is outside its limits.
    """

    hold: float = 1.0  # how long the last good estimate is steered by, for a quarter of the follow distance at most [s]
    fade_rate: float = 0.05  # at which a change of hands begins; assumed: 3 deg/s let go of a turn in seconds [rad/s]
    max_age: float = 0.6  # of an estimate when it arrives: 2 m of way at 10 km/h [s]
    max_std: float = 0.15  # of a degraded one: the most that a path follower may be off [m]
    max_jump: float = 0.25  # beside what is expected [m]
    recovery: float = 0.5  # how long estimates must be good before they are relied on again [s]
    fallback: FallbackName = "command_steer"

    def __post_init__(self) -> None:
        for name, (low, high, unit) in LIMITS.items():
            Option(name, 0.0, "", unit, low, high).check(getattr(self, name), name)

    @property
    def limits(self) -> Limits:
        """What an estimate must keep to."""
        return Limits(self.max_age, self.max_std, self.max_jump)


class GuardMemory(NamedTuple):
    """What is carried from one step to the next."""

    law: Any  # memory of the law
    fallback: CommandSteerMemory
    tick: int | None  # of the last step; None before the first
    demand: tuple[float, ...]  # last command [rad]
    way: Way
    sound: OffTracking | None  # newest that agrees with the one before
    sound_since: int | None  # since when all of them have been [ticks]; None: the newest is not
    good: OffTracking | None  # newest that the law may steer by
    good_at: int  # when it arrived, or the first one was due [ticks]
    rolled: float  # without a first one [m]
    trusted: bool  # whether sound ones are good
    steers: bool  # the law, rather than the fallback
    changed_at: int  # when the axles last changed hands [ticks]
    apart: tuple[float, ...]  # what is left of the difference between the two hands then [rad]


class Guarded:
    """A steering law that is given good estimates only, and is relieved when there are none."""

    def __init__(
        self, law: TrailerSteering[Any], trailer: TrailerGeometry, combination: Combination, degradation: Degradation
    ) -> None:
        """The law for a trailer, with steered axles, of a combination."""
        self.law = law
        self._trailer, self._combination, self._degradation = trailer, combination, degradation
        self._fallback = Fallback(trailer, combination=combination, name=degradation.fallback)

    def init(self) -> GuardMemory:
        """Nothing seen yet, wheels straight."""
        return GuardMemory(
            law=self.law.init(),
            fallback=self._fallback.init(),
            tick=None,
            demand=(0.0,) * len(self._trailer.steered_distances),
            way=Way(),
            sound=None,
            sound_since=None,
            good=None,
            good_at=0,
            rolled=0.0,
            trusted=True,
            steers=True,
            changed_at=-1,
            apart=(0.0,) * len(self._trailer.steered_distances),
        )

    def step(
        self, memory: GuardMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[GuardMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        motion = hitch_motion(self._combination, signals)
        newest = memory.way.newest
        if off_tracking is not None and (newest is None or off_tracking.tick > newest.tick):
            memory = self._judged(memory, tick, off_tracking, motion)
        memory = self._in_hands(memory, tick, motion, elapsed)
        law, wanted = self.law.step(memory.law, tick, _given(memory, off_tracking), signals)
        fallback, relieving = self._fallback.step(memory.fallback, tick, None, signals)
        target = wanted.angles if memory.steers else relieving.angles
        memory = self._steered(memory, tick, target, elapsed)
        return memory._replace(law=law, fallback=fallback, tick=tick), SteerCommand(angles=np.array(memory.demand))

    def _judged(self, memory: GuardMemory, tick: int, seen: OffTracking, motion: HitchMotion) -> GuardMemory:
        """Memory with a new estimate, which is good if it can be believed and those before it could."""
        d, length = self._degradation, self._trailer.follow_distance
        way = moved_on(memory.way, seen, motion, length)
        memory = memory._replace(way=way)
        if not (usable(seen, tick, d.limits) and moves_as_told(seen, way, motion, length)):
            return memory._replace(sound_since=None)
        before = memory.sound
        comparable = before is not None and (seen.tick - before.tick) * TICK <= d.hold
        if before is not None and comparable and jumps(before, seen, length, d.limits):
            return memory._replace(sound=seen, sound_since=None, trusted=False)
        since = tick if memory.sound_since is None else memory.sound_since
        memory = memory._replace(sound=seen, sound_since=since)
        if not memory.trusted and (tick - since) * TICK >= d.recovery:
            memory = memory._replace(trusted=True, steers=True, changed_at=tick)
        return memory._replace(good=seen, good_at=tick) if memory.trusted else memory

    def _in_hands(self, memory: GuardMemory, tick: int, motion: HitchMotion, elapsed: float) -> GuardMemory:
        """Memory after the fallback has been given the axles, if the last good estimate says nothing any more.

        The first can not be there before the path reaches back to the follow point.
        """
        if not memory.steers:
            return memory
        if memory.good is None:
            rolled = memory.rolled + abs(motion.v_x) * elapsed
            due = memory.good_at if rolled > self._trailer.follow_distance else tick
            memory = memory._replace(rolled=rolled, good_at=due)
            if (tick - due) * TICK <= self._degradation.hold + _GAP:
                return memory
            return memory._replace(steers=False, trusted=False, sound_since=None, changed_at=tick)
        held, far = (tick - memory.good_at) * TICK, _HELD_WAY * self._trailer.follow_distance
        if held <= self._degradation.hold and (held <= _GAP or held * abs(motion.v_x) <= far):
            return memory
        return memory._replace(steers=False, trusted=False, sound_since=None, changed_at=tick)

    def _steered(self, memory: GuardMemory, tick: int, target: FloatArray, elapsed: float) -> GuardMemory:
        """Memory with a new demand: the target, and what is left of the difference at the last change of hands."""
        last, t, apart = np.array(memory.demand), self._trailer, np.array(memory.apart)
        if tick == memory.changed_at:
            apart = last - target
        elif apart.any():
            quicker = 1.0 + (tick - memory.changed_at) * TICK / _QUICKENING
            given_up = self._degradation.fade_rate * quicker * elapsed
            apart -= np.clip(apart, -given_up, given_up)
        demand = reachable(t, last, target + apart, elapsed)
        return memory._replace(demand=tuple(demand.tolist()), apart=tuple(apart.tolist()))


def _given(memory: GuardMemory, newest: OffTracking | None) -> OffTracking | None:
    """What the law is told: the newest good estimate, or that there is none."""
    if memory.steers and memory.good is not None:
        return memory.good
    return newest if newest is None else replace(newest, health=Health.LOST)
