"""Model predictive trailer steering on the measured hitch path, with what friction the tyres are felt to have.

At every step of the controller: the signals of the combination carry trailer and hitch from the last estimate, a tenth
of a second old or more, to now. The tyres are followed on their way, and what the accelerometer says they do, against
what they should, tells friction and disturbance. A plan over the next 1.2 s is improved, and its beginning commanded.
While the path does not reach back to the follow point yet, the trailer is taken to have begun on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import ClassVar, Final, NamedTuple

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.limits import check_steered
from controllers.trailer_steering.mpc.friction import FrictionMemory, updated
from controllers.trailer_steering.mpc.observer import Observer, ObserverMemory, reckoned
from controllers.trailer_steering.mpc.planning import BLOCKS, STEPS, Limits, Outlook, Planner, Sizes
from controllers.trailer_steering.mpc.reference import hitch_course, reference
from controllers.trailer_steering.mpc.stepping import STEP, TYRE_STEP, rolled_on
from controllers.trailer_steering.mpc.trailer_model import TrailerModel
from controllers.trailer_steering.mpc.way import Way, way_so_far, with_estimate
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY
from vehicle.frames import FloatArray
from vehicle.option import Option, check_options

_CREEP: Final = 0.5  # slower than this, or backwards, the law has no meaning and the axles stay where they are [m/s]
_HOLD: Final = 2.0  # how long signals alone carry the last estimate on: their bias makes 3 cm of it [s]
_FADE_RATE: Final = 0.05  # at which the axles go straight after that: a turn is let go of in seconds [rad/s]
_SLACK: Final = 0.1  # beyond the lag of an actuator, for what more it may be late [s]
_PULL_TIME: Final = 0.5  # over which side pull is averaged: longer than yaw swings on its tyres [s]


class MpcMemory(NamedTuple):
    """What the controller carries from one step to the next."""

    tick: int | None  # of the last step; None before the first
    way: Way | None  # the hitch's by the newest usable estimate
    seen_at: int  # when that arrived [ticks]
    observer: ObserverMemory
    friction: FrictionMemory
    deflection: FloatArray  # (n_axles,) of the tyres [-]
    side_pull: float  # lateral acceleration of the hitch that its course does not explain [m/s2]
    slow_yaw_rate: float  # of the trailer, low-passed [rad/s]
    demand: FloatArray  # (n_actuators,) last command [rad]
    rates: FloatArray  # (n_blocks, n_actuators) last plan [rad/s]


class Mpc(SteeringLaw[MpcMemory]):
    """The axle angles that a model of the slipping trailer says keep the follow point on the path; one per thread."""

    options: ClassVar[tuple[Option, ...]] = (
        Option("tolerance", 0.004, "off-tracking that costs as much as steering at the rate 'effort'", "m", 0.001, 1.0),
        Option("effort", 0.25, "steering rate that costs as much as 'tolerance'", "rad/s", 0.01, 10.0),
        Option("tail_swing", 0.3, "soft limit of the rear end's distance from the path", "m", 0.01, 10.0),
        Option("cut_in", 5.0, "soft limit of the trailer middle's distance from the path", "m", 0.1, 20.0),
    )

    def __init__(
        self,
        trailer: TrailerGeometry,
        *,
        combination: Combination,
        tolerance: float = 0.004,
        effort: float = 0.25,
        tail_swing: float = 0.3,
        cut_in: float = 5.0,
    ) -> None:
        """A controller for the trailer; ``options`` describes the parameters.

        Raises:
            ValueError: if the trailer has no steered axle, or a parameter is outside its limits.
        """
        check_steered("mpc", trailer)
        self._trailer, self._combination = trailer, combination
        self._given = {"tolerance": tolerance, "effort": effort, "tail_swing": tail_swing, "cut_in": cut_in}
        check_options(self.options, self._given)
        unit = combination.vehicle.units[combination.unit]
        self._leaning = 1.0 + GRAVITY * unit.roll_gradient  # of the accelerometer, with its body
        self._max_steer = trailer.max_steer / max(1.0, *map(abs, trailer.steer_ratios))
        self._model = TrailerModel.of(trailer, combination)
        self._observer = Observer(combination)
        limits = Limits(self._max_steer, trailer.max_steer_rate, tail_swing, cut_in)
        self._planner = Planner(self._model, trailer, -unit.rear_x, Sizes(tolerance, effort), limits)

    def __reduce__(self) -> tuple[Callable[..., Mpc], tuple[object, ...]]:
        return _rebuilt, (self._trailer, self._combination, self._given)  # compiled functions cannot be pickled

    def init(self) -> MpcMemory:
        """Nothing seen yet, wheels straight, no tyre deflected."""
        m = self._model.n_actuators
        return MpcMemory(
            tick=None,
            way=None,
            seen_at=0,
            observer=ObserverMemory(),
            friction=FrictionMemory(),
            deflection=np.zeros(len(self._model.axles)),
            side_pull=0.0,
            slow_yaw_rate=0.0,
            demand=np.zeros(m),
            rates=np.zeros((len(BLOCKS), m)),
        )

    def step(
        self, memory: MpcMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[MpcMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        memory = memory._replace(tick=tick, observer=self._observer.noticed(memory.observer, signals))
        way = with_estimate(memory.way, off_tracking, self._trailer.follow_distance)
        if way is not None and way is not memory.way:
            corrected = self._observer.corrected(memory.observer, way.seen, way.interval)
            memory = memory._replace(way=way, seen_at=tick, observer=corrected)
        steer = self._actuator_angles(signals.angles)
        memory = self._felt(memory, steer, signals.lateral_acceleration, elapsed)
        memory = self._steered(memory, steer, elapsed)
        return memory, SteerCommand(angles=self._axle_angles(memory.demand))

    def _felt(self, memory: MpcMemory, steer: FloatArray, acceleration: float, elapsed: float) -> MpcMemory:
        """Memory with what tyres and accelerometer did since the last step."""
        now, model, friction = memory.observer.now, self._model, memory.friction
        if now.speed < _CREEP or elapsed == 0.0:
            return memory
        force = acceleration / self._leaning
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
        # The accelerometer is above the axles; the trailer's yaw acceleration, low-passed, carries it to the hitch.
        at_hitch = force + model.centre * (now.yaw_rate - slow) / _PULL_TIME
        pull = at_hitch - now.speed * now.lead_yaw_rate * math.cos(now.hitch_direction)
        doubt = model.stiffness * memory.observer.doubt
        return memory._replace(
            deflection=deflection,
            friction=updated(friction, surplus, by_friction, now.speed * elapsed, doubt),
            side_pull=memory.side_pull + share * (pull - memory.side_pull),
            slow_yaw_rate=slow,
        )

    def _steered(self, memory: MpcMemory, steer: FloatArray, elapsed: float) -> MpcMemory:
        """Memory with a new demand: the beginning of a better plan or, with no path, a step to straight wheels."""
        way, now = memory.way, memory.observer.now
        if way is not None and (now.tick - memory.seen_at) * TICK <= _HOLD:
            if min(way.seen.v_x, now.speed) < _CREEP:
                return memory._replace(rates=np.zeros_like(memory.rates))
            outlook = self._outlook(memory, way, steer)
            if outlook is not None:
                rates = self._planner.planned(outlook, memory.rates)
                return memory._replace(demand=self._advanced(outlook, rates[0], elapsed), rates=rates)
        fade = _FADE_RATE * elapsed
        straighter = memory.demand - np.clip(memory.demand, -fade, fade)
        return memory._replace(demand=straighter, rates=np.zeros_like(memory.rates))

    def _advanced(self, outlook: Outlook, rate: FloatArray, elapsed: float) -> FloatArray:
        """The demand [rad] at the beginning of a plan, within what actuators can do from where it begins."""
        reach = self._trailer.max_steer_rate * elapsed
        begun = outlook.state[-len(rate) :]
        demand: FloatArray = np.clip(begun + np.clip(rate * elapsed, -reach, reach), -self._max_steer, self._max_steer)
        return demand

    def _outlook(self, memory: MpcMemory, way: Way, steer: FloatArray) -> Outlook | None:
        """What lies ahead; None if the path is too short to say where the follow point should go."""
        now = memory.observer.now
        behind = way_so_far(way, reckoned(memory.observer.records, way.seen.tick), self._trailer.follow_distance)
        if behind is None:
            return None
        course = hitch_course(now.hitch_direction, now.lead_yaw_rate, now.speed, STEP, STEPS)
        wanted = reference(course.points, behind, self._trailer.follow_distance)
        if wanted is None:
            return None
        motion = [now.hitch_direction, now.yaw_rate]
        # Someone else may have the axles: the plan starts where they are, but for what actuators lag behind.
        behind_by = self._trailer.max_steer_rate * (self._trailer.actuator_lag + _SLACK)
        demand = np.clip(memory.demand, steer - behind_by, steer + behind_by)
        return Outlook(
            state=np.concatenate([motion, memory.deflection, steer, demand]),  # in the order of ``State``
            course=course,
            reference=wanted,
            side_pull=memory.side_pull,
            disturbance=memory.friction.disturbance,
            friction=memory.friction.friction,
        )

    def _actuator_angles(self, angles: FloatArray) -> FloatArray:
        """Angles (n_actuators,) [rad] of actuators whose axles are at ``angles`` (n_steered,)."""
        own = angles / np.array(self._trailer.steer_ratios)
        return np.array([own[list(group)].mean() for group in self._trailer.groups])

    def _axle_angles(self, actuators: FloatArray) -> FloatArray:
        """Angles (n_steered,) [rad] of axles whose actuators are at these (n_actuators,)."""
        angles = np.array(self._trailer.steer_ratios)
        for actuator, group in zip(actuators, self._trailer.groups, strict=True):
            angles[list(group)] *= actuator
        return angles


def _rebuilt(trailer: TrailerGeometry, combination: Combination, given: Mapping[str, float]) -> Mpc:
    return Mpc(trailer, combination=combination, **given)
