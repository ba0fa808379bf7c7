"""A virtual driver at the trailer's rear: PID with preview on the off-tracking error.

Cheng, Roebuck, Odhams and Cebon's scheme as de Saxe & Cebon 2018 describe it: a virtual driver at the follow point
steers it onto the path of the hitch by preview and by proportional, integral and derivative action on the off-tracking.
With the no-slip estimate (off_tracking = kinematic) it is Cheng's controller; with a measured off-tracking it is Miao's
reformulation, which tolerates slip. Gains are not published. Derived here:

- Preview. The driver sees the path as it will be when his axles have answered: the estimate is predicted over its own
  age and the lag of the actuators. His direction of travel is that of the path there, so a steady turn needs no error.
- Proportional. Per metre travelled the error changes by the angle between path and direction of travel. A driver who
  aims at the point of the path ``preview`` ahead turns by error/preview: the error decays over that distance.
- Derivative. The part of the error's change that the steering explains is in the prediction. The rest is the drift of
  axles that slip; it is measured, low-passed over twice the lag of the tyres, and steered against.
- Integral. With the gain K of the proportional part and I of the integral the error obeys e'' + K e' + I e = 0 over the
  distance: damped critically at I = K^2/4. Half of that is left for the lags; where K falls, I falls as its square.
- Crossover. It is K v, and what the prediction does not know must not take more than ``_PHASE`` of its phase: the lags
  of the tyres, and a quarter of those that are predicted. So K falls with speed, to the same margin on every trailer.
- Feed-forward. Following the direction of the path takes away the alignment of a towed trailer, whose crossover is
  v/x_c with x_c = sum(x_i^2)/sum(x_i): a positive feedback. Where all lags together take more than half of ``_PHASE``
  at v/x_c, on short trailers and at speed, only that share of the angles is steered.

The kinematic estimate does not include the slip of a sliding tractor. With the driven axle at its friction limit (0.2,
uphill on a cross-fall of 5 %) the hitch slides downhill, that estimate is wrong by more than a metre before the trailer
is steered at all, and the rear is steered off its path. Path preview does the same with it; neither does with a
measured one.
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
_FARTHEST = 0.5  # of the follow distance: the prediction never travels beyond the measured path [-]
_MOST_BIAS = 0.15  # of the integral: slip on ice, with margin [rad]
_PHASE = 0.7  # crossover times lags, at most: 40 deg of the integrator's 90 deg are spent [rad]
_UNPREDICTED = 0.25  # assumed: share of the predicted lags that the prediction misses [-]
_DRIFT_TIMES = 2.0  # of the tyres' lag, in the low-pass of the drift: their answer to steering is not taken for drift
# Lags of tyres of the usual kind: they roll half a metre until the force is there, and the force needs to turn the
# trailer's mass, with a cornering stiffness of 4.6 times the load.
_RELAXATION = 0.5  # [m]
_YAW_LAG = 0.022  # over the speed: 1/(4.6 g) [s2/m]


class VirtualDriverMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    estimate: OffTracking | None  # newest usable one
    history: SteerHistory
    delay: float  # mean age of the estimate between its arrival and that of the next one [s]
    drift: float  # mean slip of the axles, low-passed [-]
    bias: float  # integral part [rad]
    demand: tuple[float, ...]  # last command [rad]
    actuation: Actuation | None = None  # None: the axles do what they are told


class VirtualDriver(SteeringLaw[VirtualDriverMemory]):
    """PID with preview on the off-tracking, as by a driver at the rear."""

    class Parameters(PartParameters):
        """Gains of the driver."""

        preview: float = quantity(1.5, "m", 0.2, 6.0, "distance at which the driver aims for the path", tune=(0.8, 4.0))
        gain: float = quantity(1.0, "-", 0.0, 5.0, "proportional part; 1: straight at that point")
        integral: float = quantity(0.06, "rad/m2", 0.0, 0.5, "turn per error and metre travelled", tune=(0.0, 0.15))
        derivative: float = quantity(1.0, "-", 0.0, 1.0, "share of the axles' drift that is steered against")

    def __init__(self, trailer: TrailerGeometry, *, parameters: Parameters | None = None) -> None:
        """A controller for the trailer.

        Raises:
            ValueError: if the trailer has no steered axle.
        """
        check_steered("virtual_driver", trailer)
        given = parameters or self.Parameters()
        self._trailer, self._axles = trailer, AxleGroup.of(trailer)
        self._gain, self._integral, self._derivative = given.gain / given.preview, given.integral, given.derivative
        self._x_c = self._axles.second_moment / self._axles.first_moment
        self._predictor = Predictor(trailer, self._axles)

    def init(self) -> VirtualDriverMemory:
        """Memory without any estimate, wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return VirtualDriverMemory(None, None, (), 0.0, 0.0, 0.0, straight)

    def actuated(self, memory: VirtualDriverMemory, actuation: Actuation) -> VirtualDriverMemory:
        """Memory with the state of the actuators."""
        return memory._replace(actuation=actuation)

    def step(
        self, memory: VirtualDriverMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[VirtualDriverMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        memory = memory._replace(tick=tick, history=recorded(memory.history, signals, _HISTORY))
        if off_tracking is not None and self._usable(off_tracking):
            memory = self._with_estimate(memory, tick, off_tracking)
        memory, wanted = self._wanted(memory, tick, elapsed)
        demand = reachable(self._trailer, np.array(memory.demand), wanted, elapsed)
        return memory._replace(demand=tuple(demand.tolist())), SteerCommand(angles=demand)

    def _usable(self, estimate: OffTracking) -> bool:
        """True if the estimate is good, or lost only because its path is still short: it shows the drift."""
        return estimate.health is not Health.LOST or self._target(estimate.path) is None

    def _with_estimate(self, memory: VirtualDriverMemory, tick: int, estimate: OffTracking) -> VirtualDriverMemory:
        """Memory with a usable estimate; a new one shows the drift since the one before."""
        before, drift = memory.estimate, memory.drift
        if before is None:
            return memory._replace(estimate=estimate)
        interval = (estimate.tick - before.tick) * TICK
        if interval <= 0.0:
            return memory
        if estimate.v_x >= MEASURABLE and interval <= _OLDEST * TICK:
            share = 1.0 - math.exp(-interval / (_DRIFT_TIMES * _tyre_lag(estimate.v_x)))
            drift += share * (slip_between(before, estimate, self._axles, memory.history) - drift)
        return memory._replace(estimate=estimate, delay=estimate.age(tick) + 0.5 * interval, drift=drift)

    def _wanted(self, memory: VirtualDriverMemory, tick: int, elapsed: float) -> tuple[VirtualDriverMemory, FloatArray]:
        """The angles wanted now [rad], not yet limited in rate."""
        last, estimate = np.array(memory.demand), memory.estimate
        if estimate is None or tick - estimate.tick > _OLDEST or estimate.v_x < _CREEP:
            return memory, last
        until = min(
            tick + round(self._trailer.actuator_lag / TICK) + _HALF_PERIOD,
            estimate.tick + round(_FARTHEST * self._trailer.follow_distance / estimate.v_x / TICK),
        )
        goal = last if memory.actuation is None else memory.actuation.goal
        ahead = self._predictor.ahead(estimate, memory.drift, memory.history, goal, until)
        target = self._target(ahead.frame.inverse().apply(estimate.path))
        share, drift = self._share(estimate.v_x, memory.delay), self._derivative * memory.drift
        if target is None:
            return memory, share * self._axles.slip_angles(drift)
        gain = self._scheduled(estimate.v_x, memory.delay)
        memory = self._integrated(memory, gain, target.offset * estimate.v_x * elapsed)
        follow_direction = target.direction + math.atan((gain * target.offset + memory.bias) / share)
        return memory, share * self._axles.steer_angles(ahead.hitch_direction, follow_direction, drift)

    def _scheduled(self, speed: float, delay: float) -> float:
        """Proportional gain [rad/m] at a speed [m/s] with estimates of this mean age [s]."""
        lags = _tyre_lag(speed) + _UNPREDICTED * (delay + self._trailer.actuator_lag)
        return min(self._gain, _PHASE / (lags * speed))

    def _share(self, speed: float, delay: float) -> float:
        """Share of the angles [-] that leaves a trailer enough of its alignment."""
        lags = _tyre_lag(speed) + delay + self._trailer.actuator_lag
        return min(1.0, 0.5 * _PHASE * self._x_c / (speed * lags))

    def _integrated(self, memory: VirtualDriverMemory, gain: float, area: float) -> VirtualDriverMemory:
        """Memory after ``area`` [m2] more of error times distance.

        The integral waits at full steer, and while no axle answers.
        """
        at_limit = min(map(abs, memory.demand)) > self._trailer.max_steer - 1e-6
        if self._gain == 0.0 or at_limit or no_axle_answers(memory.actuation):
            return memory
        bias = memory.bias + self._integral * (gain / self._gain) ** 2 * area
        return memory._replace(bias=max(-_MOST_BIAS, min(_MOST_BIAS, bias)))

    def _target(self, path: FloatArray) -> Target | None:
        return target_on(path, self._trailer.follow_distance)


def _tyre_lag(speed: float) -> float:
    """Lag [s] of the trailer behind its steer angles at a speed [m/s]."""
    return _RELAXATION / speed + _YAW_LAG * speed
