"""Laws on the measured path of the hitch, without data of the tractor: path preview, and a virtual driver at the rear.

The estimate contains the path of the hitch from the follow point to the hitch, in the trailer's frame. Both laws carry
it on from its capture, 0.1 to 0.2 s ago, to the time when the axles will have answered (`kinematics.Predictor`). The
path's offset and direction at the follow point then give the required direction of the follow point, and its newest end
gives the direction of the hitch. The trailer's kinematics determine the angle of every axle; the slip of the axles is
estimated and compensated, and an integral over the distance removes the rest.

Path preview. The inertial part of the slip is known by feedforward. Until the buffer reaches back to the follow point
there is no path to follow, but the slip is already measured: the axles compensate it, so that the trailer starts on its
path.

Virtual driver. Cheng, Roebuck, Odhams and Cebon's scheme as de Saxe & Cebon 2018 describe it: a virtual driver at the
follow point steers it onto the path of the hitch by preview and by proportional, integral and derivative action on the
off-tracking. With the no-slip estimate (off_tracking = kinematic) it is Cheng's controller; with a measured
off-tracking it is Miao's reformulation, which tolerates slip. Gains are not published. Derived here:

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

Each is for a range of speeds (`controllers.trailer.SpeedRange`): a loop with a delay of 0.3 s and full gains is well
damped at 30 km/h and oscillates at 40 km/h. The virtual driver takes over from path preview.
"""

import math
from typing import NamedTuple

import numpy as np

