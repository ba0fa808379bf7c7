"""Path-following trailer steering from the measured hitch path alone; nothing of the tractor is used.

The estimate holds the way of the hitch from the follow point to the hitch, in the trailer's frame. Its offset and
direction beside the follow point say where the follow point has to go, its newest end where the hitch goes; the
trailer's kinematics then leave one angle for every axle. Three things make it good enough to be closed in a loop: the
estimate, 0.1 to 0.2 s old, is carried on to the moment when the axles will have answered; the slip of the axles is
estimated and given to them, its inertial part beforehand; an integral over the distance takes what is left.

Until the buffer reaches back to the follow point there is no path to follow, but the slip is seen already: the axles
take it away, so that the trailer does not begin beside its path. At speed the trailer's own dynamics, which a rolling
trailer's kinematics know nothing of, are as slow as the estimate is old: the law hands over to straight wheels.
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.trailer import SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import AxleGroup, held
from controllers.trailer_steering.limits import check_steered, reachable
from controllers.trailer_steering.prediction import Predictor, SteerHistory, angles_at, recorded
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.hitch_path import crossing, tangent
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option, check_options
from vehicle.polyline import arc_length

_HALF_PERIOD = 10  # a demand acts for 20 ms; it is made for the middle of them [ticks]
_CREEP = 0.2  # slower than this, or backwards, the law has no meaning and the axles stay where they are [m/s]
_MEASURABLE = 0.5  # slower than this the odometry's noise of some mm a frame is all that a slip shows [m/s]
_HISTORY = 3000  # of the steer encoders: age of an estimate and a gap in them, with room for slow cameras [ticks]
_OLDEST = 2000  # an estimate says nothing of where the trailer is after that, and the axles stay where they are [ticks]
_REACH = 0.75  # half window of the fit to the path beside the follow point [m]
_CROSSOVER = 3.5  # of the loop at most: age of the estimate, steering and tyres leave no phase beyond [rad/s]
_SLIP_TIME = 0.2  # two estimates: slip that is taken from one alone makes the axles restless at speed [s]
_MOST_BIAS = 0.1  # of the integral; no slip that the estimate of it leaves is larger [rad]
# The loop with its 0.3 s of delay is well damped at 30 km/h and swings on at 40 km/h: the law is whole up to the one
# and gone at the other [m/s].
_WHOLE, _GONE = 7.0, 11.0


class Target(NamedTuple):
    """The path beside the follow point, in the trailer's frame."""

    offset: float  # + when it lies left [m]
    direction: float  # + left [rad]
    curvature: float  # + left [1/m]


class PathPreviewMemory(NamedTuple):
    """What the controller carries from one step to the next."""

    tick: int | None  # of the last step; None before the first
    seen: OffTracking | None  # newest usable estimate
    history: SteerHistory
    demand: tuple[float, ...]  # last command [rad]
    slip: float  # mean slip of the axles at that estimate [-]
    other_slip: float  # the part of it that the path's curvature does not explain, low-passed [-]
    bias: float  # integral part of the follow point's turn [rad]


