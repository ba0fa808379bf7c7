"""Model predictive trailer steering on the measured hitch path, with estimated friction.

At every step the observer carries trailer and hitch from the last estimate, 0.1 s old or more, to the present. A tyre
model follows the measured motion; its difference from the accelerometer gives friction and disturbance. The plan for
the next 1.2 s is improved, and its first rates are commanded. While the path does not reach back to the follow point,
the follow point is assumed to have started on it.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from controllers.trailer import Actuation, Combination, LowSpeedParameters, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import check_steered, check_towed
from controllers.trailer_steering.mpc.observer import FrictionMemory, Observer, ObserverMemory, reckoned, updated
from controllers.trailer_steering.mpc.planning import (
    BLOCKS,
    STEPS,
    Limits,
    MeasuredPath,
    Outlook,
    Planner,
    Sizes,
    hitch_course,
    path_now,
    reference,
    with_estimate,
)
from controllers.trailer_steering.mpc.trailer_model import STEP, TYRE_STEP, TrailerModel, rolled_on
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK, elapsed_since
from vehicle.combination.description import GRAVITY
from vehicle.combination.roll import roll_gradients
from vehicle.frames import FloatArray
from vehicle.option import quantity

_CREEP: Final = 0.5  # below this speed, and in reverse, the axles keep their angles [m/s]
_HOLD: Final = 2.0  # on signals alone after the last estimate: an error of 3 cm by their bias [s]
_FADE_RATE: Final = 0.05  # of straightening after that: a turn ends within seconds [rad/s]
_ROUNDING: Final = 1e-9  # of angles [rad]
_PULL_TIME: Final = 0.5  # averaging of the side pull: longer than yaw oscillations on the tyres [s]


class MpcMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    path: MeasuredPath | None  # of the newest usable estimate
    estimate_at: int  # its arrival [ticks]
    observer: ObserverMemory
    friction: FrictionMemory
    deflection: FloatArray  # (n_axles,) of the tyres [-]
    side_pull: float  # lateral acceleration of the hitch beyond that of its path [m/s2]
    slow_yaw_rate: float  # of the trailer, low-passed [rad/s]
    demand: FloatArray  # (n_actuators,) last command, or where the actuators are going instead [rad]
    max_rates: FloatArray  # (n_actuators,) of the plan [rad/s]
    rates: FloatArray  # (n_blocks, n_actuators) last plan [rad/s]


class Mpc(SteeringLaw[MpcMemory]):
    """Model predictive control of the axle angles; one object per thread."""

    class Parameters(LowSpeedParameters):
        """Sizes that the cost compares."""

        tolerance: float = quantity(
            0.004, "m", 0.001, 1.0, "off-tracking that costs as much as steering at the rate 'effort'"
        )
        effort: float = quantity(0.25, "rad/s", 0.01, 10.0, "steering rate that costs as much as 'tolerance'")
        tail_swing: float = quantity(0.3, "m", 0.01, 10.0, "soft limit of the rear end's distance from the path")
        cut_in: float = quantity(5.0, "m", 0.1, 20.0, "soft limit of the trailer middle's distance from the path")

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        check_steered("mpc", trailer)
        check_towed("mpc", combination)
        self._trailer, self._combination = trailer, combination
        self._given = given = parameters or self.Parameters()
        self.speeds = given.speeds
        unit = combination.vehicle.units[combination.unit]
        rolls = roll_gradients(combination.vehicle)
        self._roll_factor = 1.0 + GRAVITY * rolls[combination.unit]  # of the accelerometer reading, by roll of the body
        self._max_steer = trailer.max_steer / max(1.0, *map(abs, trailer.steer_ratios))
        self._model = TrailerModel.of(trailer, combination)
        self._observer = Observer(combination)
        limits = Limits(self._max_steer, given.tail_swing, given.cut_in)
        self._planner = Planner(self._model, trailer, -unit.rear_x, Sizes(given.tolerance, given.effort), limits)

    def __reduce__(self) -> "tuple[Callable[..., Mpc], tuple[object, ...]]":
        return _rebuilt, (self._trailer, self._combination, self._given)  # compiled functions cannot be pickled

    def init(self) -> MpcMemory:
        """Memory without any estimate, wheels straight, no tyre deflected."""
        m = self._model.n_actuators
        return MpcMemory(
            tick=None,
            path=None,
            estimate_at=0,
            observer=ObserverMemory(),
            friction=FrictionMemory(),
            deflection=np.zeros(len(self._model.axles)),
            side_pull=0.0,
            slow_yaw_rate=0.0,
            demand=np.zeros(m),
            max_rates=np.full(m, self._trailer.max_steer_rate),
            rates=np.zeros((len(BLOCKS), m)),
        )

    def actuated(self, memory: MpcMemory, actuation: Actuation) -> MpcMemory:
        """Memory with the demand that the actuators follow, which is not the law's while the fallback steers."""
        goal = self._trailer.actuator_angles(actuation.goal)
        if np.abs(goal - memory.demand).max() > _ROUNDING:
            memory = memory._replace(demand=goal)
        able = np.array([actuation.able[list(group)].all() for group in self._trailer.groups])
        # Where none answers, and where one is slow, the plan is that of sound ones: only a demand for more than the
        # fault allows can show that it is over.
        rates = np.where(able | ~able.any(), self._trailer.max_steer_rate, 0.0)
        return memory._replace(max_rates=rates)

    def step(
        self, memory: MpcMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[MpcMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
        memory = memory._replace(tick=tick, observer=self._observer.with_signals(memory.observer, signals))
        path = with_estimate(memory.path, off_tracking, self._trailer.follow_distance)
        if path is not None and path is not memory.path:
            corrected = self._observer.corrected(memory.observer, path.estimate, path.interval)
            memory = memory._replace(path=path, estimate_at=tick, observer=corrected)
        steer = self._trailer.actuator_angles(signals.angles)
        if elapsed == 0.0:
            memory = memory._replace(demand=steer)
        memory = self._with_tyres(memory, steer, signals.lateral_acceleration, elapsed)
        memory = self._steered(memory, steer, elapsed)
        return memory, SteerCommand(angles=self._trailer.axle_angles(memory.demand))

    def _with_tyres(self, memory: MpcMemory, steer: FloatArray, acceleration: float, elapsed: float) -> MpcMemory:
        """Memory with tyres, friction and side pull since the last step."""
        now, model, friction = memory.observer.now, self._model, memory.friction
        if now.speed < _CREEP or elapsed == 0.0:
            return memory
        force = acceleration / self._roll_factor
        deflection, surplus, by_friction = memory.deflection, 0.0, 0.0
        for _ in range(max(1, round(elapsed / TYRE_STEP))):
            tyres = rolled_on(
                model,
                deflection,
                steer,
                hitch_direction=now.hitch_direction,
                yaw_rate=now.yaw_rate,
                speed=now.speed,
                friction=friction.friction,
            )
            deflection, by_friction = tyres.deflection, tyres.by_friction
            surplus = tyres.moment - friction.disturbance - model.mass_moment * force / model.load_moment
        share = 1.0 - math.exp(-elapsed / _PULL_TIME)
        slow = memory.slow_yaw_rate + share * (now.yaw_rate - memory.slow_yaw_rate)
        # The accelerometer is above the axles; the low-passed yaw acceleration transforms it to the hitch.
        at_hitch = force + model.centre * (now.yaw_rate - slow) / _PULL_TIME
        pull = at_hitch - now.speed * now.lead_yaw_rate * math.cos(now.hitch_direction)
        uncertainty = model.stiffness * memory.observer.uncertainty
        return memory._replace(
            deflection=deflection,
            friction=updated(friction, surplus, by_friction, now.speed * elapsed, uncertainty),
            side_pull=memory.side_pull + share * (pull - memory.side_pull),
            slow_yaw_rate=slow,
        )

    def _steered(self, memory: MpcMemory, steer: FloatArray, elapsed: float) -> MpcMemory:
        """Memory with a new demand: the start of an improved plan or, without a path, towards straight wheels."""
        path, now = memory.path, memory.observer.now
        if path is not None and (now.tick - memory.estimate_at) * TICK <= _HOLD:
            if min(path.estimate.v_x, now.speed) < _CREEP:
                return memory._replace(rates=np.zeros_like(memory.rates))
            outlook = self._outlook(memory, path, steer)
            if outlook is not None:
                rates = self._planner.planned(outlook, memory.rates)
                return memory._replace(demand=self._advanced(outlook, rates[0], elapsed), rates=rates)
        fade = _FADE_RATE * elapsed
        straighter = memory.demand - np.clip(memory.demand, -fade, fade)
        return memory._replace(demand=straighter, rates=np.zeros_like(memory.rates))

    def _advanced(self, outlook: Outlook, rate: FloatArray, elapsed: float) -> FloatArray:
        """The demand [rad] at the start of a plan, within reach of the actuators."""
        reach = self._trailer.max_steer_rate * elapsed
        start = outlook.state[-len(rate) :]
        return np.clip(start + np.clip(rate * elapsed, -reach, reach), -self._max_steer, self._max_steer)

    def _outlook(self, memory: MpcMemory, path: MeasuredPath, steer: FloatArray) -> Outlook | None:
        """Inputs of the plan; None if the path is too short for a reference."""
        now = memory.observer.now
        since = reckoned(memory.observer.records, path.estimate.tick)
        behind = path_now(path, since, self._trailer.follow_distance)
        if behind is None:
            return None
        course = hitch_course(now.hitch_direction, now.lead_yaw_rate, now.speed, STEP, STEPS)
        wanted = reference(course.points, behind, self._trailer.follow_distance)
        if wanted is None:
            return None
        motion = [now.hitch_direction, now.yaw_rate]
        return Outlook(
            state=np.concatenate([motion, memory.deflection, steer, memory.demand]),  # in the order of ``State``
            max_rates=memory.max_rates,
            course=course,
            reference=wanted,
            side_pull=memory.side_pull,
            disturbance=memory.friction.disturbance,
            friction=memory.friction.friction,
        )


def _rebuilt(trailer: TrailerGeometry, combination: Combination, given: Mpc.Parameters) -> Mpc:
    return Mpc(trailer, combination=combination, parameters=given)