from controllers.trailer import (
    Actuation,
    LowSpeedParameters,
    SpeedRange,
    SteerCommand,
    SteeringLaw,
    TrailerGeometry,
    no_axle_answers,
)
from controllers.trailer_steering.kinematics import (
    MEASURABLE,
    Ahead,
    Answers,
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
from vehicle.clock import TICK, elapsed_since
from vehicle.frames import FloatArray, arc_length
from vehicle.option import quantity

_HALF_PERIOD = 10  # a demand acts for 20 ms; it is computed for the middle of them [ticks]
_CREEP = 0.2  # below this speed, and in reverse, the axles keep their angles [m/s]
_HISTORY = 3000  # of the steer encoders: age of an estimate and a gap, with margin for slow cameras [ticks]
_OLDEST = 2000  # age at which an estimate is useless and the axles keep their angles [ticks]


class PathLawMemory(NamedTuple):
    """State of a law between two steps."""

    tick: int | None  # of the last step; None before the first
    demand: tuple[float, ...]  # last command [rad]
    estimate: OffTracking | None = None  # newest usable one
    along: FloatArray | None = None  # arc length of its path (n,) [m]
    delay: float = 0.0  # mean age of the estimate between its arrival and that of the next one [s]
    history: SteerHistory = ()
    slip: float = 0.0  # mean slip of the axles at that estimate [-]
    other_slip: float = 0.0  # the part of it that the path's curvature does not explain, low-passed [-]
    bias: float = 0.0  # integral part of the follow point's turn [rad]
    actuation: Actuation | None = None  # None: the axles follow their demands
    answers: Answers = Answers()  # of the actuators to their demands


class PathLaw(SteeringLaw[PathLawMemory]):
    """Common part of both laws: the prediction of an estimate to the time when the axles have answered."""

    speeds: SpeedRange

    def __init__(self, name: str, trailer: TrailerGeometry, speeds: SpeedRange) -> None:
        """For a trailer with steered axles, by the name of the law.

        Raises:
            ValueError: if the trailer has no steered axle.
        """
        check_steered(name, trailer)
        self._trailer, self._axles, self.speeds = trailer, AxleGroup.of(trailer), speeds
        self._predictor = Predictor(trailer, self._axles)

    def init(self) -> PathLawMemory:
        """Memory without any estimate, wheels straight."""
        return PathLawMemory(tick=None, demand=self._trailer.straight)

    def actuated(self, memory: PathLawMemory, actuation: Actuation) -> PathLawMemory:
        """Memory with the state of the actuators."""
        return memory._replace(actuation=actuation)

    def step(
        self, memory: PathLawMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[PathLawMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
        history = recorded(memory.history, signals, _HISTORY)
        answers = memory.answers.with_reading(self._trailer, history, memory.actuation)
        memory = memory._replace(tick=tick, history=history, answers=answers)
        before = memory.estimate
        is_new = off_tracking is not None and (before is None or off_tracking.tick > before.tick)
        if off_tracking is not None and is_new and self._is_usable(off_tracking):
            memory = self._with_slip(memory, tick, off_tracking)
            memory = memory._replace(estimate=off_tracking, along=arc_length(off_tracking.path))
        wanted = last = np.array(memory.demand)
        estimate, along = memory.estimate, memory.along
        if estimate and along is not None and tick - estimate.tick <= _OLDEST and estimate.v_x >= _CREEP:
            goal = last if memory.actuation is None else memory.actuation.goal
            lag = answers.lag(self._trailer)
            until = self._predicted_until(tick, estimate, lag)
            ahead = self._predictor.ahead(estimate, memory.slip, memory.history, goal, until, lag)
            path = ahead.frame.inverse().apply(estimate.path)
            target = None if estimate.health is Health.LOST else self._target(path, along)
            memory, wanted = self._wanted(memory, estimate, ahead, target, elapsed)
        demand = reachable(self._trailer, last, wanted, elapsed)
        return memory._replace(demand=tuple(demand.tolist())), SteerCommand(angles=demand)

    def _is_usable(self, estimate: OffTracking) -> bool:
        """True if the estimate is good, or lost only because its path is still short: it shows the slip."""
        return estimate.health is not Health.LOST or self._target(estimate.path) is None

    def _target(self, path: FloatArray, along: FloatArray | None = None) -> Target | None:
        return target_on(path, arc_length(path) if along is None else along, self._trailer.follow_distance)

    def _predicted_until(self, tick: int, estimate: OffTracking, lag: float) -> int:
        """Tick at which the axles have answered to a demand, with a ``lag`` of the actuators [s]."""
        return tick + round(lag / TICK) + _HALF_PERIOD

    def _integral_waits(self, memory: PathLawMemory) -> bool:
        """True at full steer, and while no axle answers."""
        at_limit = min(map(abs, memory.demand)) > self._trailer.max_steer - 1e-6
        return at_limit or no_axle_answers(memory.actuation)

    def _with_slip(self, memory: PathLawMemory, tick: int, estimate: OffTracking) -> PathLawMemory:
        """Memory with the slip that a new estimate shows since the one before."""
        raise NotImplementedError

    def _wanted(
        self, memory: PathLawMemory, estimate: OffTracking, ahead: Ahead, target: Target | None, elapsed: float
    ) -> tuple[PathLawMemory, FloatArray]:
        """Memory and wanted angles [rad], not yet limited in rate; ``target`` is None if the path is too short."""
        raise NotImplementedError


_CROSSOVER = 3.5  # upper limit: age of the estimate, steering and tyres leave no phase above [rad/s]
_SLIP_TIME = 0.2  # two estimates; slip measured from a single one is too noisy at speed [s]
# Least time of the slip's low-pass over the speed: four times the lag with which tyres turn a trailer, 1/(4.6 g).
# A quicker one takes that lag of the own steering for slip, and steers against it: trailers of 8 m weave at 22 km/h.
_SLIP_YAW = 4.0 * 0.022  # [s2/m]
_MOST_SLIP_BIAS = 0.1  # of the integral; the remaining slip is never larger [rad]
# Distance of the axles behind the hitch below which the loop slows down with its square [m]. The axles of a short
# trailer push its hitch, and the towing vehicle rocks on its tyres at 1 to 2 Hz; after the delay of 0.3 s the measured
# direction of the hitch feeds that. Centre-axle trailers with full gains weave at 3 m and are damped from 5 m on.
_LONG = 6.0
_UNDAMPED = 2.0  # the slip is filtered over that many times the distance where no axle is fixed, which would damp
# Slip beyond what the path's curvature explains from which the loop slows down. Tyres near their limit of friction
# turn the trailer more slowly: leaving a bend on friction 0.3 with 5 % cross-fall, full gains swing by 0.05 m at 1 Hz.
_GRIPPING = 0.03  # [-]


class PathPreview(PathLaw):
    """Axle angles that bring the follow point onto the path of the hitch and keep it there."""

    class Parameters(LowSpeedParameters):
        """Parameters; the defaults come from `offtrack tune`, whose study is in scenarios/data/tuning/path_preview.

        The range of speeds is measured, in lane changes of 0.4 Hz with actuators slower than the data sheet says: above
        it the virtual driver, whose gain falls with speed, is the calmer one.
        """

        full_up_to_kmh: float = quantity(20.0, "km/h", 1.0, 129.0, "speed up to which the law steers alone")
        none_from_kmh: float = quantity(28.0, "km/h", 2.0, 130.0, "speed from which on virtual_driver steers")
        gain: float = quantity(0.77, "rad/m", 0.0, 2.0, "turn of the follow point per offset", tune=(0.15, 1.5))
        integral: float = quantity(0.06, "rad/m2", 0.0, 0.5, "turn per offset and metre travelled", tune=(0.0, 0.12))
        # 1/(4.6 g): cornering stiffness of a truck tyre over its load
        compliance: float = quantity(
            0.022, "rad s2/m", 0.0, 0.1, "axle slip per lateral acceleration", tune=(0.005, 0.06)
        )
        slip_distance: float = quantity(0.6, "m", 0.1, 100.0, "low-pass of the remaining slip", tune=(0.4, 6.0))

    def __init__(self, trailer: TrailerGeometry, *, parameters: Parameters | None = None) -> None:
        given = parameters or self.Parameters()
        super().__init__("path_preview", trailer, given.speeds)
        self.above = VirtualDriver(trailer)
        pace = min(1.0, self._axles.centre / _LONG) ** 2
        self._gain, self._crossover, self._integral = given.gain, pace * _CROSSOVER, pace * given.integral
        calm = 1.0 if len(self._axles.fixed) else _UNDAMPED
        self._compliance, self._slip_distance = pace * given.compliance, calm * given.slip_distance / pace

    def _with_slip(self, memory: PathLawMemory, tick: int, estimate: OffTracking) -> PathLawMemory:
        """Memory with the slip of the axles since the estimate before."""
        before, other = memory.estimate, memory.other_slip
        inertial = self._inertial_slip(estimate, self._target(estimate.path))
        if before is not None:
            measured = slip_between(before, estimate, self._axles, memory.history)
            other += self._new_slip_share(before, estimate) * (measured - inertial - other)
        return memory._replace(slip=inertial + other, other_slip=other)

    def _new_slip_share(self, before: OffTracking, estimate: OffTracking) -> float:
        """Weight of a new slip measurement against the old ones, by the distance since the last estimate."""
        interval = (estimate.tick - before.tick) * TICK
        if estimate.v_x < MEASURABLE or interval > _OLDEST * TICK:
            return 0.0
        time = max(self._slip_distance / estimate.v_x, _SLIP_TIME, _SLIP_YAW * estimate.v_x)
        return 1.0 - math.exp(-interval / time)

    def _wanted(
        self, memory: PathLawMemory, estimate: OffTracking, ahead: Ahead, target: Target | None, elapsed: float
    ) -> tuple[PathLawMemory, FloatArray]:
        """Memory and wanted angles [rad], not yet limited in rate."""
        if target is None:
            return memory, self._axles.slip_angles(memory.slip)
        slip = memory.other_slip + self._inertial_slip(estimate, target)
        bias = memory.bias
        if not self._integral_waits(memory):
            share = self.speeds.share(estimate.v_x)  # the integral of a loop with less gain is slower
            bias += self._integral * (share * target.offset * estimate.v_x * elapsed)
            bias = max(-_MOST_SLIP_BIAS, min(_MOST_SLIP_BIAS, bias))
        gain = min(self._gain, self._crossover / estimate.v_x) / max(1.0, abs(memory.other_slip) / _GRIPPING)
        follow_direction = target.direction + math.atan(gain * target.offset + bias)
        angles = self._axles.steer_angles(ahead.hitch_direction, follow_direction, slip)
        return memory._replace(bias=bias), angles

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


_FARTHEST = 0.5  # of the follow distance: the prediction never travels beyond the measured path [-]
_MOST_BIAS = 0.15  # of the integral: slip on ice, with margin [rad]
_PHASE = 0.7  # crossover times lags, at most: 40 deg of the integrator's 90 deg are spent [rad]
_UNPREDICTED = 0.25  # assumed: share of the predicted lags that the prediction misses [-]
_DRIFT_TIMES = 2.0  # of the tyres' lag, in the low-pass of the drift: their answer to steering is not taken for drift
# Lags of tyres of the usual kind: they roll half a metre until the force is there, and the force needs to turn the
# trailer's mass, with a cornering stiffness of 4.6 times the load.
_RELAXATION = 0.5  # [m]
_YAW_LAG = 0.022  # over the speed: 1/(4.6 g) [s2/m]


class VirtualDriver(PathLaw):
    """PID with preview on the off-tracking, as by a driver at the rear."""

    class Parameters(LowSpeedParameters):
        """Gains of the driver; the gain falls with speed, which leaves it a wider range of speeds than other laws."""

        full_up_to_kmh: float = quantity(30.0, "km/h", 1.0, 129.0, "speed up to which the law steers alone")
        none_from_kmh: float = quantity(50.0, "km/h", 2.0, 130.0, "speed from which on lqr steers, or none")
        preview: float = quantity(1.5, "m", 0.2, 6.0, "distance at which the driver aims for the path", tune=(0.8, 4.0))
        gain: float = quantity(1.0, "-", 0.0, 5.0, "proportional part; 1: straight at that point")
        integral: float = quantity(0.06, "rad/m2", 0.0, 0.5, "turn per error and metre travelled", tune=(0.0, 0.15))
        derivative: float = quantity(1.0, "-", 0.0, 1.0, "share of the axles' drift that is steered against")

    def __init__(self, trailer: TrailerGeometry, *, parameters: Parameters | None = None) -> None:
        given = parameters or self.Parameters()
        super().__init__("virtual_driver", trailer, given.speeds)
        self._gain, self._integral, self._derivative = given.gain / given.preview, given.integral, given.derivative
        self._x_c = self._axles.second_moment / self._axles.first_moment

    def _predicted_until(self, tick: int, estimate: OffTracking, lag: float) -> int:
        """Tick at which the axles have answered, or the trailer has come to the end of the measured path."""
        farthest = round(_FARTHEST * self._trailer.follow_distance / estimate.v_x / TICK)
        return min(super()._predicted_until(tick, estimate, lag), estimate.tick + farthest)

    def _with_slip(self, memory: PathLawMemory, tick: int, estimate: OffTracking) -> PathLawMemory:
        """Memory with the drift since the estimate before."""
        before, drift = memory.estimate, memory.slip
        if before is None:
            return memory
        interval = (estimate.tick - before.tick) * TICK
        if estimate.v_x >= MEASURABLE and interval <= _OLDEST * TICK:
            share = 1.0 - math.exp(-interval / (_DRIFT_TIMES * _tyre_lag(estimate.v_x)))
            drift += share * (slip_between(before, estimate, self._axles, memory.history) - drift)
        return memory._replace(delay=estimate.age(tick) + 0.5 * interval, slip=drift)

    def _wanted(
        self, memory: PathLawMemory, estimate: OffTracking, ahead: Ahead, target: Target | None, elapsed: float
    ) -> tuple[PathLawMemory, FloatArray]:
        """Memory and wanted angles [rad], not yet limited in rate."""
        lag = memory.answers.lag(self._trailer)
        share, drift = self._angle_share(estimate.v_x, memory.delay, lag), self._derivative * memory.slip
        if target is None:
            return memory, share * self._axles.slip_angles(drift)
        gain, bias = self._scheduled(estimate.v_x, memory.delay, lag), memory.bias
        if self._gain > 0.0 and not self._integral_waits(memory):
            bias += self._integral * (gain / self._gain) ** 2 * (target.offset * estimate.v_x * elapsed)
            bias = max(-_MOST_BIAS, min(_MOST_BIAS, bias))
        follow_direction = target.direction + math.atan((gain * target.offset + bias) / share)
        angles = self._axles.steer_angles(ahead.hitch_direction, follow_direction, drift)
        return memory._replace(bias=bias), share * angles

    def _scheduled(self, speed: float, delay: float, lag: float) -> float:
        """Proportional gain [rad/m] at a speed [m/s] with estimates of this mean age [s]."""
        lags = _tyre_lag(speed) + _UNPREDICTED * (delay + lag)
        return min(self._gain, _PHASE / (lags * speed))

    def _angle_share(self, speed: float, delay: float, lag: float) -> float:
        """Share of the angles [-] that leaves a trailer enough of its alignment."""
        lags = _tyre_lag(speed) + delay + lag
        return min(1.0, 0.5 * _PHASE * self._x_c / (speed * lags))


def _tyre_lag(speed: float) -> float:
    """Lag [s] of the trailer behind its steer angles at a speed [m/s]."""
    return _RELAXATION / speed + _YAW_LAG * speed