class PathPreview(SteeringLaw[PathPreviewMemory]):
    """The axle angles that bring the follow point onto the path of the hitch, and keep it there."""

    options: ClassVar[tuple[Option, ...]] = (
        Option("gain", 0.77, "turn of the follow point per offset", "rad/m", 0.0, 2.0, tune=(0.15, 1.5)),
        Option("integral", 0.06, "the same per offset and metre", "rad/m2", 0.0, 0.5, tune=(0.0, 0.12)),
        # 1/(4.6 g): cornering stiffness of a truck tyre over its load
        Option("compliance", 0.022, "slip per lateral acceleration", "rad s2/m", 0.0, 0.1, tune=(0.005, 0.06)),
        Option("slip_distance", 0.6, "low-pass on the rest of the slip", "m", 0.1, 100.0, tune=(0.4, 6.0)),
    )

    def __init__(
        self,
        trailer: TrailerGeometry,
        *,
        gain: float = 0.77,
        integral: float = 0.06,
        compliance: float = 0.022,
        slip_distance: float = 0.6,
    ) -> None:
        """A controller for the trailer; ``options`` describes the parameters.

        The defaults come from `offtrack tune`; its study is in scenarios/data/tuning/path_preview.

        Raises:
            ValueError: if the trailer has no steered axle, or a parameter is outside its limits.
        """
        check_steered("path_preview", trailer)
        self._trailer = trailer
        given = {"gain": gain, "integral": integral, "compliance": compliance, "slip_distance": slip_distance}
        check_options(self.options, given)
        self._gain, self._integral = gain, integral
        self._compliance, self._slip_distance = compliance, slip_distance
        self._axles = AxleGroup.of(trailer)
        self._predictor = Predictor(trailer, self._axles)

    def init(self) -> PathPreviewMemory:
        """Nothing seen yet, wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return PathPreviewMemory(tick=None, seen=None, history=(), demand=straight, slip=0.0, other_slip=0.0, bias=0.0)

    def step(
        self, memory: PathPreviewMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[PathPreviewMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        memory = memory._replace(tick=tick, history=recorded(memory.history, signals, _HISTORY))
        if off_tracking is not None and self._usable(off_tracking):
            memory = self._noticed(memory, off_tracking)
        memory, wanted = self._wanted(memory, tick, elapsed)
        demand = reachable(self._trailer, np.array(memory.demand), wanted, elapsed)
        return memory._replace(demand=tuple(demand.tolist())), SteerCommand(angles=demand)

    def _usable(self, seen: OffTracking) -> bool:
        """Whether the estimate is good, or without health for no other reason than that its path is short yet."""
        return seen.health is not Health.LOST or self._target(seen.path) is None

    def _noticed(self, memory: PathPreviewMemory, seen: OffTracking) -> PathPreviewMemory:
        """Memory with a usable estimate; a new one shows how much the axles slipped on the way to it."""
        before = memory.seen
        if before is not None and seen.tick <= before.tick:
            return memory
        inertial, other = self._inertial_slip(seen, self._target(seen.path)), memory.other_slip
        if before is not None:
            other += self._share(before, seen) * (self._measured_slip(memory, before, seen) - inertial - other)
        return memory._replace(seen=seen, slip=inertial + other, other_slip=other)

    def _share(self, before: OffTracking, seen: OffTracking) -> float:
        """Weight of a new measurement of slip against the old ones: of the way made since the estimate before."""
        interval = (seen.tick - before.tick) * TICK
        if seen.v_x < _MEASURABLE or interval > _OLDEST * TICK:
            return 0.0
        return 1.0 - math.exp(-interval / max(self._slip_distance / seen.v_x, _SLIP_TIME))

    def _measured_slip(self, memory: PathPreviewMemory, before: OffTracking, seen: OffTracking) -> float:
        """Mean slip of the axles [-] between two estimates."""
        # The velocities are means over the last frame: the angles of its middle belong to them.
        angles = angles_at(memory.history, np.array([0.5 * (before.tick + seen.tick)]))[0]
        v_x = max(seen.v_x, _MEASURABLE)
        return self._axles.mean_slip(v_x, seen.v_y, seen.yaw_rate, angles)

    def _wanted(self, memory: PathPreviewMemory, tick: int, elapsed: float) -> tuple[PathPreviewMemory, FloatArray]:
        """The angles wanted now [rad], not yet limited in rate."""
        last, seen = np.array(memory.demand), memory.seen
        if seen is None or tick - seen.tick > _OLDEST or seen.v_x < _CREEP:
            return memory, last
        until = tick + round(self._trailer.actuator_lag / TICK) + _HALF_PERIOD
        ahead = self._predictor.ahead(seen, memory.slip, memory.history, last, until)
        target = self._target(ahead.frame.inverse().apply(seen.path))
        share = min(1.0, max(0.0, (_GONE - seen.v_x) / (_GONE - _WHOLE)))
        if target is None:
            return memory, share * self._axles.slip_angles(memory.slip)
        slip = memory.other_slip + self._inertial_slip(seen, target)
        bias = self._integrated(memory, share * target.offset * seen.v_x * elapsed)
        gain = min(self._gain, _CROSSOVER / seen.v_x)
        follow_direction = target.direction + math.atan(gain * target.offset + bias)
        angles = self._axles.steer_angles(ahead.hitch_direction, follow_direction, slip)
        return memory._replace(bias=bias), share * angles

    def _target(self, path: FloatArray) -> Target | None:
        """Where a path (n, 2) passes the follow point; None if it does not reach back that far."""
        s = arc_length(path)
        passed = crossing(path, s, -self._trailer.follow_distance)
        if passed is None:
            return None
        beside = tangent(path, s, passed.s, _REACH)
        return Target(passed.y, held(beside.direction), beside.curvature)

    def _inertial_slip(self, seen: OffTracking, target: Target | None) -> float:
        """Mean slip [-] that carries the trailer round, with its follow point at the target; 0 without one.

        The moment of a trailer's inertia about the hitch is that of its mass at the centre of percussion; loaded
        semitrailers have their axles about there. Lateral acceleration is linear along the axis, as the direction is.
        """
        if target is None:
            return 0.0
        speed = math.hypot(seen.v_x, seen.v_y)
        at_hitch = speed * (seen.hitch_direction_rate + seen.yaw_rate)
        at_follow_point = speed**2 * target.curvature
        share = self._axles.centre / self._trailer.follow_distance
        return -self._compliance * ((1.0 - share) * at_hitch + share * at_follow_point)

    def _integrated(self, memory: PathPreviewMemory, area: float) -> float:
        """The integral part [rad] after ``area`` [m2] more beside the path; it waits while no axle can steer more."""
        if min(map(abs, memory.demand)) > self._trailer.max_steer - 1e-6:
            return memory.bias
        return max(-_MOST_BIAS, min(_MOST_BIAS, memory.bias + self._integral * area))
