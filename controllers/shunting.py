"""A driver who stops on his way, waits, goes back some of it and goes on.

Forwards he drives as ``PreviewDriver`` does. Backwards he takes his last trailer's axle along the way that it came, as
he has it in his mirrors, at a walking pace.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from controllers.driver import Driver, DriverCommand, DriverMemory, PreviewDriver, speed_control
from controllers.reversing.chain import RollingChain
from controllers.reversing.law import ReversingLaw
from controllers.reversing.reference import ReverseReference
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.frames import Pose2

_PACE: Final = 1.2  # backwards: brisk walking [m/s]
_GENTLY: Final = 0.5  # he sets off and plans to stop with it [m/s2]
_AT_ONCE: Final = 0.15  # of a stop: what is left is for the brakes [m]
_STOPPING: Final = 0.5  # asked of the brakes there: as planned, so that the combination hardly rocks [m/s2]
_HOLDING: Final = 1.5  # asked of the brakes while he waits: a hill of 15 % [m/s2]
_STANDING: Final = 0.03  # slower is no motion [m/s]
_TRACK: Final = 0.25  # between the points of the way that he remembers [m]
_REMEMBERED: Final = 400  # of them: 100 m


class Stop(NamedTuple):
    """Where he stops, and what he does there."""

    station: float  # of the guided point along the path [m]
    wait: float  # how long he stands [s]
    back: float = 0.0  # how far he goes back then, before he stands as long again and goes on [m]


class Leg(NamedTuple):
    """A stretch in one gear."""

    gear: float  # +1 forward, -1 backward
    end: float  # forwards: station where it ends; backwards: how far back [m]
    wait: float  # at its end [s]


class Reversing(NamedTuple):
    """A leg backwards under way."""

    reference: ReverseReference
    station: float  # of the last axle [m]
    end: float  # station where the leg ends [m]


class ShuntMemory(NamedTuple):
    """What he carries from one step to the next."""

    forward: DriverMemory  # its steering is kept up backwards, too
    leg: int
    since: int | None  # tick at which the leg began; None before the first step
    waiting: int | None  # tick since which he stands at the leg's end; None on the way
    integral: float  # of the speed control backwards [m/s2]
    track: tuple[tuple[float, float], ...]  # the last axle's way, the newest point last [m]
    reversing: Reversing | None


class ShuntingDriver(Driver[ShuntMemory]):
    """Follows a path with stops and legs backwards.

    Raises:
        ValueError: if the stops are not in the path's order, off it, or a leg backwards is longer than its way there.
    """

    def __init__(self, forward: PreviewDriver, chain: RollingChain, stops: Sequence[Stop]) -> None:
        """``forward`` drives between the stops."""
        self._forward, self._chain, self._law = forward, chain, ReversingLaw(chain)
        self._legs = _legs(stops, forward.path_length)
        self._stops = tuple(stops)

    @property
    def duration(self) -> float:
        """How long he means to take for the path, with all that he does on it [s]."""
        stopping = self._forward.speed / _GENTLY + _PACE / _GENTLY  # more than braking and setting off take
        found = self._forward.duration
        for stop in self._stops:
            found += stop.wait + stopping
            if stop.back > 0.0:
                found += stop.wait + stopping + stop.back / _PACE + stop.back / self._forward.speed
        return found

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
            return self._ahead(memory, tick, ego, leg.end - memory.forward.station)
        return self._back(memory, tick, ego, last)

    def _next_leg(self, memory: ShuntMemory, tick: int, last: Pose2) -> ShuntMemory:
        """Memory at the beginning of the next leg, if the wait is over."""
        if memory.since is None:  # he comes along at speed: setting off is behind him
            return memory._replace(since=tick - round(self._forward.speed / _GENTLY / TICK))
        if memory.waiting is None or (tick - memory.waiting) * TICK < self._legs[memory.leg].wait:
            return memory
        memory = memory._replace(leg=memory.leg + 1, since=tick, waiting=None, integral=0.0, reversing=None)
        coming = self._legs[memory.leg]
        if coming.gear > 0.0:
            return memory
        reference = ReverseReference.of(self._chain, np.array(memory.track))
        station = reference.project(last.x, last.y, _TRACK * (len(memory.track) - 1))
        return memory._replace(track=(), reversing=Reversing(reference, station, station - coming.end))

    def _ahead(self, memory: ShuntMemory, tick: int, ego: EgoState, left: float) -> tuple[ShuntMemory, DriverCommand]:
        """Forwards, with so much of the leg left [m]."""
        if left <= _AT_ONCE:
            return self._held(memory, tick, ego, memory.forward.demand, -_STOPPING)
        limit = _speed_limit(memory, tick, left)
        forward, command = self._forward.step(memory.forward, tick, ego, limit)
        return memory._replace(forward=forward), command

    def _back(self, memory: ShuntMemory, tick: int, ego: EgoState, last: Pose2) -> tuple[ShuntMemory, DriverCommand]:
        """Backwards along the reference."""
        way = memory.reversing
        if way is None:
            raise ValueError("memory: a leg backwards without its way is that of another driver")
        station = way.reference.project(last.x, last.y, way.station)
        demand = self._law.steer(last, np.array(ego.articulation), way.reference.at(station))
        memory, left = memory._replace(reversing=way._replace(station=station)), station - way.end
        if left <= _AT_ONCE:
            return self._held(memory, tick, ego, demand, -_STOPPING)
        error = min(_PACE, _speed_limit(memory, tick, left)) + ego.v_x
        elapsed = 0.0 if memory.forward.tick is None else (tick - memory.forward.tick) * TICK
        integral, acceleration = speed_control(memory.integral, error, elapsed)
        forward = self._forward.led(memory.forward, tick, ego, demand)
        command = DriverCommand(demand, acceleration, gear=-1.0)
        return memory._replace(forward=forward, integral=integral), command

    def _held(
        self, memory: ShuntMemory, tick: int, ego: EgoState, demand: float, braking: float
    ) -> tuple[ShuntMemory, DriverCommand]:
        """On the brakes; once he stands, the wait begins."""
        forward = self._forward.led(memory.forward, tick, ego, demand)
        stands = memory.waiting is None and abs(ego.v_x) < _STANDING
        memory = memory._replace(forward=forward, waiting=tick if stands else memory.waiting)
        return memory, DriverCommand(demand, braking, self._legs[memory.leg].gear)


def _legs(stops: Sequence[Stop], length: float) -> tuple[Leg, ...]:
    """The stretches between the stops."""
    found: list[Leg] = []
    reached = 0.0
    for k, stop in enumerate(stops):
        if not reached < stop.station < length:
            raise ValueError(
                f"stops.{k}: station = {stop.station:g} m must be beyond {reached:g} m and before the path's end at "
                f"{length:.1f} m"
            )
        if not 0.0 <= stop.back <= stop.station:
            raise ValueError(f"stops.{k}: back = {stop.back:g} m must be between 0 and the station, {stop.station:g} m")
        found.append(Leg(1.0, stop.station, stop.wait))
        if stop.back > 0.0:
            found.append(Leg(-1.0, stop.back, stop.wait))
        reached = stop.station - stop.back
    return (*found, Leg(1.0, math.inf, 0.0))


def _recorded(track: tuple[tuple[float, float], ...], last: Pose2) -> tuple[tuple[float, float], ...]:
    """The track with where the last axle is, if that is further on."""
    if track and math.hypot(last.x - track[-1][0], last.y - track[-1][1]) < _TRACK:
        return track
    return (*track[-_REMEMBERED:], (last.x, last.y))


def _speed_limit(memory: ShuntMemory, tick: int, left: float) -> float:
    """The speed [m/s] that setting off gently and stopping gently, ``left`` [m] on, allow."""
    since = tick if memory.since is None else memory.since
    return min(_GENTLY * (tick - since) * TICK + _STANDING, math.sqrt(2.0 * _GENTLY * max(left, 0.0)))
