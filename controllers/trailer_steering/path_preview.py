"""Path-following trailer steering from the measured hitch path alone, without data of the tractor.

The estimate contains the path of the hitch from the follow point to the hitch, in the trailer's frame. The path's
offset and direction at the follow point give the required direction of the follow point; its newest end gives the
direction of the hitch. The trailer's kinematics then determine the angle of every axle. Three measures allow the loop
to be closed:

- the estimate, 0.1 to 0.2 s old, is predicted to the time when the axles will have answered;
- the slip of the axles is estimated and compensated, its inertial part by feedforward;
- an integral over the distance removes the rest.

Until the buffer reaches back to the follow point there is no path to follow, but the slip is already measured: the
axles compensate it, so that the trailer starts on its path. At speed the trailer's dynamics, which are not part of
rolling kinematics, are as slow as the age of the estimate: the law fades to straight wheels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.trailer import Actuation, SteerCommand, SteeringLaw, TrailerGeometry, no_axle_answers
from controllers.trailer_steering.kinematics import (
    MEASURABLE,
    AxleGroup,
    Predictor,
    SteerHistory,
    Target,
    check_steered,
    reachable,
    recorded,
    slip_between,
    target_on,
)
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import PartParameters, quantity

_HALF_PERIOD = 10  # a demand acts for 20 ms; it is computed for the middle of them [ticks]
_CREEP = 0.2  # below this speed, and in reverse, the axles keep their angles [m/s]
_HISTORY = 3000  # of the steer encoders: age of an estimate and a gap, with margin for slow cameras [ticks]
_OLDEST = 2000  # age at which an estimate is useless and the axles keep their angles [ticks]
_CROSSOVER = 3.5  # upper limit: age of the estimate, steering and tyres leave no phase above [rad/s]
_SLIP_TIME = 0.2  # two estimates; slip measured from a single one is too noisy at speed [s]
# Least time of the slip's low-pass over the speed: four times the lag with which tyres turn a trailer, 1/(4.6 g).
# A quicker one takes that lag of the own steering for slip, and steers against it: trailers of 8 m weave at 22 km/h.
_SLIP_YAW = 4.0 * 0.022  # [s2/m]
_MOST_BIAS = 0.1  # of the integral; the remaining slip is never larger [rad]
# Distance of the axles behind the hitch below which the loop slows down with its square [m]. The axles of a short
# trailer push its hitch, and the towing vehicle rocks on its tyres at 1 to 2 Hz; after the delay of 0.3 s the measured
# direction of the hitch feeds that. Centre-axle trailers with full gains weave at 3 m and are damped from 5 m on.
_LONG = 6.0
_UNDAMPED = 2.0  # the slip is filtered over that many times the distance where no axle is fixed, which would damp
# The loop with its delay of 0.3 s is well damped at 30 km/h and oscillates at 40 km/h: full authority up to about the
# first speed, none from about the second on [m/s].
_FULL_UP_TO, _NONE_FROM = 7.0, 11.0
# Slip beyond what the path's curvature explains from which the loop slows down. Tyres near their limit of friction
# turn the trailer more slowly: leaving a bend on friction 0.3 with 5 % cross-fall, full gains swing by 0.05 m at 1 Hz.
_GRIPPING = 0.03  # [-]


class PathPreviewMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    estimate: OffTracking | None  # newest usable one
    history: SteerHistory
    demand: tuple[float, ...]  # last command [rad]
    slip: float  # mean slip of the axles at that estimate [-]
    other_slip: float  # the part of it that the path's curvature does not explain, low-passed [-]
    bias: float  # integral part of the follow point's turn [rad]
    actuation: Actuation | None = None  # None: the axles do what they are told


class PathPreview(SteeringLaw[PathPreviewMemory]):
    """Axle angles that bring the follow point onto the path of the hitch and keep it there."""

    class Parameters(PartParameters):
        """Parameters; the defaults come from `offtrack tune`, whose study is in scenarios/data/tuning/path_preview."""

        gain: float = quantity(0.77, "rad/m", 0.0, 2.0, "turn of the follow point per offset", tune=(0.15, 1.5))
        integral: float = quantity(0.06, "rad/m2", 0.0, 0.5, "turn per offset and metre travelled", tune=(0.0, 0.12))
        # 1/(4.6 g): cornering stiffness of a truck tyre over its load
        compliance: float = quantity(
            0.022, "rad s2/m", 0.0, 0.1, "axle slip per lateral acceleration", tune=(0.005, 0.06)
        )
        slip_distance: float = quantity(0.6, "m", 0.1, 100.0, "low-pass of the remaining slip", tune=(0.4, 6.0))

    def __init__(self, trailer: TrailerGeometry, *, parameters: Parameters | None = None) -> None:
        """A controller for the trailer.

        Raises:
            ValueError: if the trailer has no steered axle.
        """
        check_steered("path_preview", trailer)
        self._trailer, given = trailer, parameters or self.Parameters()
        self._axles = AxleGroup.of(trailer)
        pace = min(1.0, self._axles.centre / _LONG) ** 2
        self._gain, self._crossover, self._integral = given.gain, pace * _CROSSOVER, pace * given.integral
        calm = 1.0 if len(self._axles.fixed) else _UNDAMPED
        self._compliance, self._slip_distance = pace * given.compliance, calm * given.slip_distance / pace
        self._predictor = Predictor(trailer, self._axles)

    def init(self) -> PathPreviewMemory:
        """Memory without any estimate, wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return PathPreviewMemory(
            tick=None, estimate=None, history=(), demand=straight, slip=0.0, other_slip=0.0, bias=0.0
        )

    def actuated(self, memory: PathPreviewMemory, actuation: Actuation) -> PathPreviewMemory:
        """Memory with the state of the actuators."""
        return memory._replace(actuation=actuation)

    def step(
        self, memory: PathPreviewMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[PathPreviewMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        memory = memory._replace(tick=tick, history=recorded(memory.history, signals, _HISTORY))
        if off_tracking is not None and self._usable(off_tracking):
            memory = self._with_estimate(memory, off_tracking)
        memory, wanted = self._wanted(memory, tick, elapsed)
        demand = reachable(self._trailer, np.array(memory.demand), wanted, elapsed)
        return memory._replace(demand=tuple(demand.tolist())), SteerCommand(angles=demand)

    def _usable(self, estimate: OffTracking) -> bool:
        """True if the estimate is good, or lost only because its path is still short."""
        return estimate.health is not Health.LOST or self._target(estimate.path) is None

    def _with_estimate(self, memory: PathPreviewMemory, estimate: OffTracking) -> PathPreviewMemory:
        """Memory with a usable estimate; a new one gives the slip of the axles since the one before."""
        before = memory.estimate
        if before is not None and estimate.tick <= before.tick:
            return memory
        inertial, other = self._inertial_slip(estimate, self._target(estimate.path)), memory.other_slip
        if before is not None:
            measured = slip_between(before, estimate, self._axles, memory.history)
            other += self._share(before, estimate) * (measured - inertial - other)
        return memory._replace(estimate=estimate, slip=inertial + other, other_slip=other)

    def _share(self, before: OffTracking, estimate: OffTracking) -> float:
        """Weight of a new slip measurement against the old ones, by the distance since the last estimate."""
        interval = (estimate.tick - before.tick) * TICK
        if estimate.v_x < MEASURABLE or interval > _OLDEST * TICK:
            return 0.0
        time = max(self._slip_distance / estimate.v_x, _SLIP_TIME, _SLIP_YAW * estimate.v_x)
        return 1.0 - math.exp(-interval / time)

    def _wanted(self, memory: PathPreviewMemory, tick: int, elapsed: float) -> tuple[PathPreviewMemory, FloatArray]:
        """The angles wanted now [rad], not yet limited in rate."""
        last, estimate = np.array(memory.demand), memory.estimate
        if estimate is None or tick - estimate.tick > _OLDEST or estimate.v_x < _CREEP:
            return memory, last
        until = tick + round(self._trailer.actuator_lag / TICK) + _HALF_PERIOD
        goal = last if memory.actuation is None else memory.actuation.goal
        ahead = self._predictor.ahead(estimate, memory.slip, memory.history, goal, until)
        target = self._target(ahead.frame.inverse().apply(estimate.path))
        share = min(1.0, max(0.0, (_NONE_FROM - estimate.v_x) / (_NONE_FROM - _FULL_UP_TO)))
        if target is None:
            return memory, share * self._axles.slip_angles(memory.slip)
        slip = memory.other_slip + self._inertial_slip(estimate, target)
        bias = self._integrated(memory, share * target.offset * estimate.v_x * elapsed)
        gain = min(self._gain, self._crossover / estimate.v_x) / max(1.0, abs(memory.other_slip) / _GRIPPING)
        follow_direction = target.direction + math.atan(gain * target.offset + bias)
        angles = self._axles.steer_angles(ahead.hitch_direction, follow_direction, slip)
        return memory._replace(bias=bias), share * angles

    def _target(self, path: FloatArray) -> Target | None:
        return target_on(path, self._trailer.follow_distance)

    def _inertial_slip(self, estimate: OffTracking, target: Target | None) -> float:
        """Mean slip [-] due to lateral acceleration, with the follow point at the target; 0 without one.

        The moment of a trailer's inertia about the hitch is that of its mass at the centre of percussion, close to the
        axles of a loaded semitrailer. Lateral acceleration is linear along the axis, as the direction is.
        """
        if target is None:
            return 0.0
        speed = math.hypot(estimate.v_x, estimate.v_y)
        at_hitch = speed * (estimate.hitch_direction_rate + estimate.yaw_rate)
        at_follow_point = speed**2 * target.curvature
        share = self._axles.centre / self._trailer.follow_distance
        return -self._compliance * ((1.0 - share) * at_hitch + share * at_follow_point)

    def _integrated(self, memory: PathPreviewMemory, area: float) -> float:
        """The integral part [rad] after ``area`` [m2] more of offset times distance.

        It waits at full steer, and while no axle answers.
        """
        if min(map(abs, memory.demand)) > self._trailer.max_steer - 1e-6 or no_axle_answers(memory.actuation):
            return memory.bias
        return max(-_MOST_BIAS, min(_MOST_BIAS, memory.bias + self._integral * area))
