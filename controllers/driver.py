"""Tractor drivers: their interface, the preview driver, and a driver who repeats a recording."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np

from controllers import preview_law as law
from controllers.equations import FLOATS
from controllers.path import Path, SpeedProfile
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
    """Path-preview driver: keeps the guided point on a path at a set speed (equations in `preview_law`).

    Raises:
        ValueError: if the speed or the gain is not positive.
    """

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
        if not speed > 0.0:
            raise ValueError(f"speed = {speed} m/s must be positive")
        if not gain > 0.0:
            raise ValueError(f"gain = {gain} rad/m must be positive")
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
