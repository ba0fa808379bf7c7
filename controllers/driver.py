"""Tractor drivers: their interface, the preview driver, a driver who repeats a recording, and one who shunts.

Forwards the preview driver drives. In reverse the last trailer's axle is steered back along the path on which it came,
at walking pace, slower with a short dolly or trailer; the driver reads the articulation in the mirrors.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np

from controllers import preview_law as law
from controllers.equations import FLOATS
from controllers.path import Path, SpeedProfile
from controllers.preview_law import speed_control
from controllers.reversing_law import ReverseReference, ReversingLaw, RollingChain
from controllers.tractor import TractorGeometry
from sensors.messages import EgoState
from vehicle.clock import TICK, elapsed_since
from vehicle.frames import FloatArray, Pose2

PERIOD: Final = law.PERIOD  # the driver's step [s]
_COMFORTABLE: Final = 0.7  # planned braking and speeding up: half of the limit, which leaves room to control [m/s2]


class DriverCommand(NamedTuple):
    """The driver's demands."""

    steer: float  # road-wheel angle [rad]
    acceleration: float  # positive: driving in the gear's direction; negative: braking [m/s2]
    gear: float = 1.0  # +1 forward, -1 backward


Memory = TypeVar("Memory")


class DriverLike(Protocol[Memory]):
    """A driver of the tractor: pure, memory in and memory out."""

    def init(self) -> Memory:
        """Memory before the first step."""

    def step(self, memory: Memory, tick: int, ego: EgoState, /) -> tuple[Memory, DriverCommand]:
        """New memory and command at ``tick``."""


class Driver(DriverLike[Memory], Protocol[Memory]):
    """A driver with a timetable."""

    @property
    def duration(self) -> float:
        """Planned duration of the drive [s]."""

    @property
    def start_speed(self) -> float | None:
        """Speed at the start [m/s]; None: any."""


class DriverMemory(NamedTuple):
    """State of the driver between two steps."""

    tick: int | None  # of the last step; None before the first
    station: float  # guided point along the path [m]
    demand: float  # last steer demand [rad]
    steer: float  # predicted steer angle now [rad]
    front_slip: float  # slip angle of the relaxed front tyres [rad]
    speed_integral: float  # [m/s2]
    rear_slip: float = 0.0  # of the rear tyres [rad]
    side: float = 0.0  # unknown side force over the mass [m/s2]
    turn: float = 0.0  # its moment over the mass [m2/s2]
    motion: law.Motion[float] = law.Motion(0.0, 0.0, 0.0)  # at the last step

    @property
    def slips(self) -> law.Slips[float]:
        """The remembered state of the tyres."""
        return law.Slips(self.front_slip, self.rear_slip, self.side, self.turn)


