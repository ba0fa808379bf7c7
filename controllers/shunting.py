"""A driver who stops along the path, waits, reverses some distance and drives on.

Forwards the preview driver drives. In reverse the last trailer's axle is steered back along the path on which it came,
at walking pace, slower with a short dolly or trailer; the driver reads the articulation in the mirrors.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from controllers.driver import Driver, DriverCommand, DriverMemory, PreviewDriver
from controllers.equations import FLOATS
from controllers.preview_law import speed_control
from controllers.reversing_law import ReverseReference, ReversingLaw, RollingChain
from sensors.messages import EgoState
from vehicle.clock import TICK, elapsed_since
from vehicle.frames import Pose2

_REVERSE_SPEED: Final = 1.2  # at most: brisk walking [m/s]
# A towed unit folds in reverse by exp(1) per length of its own. While the steer goes from lock to lock at its largest
# rate, the shortest unit travels that share of its length at most: it folds by 65 %, which the law brings back.
_FOLDING: Final = 0.5
_GENTLE: Final = 0.5  # planned acceleration for setting off and stopping [m/s2]
_BRAKE_DISTANCE: Final = 0.15  # before a stop, from which on only the brakes act [m]
_STOPPING: Final = 0.5  # braking there: as planned, so that the combination hardly rocks [m/s2]
_HOLDING: Final = 1.5  # braking at a standstill: holds on a hill of 15 % [m/s2]
_STANDING: Final = 0.03  # slower counts as standing [m/s]
_TRACK_SPACING: Final = 0.25  # of the recorded points [m]
_TRACK_POINTS: Final = 400  # recorded at most: 100 m


class Stop(NamedTuple):
    """A stop along the path."""

    station: float  # of the guided point along the path [m]
    wait: float  # standing time [s]
    back: float = 0.0  # distance reversed after that, followed by the same wait [m]


class Leg(NamedTuple):
    """A part of the drive in one gear."""

    gear: float  # +1 forward, -1 backward
    end: float  # forwards: station of its end; in reverse: distance [m]
    wait: float  # at its end [s]


class Reversing(NamedTuple):
    """A leg in reverse."""

    reference: ReverseReference
    station: float  # of the last axle [m]
    end: float  # station where the leg ends [m]


class ShuntMemory(NamedTuple):
    """State of the driver between two steps."""

    forward: DriverMemory  # also updated in reverse
    leg: int
    since: int | None  # tick at which the leg began; None before the first step
    waiting: int | None  # tick of the standstill at the leg's end; None while driving
    integral: float  # of the speed control in reverse [m/s2]
    track: tuple[tuple[float, float], ...]  # path of the last axle, the newest point last [m]
    reversing: Reversing | None


class ShuntingDriver(Driver[ShuntMemory]):
    """Follows a path with stops and legs in reverse.

    Raises:
        ValueError: if the stops are not in the path's order or not on it, or if a leg in reverse is longer than the
            path before it.
    """

    def __init__(self, forward: PreviewDriver, chain: RollingChain, stops: Sequence[Stop]) -> None:
        """``forward`` drives between the stops."""
        self._forward, self._chain, self._law = forward, chain, ReversingLaw(chain)
        self._legs = _legs(stops, forward.path.length)
        self._stops = tuple(stops)
        lock_to_lock = 2.0 * chain.max_steer / forward.tractor.max_steer_rate  # [s]
        self._reverse_speed = min(_REVERSE_SPEED, _FOLDING * min(chain.lengths) / lock_to_lock)  # [m/s]

    @property
    def duration(self) -> float:
        """Planned duration of the drive with its stops and legs in reverse [s]."""
        # longer than braking and setting off take
        stopping = self._forward.speed / _GENTLE + self._reverse_speed / _GENTLE
        duration = self._forward.duration
        for stop in self._stops:
            duration += stop.wait + stopping
            if stop.back > 0.0:
                duration += stop.wait + stopping + stop.back / self._reverse_speed + stop.back / self._forward.speed
        return duration

    @property
    def start_speed(self) -> float:
        """Set speed forwards [m/s]."""
        return self._forward.speed

    def init(self) -> ShuntMemory:
        """At the start of the path."""
        return ShuntMemory(self._forward.init(), 0, None, None, 0.0, (), None)

    def step(self, memory: ShuntMemory, tick: int, ego: EgoState) -> tuple[ShuntMemory, DriverCommand]:
        """New memory and command at ``tick``."""
        last = self._chain.last_axle(Pose2(ego.x, ego.y, ego.psi), ego.articulation)
        memory = self._next_leg(memory, tick, last)
        leg = self._legs[memory.leg]
        if leg.gear > 0.0:
            memory = memory._replace(track=_recorded(memory.track, last))
        if memory.waiting is not None:
            return self._held(memory, tick, ego, memory.forward.demand, -_HOLDING)
        if leg.gear > 0.0:
            return self._drive_forward(memory, tick, ego, leg.end - memory.forward.station)
        return self._drive_back(memory, tick, ego, last)

    def _next_leg(self, memory: ShuntMemory, tick: int, last: Pose2) -> ShuntMemory:
        """Memory at the start of the next leg if the wait is over, else the same."""
        if memory.since is None:  # the run starts at speed
            return memory._replace(since=tick - round(self._forward.speed / _GENTLE / TICK))
        if memory.waiting is None or (tick - memory.waiting) * TICK < self._legs[memory.leg].wait:
            return memory
        memory = memory._replace(leg=memory.leg + 1, since=tick, waiting=None, integral=0.0, reversing=None)
        coming = self._legs[memory.leg]
        if coming.gear > 0.0:
            return memory
        reference = ReverseReference.of(self._chain, np.array(memory.track))
        station = reference.project(last.x, last.y, _TRACK_SPACING * (len(memory.track) - 1))
        return memory._replace(track=(), reversing=Reversing(reference, station, station - coming.end))

    def _drive_forward(
        self, memory: ShuntMemory, tick: int, ego: EgoState, left: float
    ) -> tuple[ShuntMemory, DriverCommand]:
        """Forward step with ``left`` [m] to the end of the leg."""
        if left <= _BRAKE_DISTANCE:
            return self._held(memory, tick, ego, memory.forward.demand, -_STOPPING)
        limit = _speed_limit(memory, tick, left)
        forward, command = self._forward.step(memory.forward, tick, ego, limit)
        return memory._replace(forward=forward), command

    def _drive_back(
        self, memory: ShuntMemory, tick: int, ego: EgoState, last: Pose2
    ) -> tuple[ShuntMemory, DriverCommand]:
        """Reverse step along the reference."""
        leg = memory.reversing
        if leg is None:
            raise ValueError("memory: a leg in reverse without its reference belongs to another driver")
        station = leg.reference.project(last.x, last.y, leg.station)
        demand = self._law.steer(last, np.array(ego.articulation), leg.reference.at(station))
        memory, left = memory._replace(reversing=leg._replace(station=station)), station - leg.end
        if left <= _BRAKE_DISTANCE:
            return self._held(memory, tick, ego, demand, -_STOPPING)
        error = min(self._reverse_speed, _speed_limit(memory, tick, left)) + ego.v_x
        elapsed = elapsed_since(memory.forward.tick, tick)
        integral, acceleration = speed_control(FLOATS, memory.integral, error, elapsed)
        forward = self._forward.following(memory.forward, tick, ego, demand)
        command = DriverCommand(demand, acceleration, gear=-1.0)
        return memory._replace(forward=forward, integral=integral), command

    def _held(
        self, memory: ShuntMemory, tick: int, ego: EgoState, demand: float, braking: float
    ) -> tuple[ShuntMemory, DriverCommand]:
        """Braked step; the wait begins at the standstill."""
        forward = self._forward.following(memory.forward, tick, ego, demand)
        stands = memory.waiting is None and abs(ego.v_x) < _STANDING
        memory = memory._replace(forward=forward, waiting=tick if stands else memory.waiting)
        return memory, DriverCommand(demand, braking, self._legs[memory.leg].gear)


def _legs(stops: Sequence[Stop], length: float) -> tuple[Leg, ...]:
    """Legs between the stops."""
    legs: list[Leg] = []
    reached = 0.0
    for k, stop in enumerate(stops):
        if not reached < stop.station < length:
            raise ValueError(
                f"stops.{k}: station = {stop.station:g} m must be beyond {reached:g} m and before the path's end at "
                f"{length:.1f} m"
            )
        if not 0.0 <= stop.back <= stop.station:
            raise ValueError(f"stops.{k}: back = {stop.back:g} m must be between 0 and the station, {stop.station:g} m")
        legs.append(Leg(1.0, stop.station, stop.wait))
        if stop.back > 0.0:
            legs.append(Leg(-1.0, stop.back, stop.wait))
        reached = stop.station - stop.back
    return (*legs, Leg(1.0, math.inf, 0.0))


def _recorded(track: tuple[tuple[float, float], ...], last: Pose2) -> tuple[tuple[float, float], ...]:
    """Track with the last axle's position, if it has moved far enough."""
    if track and math.hypot(last.x - track[-1][0], last.y - track[-1][1]) < _TRACK_SPACING:
        return track
    return (*track[-_TRACK_POINTS:], (last.x, last.y))


def _speed_limit(memory: ShuntMemory, tick: int, left: float) -> float:
    """Speed [m/s] at which the planned acceleration allows a stop after ``left`` [m]; it rises after setting off."""
    since = tick if memory.since is None else memory.since
    return min(_GENTLE * (tick - since) * TICK + _STANDING, math.sqrt(2.0 * _GENTLE * max(left, 0.0)))
