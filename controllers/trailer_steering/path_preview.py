"""Path-following trailer steering from the measured hitch path alone; nothing of the tractor is used.

The estimate holds the way of the hitch from the follow point to the hitch, in the trailer's frame. Its direction and
offset beside the follow point say where the follow point has to go, its newest end where the hitch goes; the
trailer's kinematics then leave one angle for every axle. Three things make it good enough to be closed in a loop: the
estimate, 0.1 to 0.2 s old, is carried on to the moment when the axles have answered; the slip of the axles is
estimated from the trailer's measured motion and its steer encoders and given to them; and an integral over the
travelled distance takes what is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from controllers.trailer import SteerCommand, TrailerGeometry
from controllers.trailer_steering.kinematics import AxleGroup, held
from controllers.trailer_steering.prediction import Ahead, Predictor, SteerHistory, angles_at, recorded
from estimators.estimates import Health, OffTracking
from estimators.hitch_path import chord_lengths, crossing, tangent
from sensors.messages import SteerAngles
from vehicle.clock import TICK, to_ticks
from vehicle.frames import FloatArray

_PERIOD = 20  # the controller's step; a demand acts for this long [ticks]
_CREEP = 0.2  # slower than this, or backwards, the law has no meaning and the axles stay where they are [m/s]
_HISTORY = 700  # of the steer encoders: the oldest usable estimate and its finite differences [ticks]
_REACH = 0.75  # half window of the path tangent's fit [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class PathPreviewParameters:
    """What can be tuned.

    Raises:
        ValueError: if a value is outside its limits.
    """

    gain: float = 0.4  # turn of the follow point towards the path per offset [rad/m]
    integral: float = 0.02  # the same per offset and metre travelled [rad/m2]
    slip_distance: float = 2.0  # low-pass on the axles' mean slip [m]
    hold: float = 0.5  # how long the last command stands when there is no estimate any more [s]
    fade_rate: float = 0.05  # at which the axles go straight after that [rad/s]

    def __post_init__(self) -> None:
        limits = {"gain": (0.0, 2.0), "integral": (0.0, 0.5), "slip_distance": (0.1, 100.0), "hold": (0.0, 5.0)}
        limits["fade_rate"] = (0.001, 1.0)
        for field in fields(self):
            low, high = limits[field.name]
            value = getattr(self, field.name)
            if not low <= value <= high:
                raise ValueError(f"{field.name} = {value} must be between {low} and {high}")


class PathPreviewMemory(NamedTuple):
    """What the controller carries from one step to the next."""

    tick: int | None  # of the last step; None before the first
    seen: OffTracking | None  # newest usable estimate
    history: SteerHistory
    demand: tuple[float, ...]  # last command [rad]
    mean_slip: float  # of the axles [-]
    offset_integral: float  # of the offset over the distance [m2]


class PathPreview:
    """The axle angles that bring the follow point onto the path of the hitch, and keep it there."""

    def __init__(self, trailer: TrailerGeometry, **parameters: float) -> None:
        """A controller for the trailer; ``parameters`` are those of `PathPreviewParameters`."""
        self._trailer = trailer
        self._parameters = PathPreviewParameters(**parameters)
        self._axles = AxleGroup.of(trailer)
        self._predictor = Predictor(trailer, self._axles)

    def init(self) -> PathPreviewMemory:
        """Nothing seen yet, wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return PathPreviewMemory(None, None, (), straight, 0.0, 0.0)

    def step(
        self, memory: PathPreviewMemory, tick: int, off_tracking: OffTracking | None, steer: SteerAngles
    ) -> tuple[PathPreviewMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        memory = memory._replace(tick=tick, history=recorded(memory.history, steer, _HISTORY))
        if off_tracking is not None and off_tracking.health is not Health.LOST:
            memory = self._noticed(memory, off_tracking)
        memory, wanted = self._wanted(memory, tick, elapsed)
        demand = self._reachable(np.array(memory.demand), wanted, elapsed)
        return memory._replace(demand=tuple(demand.tolist())), SteerCommand(angles=demand)

    def _noticed(self, memory: PathPreviewMemory, seen: OffTracking) -> PathPreviewMemory:
        """Memory with a usable estimate; a new one shows how much the axles slipped on the way to it."""
        before = memory.seen
        if before is not None and seen.tick <= before.tick:
            return memory
        memory = memory._replace(seen=seen)
        if before is None or seen.v_x < _CREEP:
            return memory
        # The velocities are means over the last frame: they belong to its middle.
        middle = np.array([0.5 * (before.tick + seen.tick)])
        angles = angles_at(memory.history, middle)[0]
        slip = self._axles.mean_slip(seen.v_x, seen.v_y, seen.yaw_rate, angles)
        way = math.hypot(seen.v_x, seen.v_y) * (seen.tick - before.tick) * TICK
        share = 1.0 - math.exp(-way / self._parameters.slip_distance)
        return memory._replace(mean_slip=memory.mean_slip + share * (slip - memory.mean_slip))

    def _wanted(self, memory: PathPreviewMemory, tick: int, elapsed: float) -> tuple[PathPreviewMemory, FloatArray]:
        """The angles wanted now [rad], not yet limited in rate."""
        last = np.array(memory.demand)
        seen, p = memory.seen, self._parameters
        if seen is None:
            return memory, np.zeros_like(last)
        if seen.age(tick) > p.hold:
            fade = p.fade_rate * elapsed
            return memory, np.clip(0.0, last - fade, last + fade)
        if seen.v_x < _CREEP:
            return memory, last
        until = tick + to_ticks(round(self._trailer.actuator_lag, 3), "actuator_lag") + _PERIOD // 2
        ahead = self._predictor.ahead(seen, memory.mean_slip, memory.history, last, until)
        beside = self._beside(seen, ahead)
        if beside is None:
            return memory, last
        offset, direction = beside
        integral = memory.offset_integral + offset * seen.v_x * elapsed
        follow = direction + math.atan(p.gain * offset + p.integral * integral)
        wanted = self._axles.steer_angles(ahead.hitch_direction, follow, memory.mean_slip)
        if np.abs(wanted).max() >= self._trailer.max_steer:
            integral = memory.offset_integral
        return memory._replace(offset_integral=integral), wanted

    def _beside(self, seen: OffTracking, ahead: Ahead) -> tuple[float, float] | None:
        """Offset [m] and direction [rad] of the path beside the follow point then, in the trailer's frame then."""
        path = ahead.frame.inverse().apply(seen.path)
        s = chord_lengths(path)
        passed = crossing(path, s, -self._trailer.follow_distance)
        if passed is None:
            return None
        return passed.y, held(tangent(path, s, passed.s, _REACH).direction)

    def _reachable(self, last: FloatArray, wanted: FloatArray, elapsed: float) -> FloatArray:
        """The wanted angles as far as the actuators' rate and angle allow [rad]."""
        reach = self._trailer.max_steer_rate * elapsed
        limit = self._trailer.max_steer
        return np.clip(np.clip(wanted, last - reach, last + reach), -limit, limit)