class PreviewDriver(Driver[DriverMemory]):
    """Path-preview driver: keeps the guided point on a path at a set speed (equations in `preview_law`)."""

    def __init__(
        self,
        tractor: TractorGeometry,
        path: Path,
        speed: float,
        *,
        gain: float = law.GAIN,
        max_lateral_acceleration: float = math.inf,
    ) -> None:
        """A driver for the set ``speed`` [m/s]; ``gain``: turn towards the path per lateral error [rad/m].

        The loop gets as fast as that only where the lags of steering, tyres and yaw allow it (`preview_design`). The
        driver slows down in time for turns that would exceed ``max_lateral_acceleration`` [m/s2].
        """
        self.tractor, self.path, self.speed = tractor, path, speed
        self._gain, self._gains = gain, law.gains(tractor, gain)
        self._profile: SpeedProfile | None = None
        if math.isfinite(max_lateral_acceleration):
            self._profile = SpeedProfile.of(path, speed, max_lateral_acceleration, _COMFORTABLE)

    @property
    def start_speed(self) -> float:
        """Set speed [m/s]."""
        return self.speed

    @property
    def duration(self) -> float:
        """Planned duration of the drive along the path [s]."""
        return self.path.length / self.speed if self._profile is None else self._profile.duration

    def init(self) -> DriverMemory:
        """Memory at the start of the path, wheels straight."""
        return DriverMemory(tick=None, station=0.0, demand=0.0, steer=0.0, front_slip=0.0, speed_integral=0.0)

    def step(
        self, memory: DriverMemory, tick: int, ego: EgoState, speed_limit: float = math.inf
    ) -> tuple[DriverMemory, DriverCommand]:
        """New memory and command at ``tick``; no faster than ``speed_limit`` [m/s]."""
        elapsed = elapsed_since(memory.tick, tick)
        steer = self._settled(memory.steer, memory.demand, elapsed)
        motion = law.Motion(ego.v_x, ego.v_y, ego.yaw_rate)
        slips = law.slips_after(FLOATS, self.tractor, memory.slips, memory.motion, motion, steer, elapsed)
        station, demand = self._steer_demand(memory.station, ego, motion, slips, steer)
        wanted = self.speed if self._profile is None else self._profile.at(station)
        error = min(wanted, speed_limit) - ego.v_x
        integral, acceleration = law.speed_control(FLOATS, memory.speed_integral, error, elapsed)
        after = DriverMemory(tick, station, demand, steer, slips.front, integral, *slips[1:], motion)
        return after, DriverCommand(steer=demand, acceleration=acceleration)

    def following(self, memory: DriverMemory, tick: int, ego: EgoState, demand: float) -> DriverMemory:
        """Memory while another driver steers with ``demand`` [rad]; the filters and the integral start anew."""
        elapsed = elapsed_since(memory.tick, tick)
        steer = self._settled(memory.steer, memory.demand, elapsed)
        point = Pose2(ego.x, ego.y, ego.psi) @ Pose2(self.tractor.x_ref, self.tractor.y_ref, 0.0)
        station = self.path.project(point.x, point.y, memory.station)
        return DriverMemory(tick, station, demand, steer, 0.0, 0.0, motion=law.Motion(ego.v_x, ego.v_y, ego.yaw_rate))

    def _settled(self, steer: float, demand: float, duration: float) -> float:
        return float(law.steer_after(FLOATS, self.tractor, steer, demand, duration))

    def _steer_demand(
        self, near: float, ego: EgoState, motion: law.Motion[float], slips: law.Slips[float], steer: float
    ) -> tuple[float, float]:
        """Station of the guided point on the path [m] and the steer angle that it needs [rad]."""
        t, path = self.tractor, self.path
        guided_point = t.x_ref, t.y_ref
        point = Pose2(ego.x, ego.y, ego.psi) @ Pose2(*guided_point, 0.0)
        station = path.project(point.x, point.y, near)
        on_path, u = path.pose(station), law.travel(FLOATS, guided_point, motion)
        ahead = path.headings([station + u * time for time in law.EDGES[1:]])
        on = law.OnPath(
            to_path=math.cos(on_path.psi) * (on_path.y - point.y) - math.sin(on_path.psi) * (on_path.x - point.x),
            heading_error=math.remainder(on_path.psi - ego.psi, math.tau),
            curvature=path.curvature(station),
            headings=[heading - on_path.psi for heading in ahead],
        )
        row = self._gains.row(motion.v_x)
        demand = law.steer_demand(FLOATS, t, guided_point, on, motion, slips, steer, row, self._gain)
        return station, demand


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriverTrace:
    """A recorded drive, linear between its samples and constant after the last one.

    Raises:
        ValueError: if the times do not increase from 0 s on, or lengths differ.
    """

    time: FloatArray  # (n,) [s]
    steer: FloatArray  # (n,) road-wheel angle, + left [rad]
    speed: FloatArray | None = None  # (n,) [m/s]; None: the acceleration is used
    acceleration: FloatArray | None = None  # (n,) [m/s2]; with a speed: feedforward

    def __post_init__(self) -> None:
        if len(self.time) < 2 or self.time[0] != 0.0 or not np.all(np.diff(self.time) > 0.0):
            raise ValueError("time must have two samples or more, start at 0 s and increase")
        if self.speed is None and self.acceleration is None:
            raise ValueError("a trace needs a speed or an acceleration")
        for values in (self.steer, self.speed, self.acceleration):
            if values is not None and len(values) != len(self.time):
                raise ValueError(f"{len(values)} values for {len(self.time)} times")

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])


class TraceMemory(NamedTuple):
    """State of the driver between two steps."""

    tick: int | None  # of the last step; None before the first
    integral: float  # of the speed control [m/s2]


class TraceDriver(Driver[TraceMemory]):
    """Steers open loop; a recorded speed is kept by feedback."""

    def __init__(self, trace: DriverTrace) -> None:
        self._trace = trace

    @property
    def duration(self) -> float:
        """Duration of the recorded drive [s]."""
        return self._trace.duration

    @property
    def start_speed(self) -> float | None:
        """Speed at the start [m/s]; None if the recording has no speed."""
        return None if self._trace.speed is None else float(self._trace.speed[0])

    def init(self) -> TraceMemory:
        """Memory before the first step."""
        return TraceMemory(None, 0.0)

    def step(self, memory: TraceMemory, tick: int, ego: EgoState) -> tuple[TraceMemory, DriverCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
        trace, now = self._trace, tick * TICK
        steer = float(np.interp(now, trace.time, trace.steer))
        acceleration = self._recorded_acceleration(now)
        integral = memory.integral
        if trace.speed is not None:
            error = float(np.interp(now, trace.time, trace.speed)) - ego.v_x
            integral += law.SPEED_INTEGRAL * error * elapsed
            acceleration += law.SPEED_GAIN * error + integral
        return TraceMemory(tick, integral), DriverCommand(steer=steer, acceleration=acceleration)

    def _recorded_acceleration(self, now: float) -> float:
        """Acceleration as recorded, or the slope of the recorded speed [m/s2]; zero after the end."""
        time, speed, acceleration = self._trace.time, self._trace.speed, self._trace.acceleration
        if acceleration is not None:
            return float(np.interp(now, time, acceleration, right=0.0))
        k = int(np.searchsorted(time, now, side="right"))
        if speed is None or k >= len(time):
            return 0.0
        return float((speed[k] - speed[k - 1]) / (time[k] - time[k - 1]))


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
