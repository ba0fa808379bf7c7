"""High-speed steering by optimal state feedback, and a law for all speeds made of it and a low-speed law.

A Kalman filter estimates the state from the combination's own sensors. The path between hitch and follow point comes
from the off-tracking estimate, carried on to the present by dead reckoning.

In a quick lane change the trailer then cuts the corner: its lateral motion is smoother and does not overshoot. At low
speed, with large articulations, the linear law is not valid. It fades in over a band of speeds; below it a trailer is
well damped by itself, and the law leaves its axles straight.

The cost is that of Cheng and Cebon's high-speed mode as cited by others, ``integral of q_y e^2 + q_a a_y^2 + delta^2``:
off-tracking e of the follow point, lateral acceleration a_y of the trailer's centre of gravity, and one angle demanded
of all its steered axles; only the ratios of the weights matter. Derived here, since it is not published:

- e refers to the position of the hitch a time L_f/U ago. So the path between hitch and follow point is part of the
  state: its lateral positions y(x) in the trailer's frame obey ``dy/dt = U dy/dx - v_y - x r`` with y(0) = 0 and the
  hitch's lateral speed v_y and yaw rate r. Chebyshev collocation on a few points is exact for any smooth path;
- the driver's steer is a second-order process, so that the law responds to it before the trailer moves;
- the lateral speed, which no sensor measures, is estimated by the Kalman filter of the same model.

Longitudinal speed, load and friction are nominal; the ground is level.

`AllSpeeds` makes a law for all speeds of one for towns and yards and another for the open road, by default the LQR.
Over the range of the first the command changes from one to the other; the LQR itself fades in over a range of its own.
In between little steering is needed: a low-speed law would oscillate there, and the trailer itself is well damped.
"""

import math
import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple, Self

import numpy as np
from pydantic import model_validator

from controllers.driver import PERIOD
from controllers.trailer import (
    KMH,
    Actuation,
    Combination,
    LowSpeedParameters,
    SpeedRange,
    SteerCommand,
    SteeringLaw,
    TrailerGeometry,
    TrailerSteering,
)
from controllers.trailer_steering.kinematics import (
    ReckonedPath,
    check_steered,
    check_towed,
    corrected,
    extended,
    hitch_motion,
    reachable,
    straight_behind,
)
from controllers.trailer_steering.path_laws import PathPreview, VirtualDriver
from controllers.trailer_steering.signal_laws import CommandSteer, CtAt, Unsteered
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import elapsed_since
from vehicle.combination.linear import LateralModel, lateral_model
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray
from vehicle.option import PartParameters, option, quantity

SPEEDS: Final = tuple(KMH * kmh for kmh in range(20, 131, 10))  # of the designs; gains are linear in between [m/s]

_NODES = 8  # of the path: a wave of the trailer's length is represented to 1e-3
_STEER_FREQUENCY = 2.0 * math.pi * 0.5  # assumed: quick changes of lane, 0.4 Hz in ISO 14791 and up [rad/s]
_STEER_DAMPING = 0.5  # assumed: the bandwidth of that process equals its frequency
_STEER_SIZE = math.radians(1.0)  # assumed: rms of road-wheel steer at speed [rad]
_SWAY = 0.3  # assumed: lateral acceleration not in the model, per root Hz: gusts, cross-fall [m/s2]
_TWIST = 0.05  # assumed: the same for yaw accelerations [rad/s2]
_ACTUATOR = 0.1  # assumed: the same for the actuators' rates; their angles are measured [rad/s]
_GYRO, _HITCH, _ENCODER = (math.radians(d) for d in (0.15, 0.2, 0.1))  # noise of a sample, as of vehicle MEMS [rad(/s)]
_DEAD_TIME = 0.02  # least lag of the actuators: the control period [s]


class Weights(NamedTuple):
    """Weights of the cost against one square radian of demanded angle."""

    off_tracking: float  # q_y [rad2/m2]
    acceleration: float  # q_a [rad2 s4/m2]


class Gains(NamedTuple):
    """Law and filter at one speed.

    The motion is lateral speed, yaw rates, articulations, trailer steer, driver's steer and its rate.
    """

    feedback: FloatArray  # (n_motion + nodes,) angle per motion and path
    propagation: FloatArray  # (n_motion, n_motion) of the filter over a control period
    input: FloatArray  # (n_motion,) per demanded angle [1/rad]
    innovation: FloatArray  # (n_motion, n_read) per reading


class Plant(NamedTuple):
    """Motion without the path, in the filter's states: dx/dt = A x + B delta."""

    A: FloatArray
    B: FloatArray
    lateral_speed: FloatArray  # output row: of the hitch [m/s]
    yaw_rate: FloatArray  # output row: of the trailer [rad/s]
    lateral_acceleration: FloatArray  # output row: of the trailer's centre of gravity [m/s2]
    units: int


def path_nodes(follow_distance: float) -> FloatArray:
    """Positions of the path nodes behind the hitch, (nodes,) x in S from front to rear [m]."""
    points: FloatArray = np.cos(np.pi * np.arange(1, _NODES + 1) / _NODES)
    return 0.5 * follow_distance * (points - 1.0)


@lru_cache(maxsize=16)
def schedule(combination: Combination, trailer: TrailerGeometry, weights: Weights) -> tuple[Gains, ...]:
    """Gains at each of ``SPEEDS``."""
    return tuple(_gains(combination, trailer, weights, speed) for speed in SPEEDS)


def plant(combination: Combination, trailer: TrailerGeometry, speed: float) -> Plant:
    """The combination's motion with its steering at ``speed`` [m/s]."""
    vehicle, unit = combination.vehicle, combination.unit
    model = lateral_model(vehicle, speed, outputs=("lateral_velocity", "yaw_rate", "lateral_acceleration"))
    first = 1 + sum(len(towed.actuators) for towed in vehicle.units[1:unit])
    own = slice(first, first + len(vehicle.units[unit].actuators))
    n, lag = len(model.states), max(trailer.actuator_lag, _DEAD_TIME)
    A, B = np.zeros((n + 3, n + 3)), np.zeros(n + 3)
    A[:n, :n], A[:n, n], A[:n, n + 1] = model.A, model.B[:, own].sum(axis=1), model.B[:, 0]
    A[n, n], B[n] = -1.0 / lag, 1.0 / lag
    A[n + 1, n + 2] = 1.0
    A[n + 2, n + 1 :] = -(_STEER_FREQUENCY**2), -2.0 * _STEER_DAMPING * _STEER_FREQUENCY
    kinds = ("lateral_velocity", "yaw_rate", "lateral_acceleration")
    lateral_speed, yaw_rate, lateral_acceleration = (_row(model, f"{kind}_{unit}", own) for kind in kinds)
    return Plant(A, B, lateral_speed, yaw_rate, lateral_acceleration, len(vehicle.units))


def _row(model: LateralModel, output: str, own: slice) -> FloatArray:
    k = model.outputs.index(output)
    return np.concatenate([model.C[k], [model.D[k, own].sum(), model.D[k, 0], 0.0]])


def with_path(p: Plant, follow_distance: float, speed: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A and B with the path, and the output rows of off-tracking and lateral acceleration."""
    n = len(p.A)
    A, B = np.zeros((n + _NODES, n + _NODES)), np.concatenate([p.B, np.zeros(_NODES)])
    A[:n, :n] = p.A
    A[n:, :n] = -p.lateral_speed - np.outer(path_nodes(follow_distance), p.yaw_rate)
    A[n:, n:] = speed * 2.0 / follow_distance * _differentiation()[1:, 1:]
    off_tracking = np.zeros(n + _NODES)
    off_tracking[-1] = 1.0
    return A, B, off_tracking, np.concatenate([p.lateral_acceleration, np.zeros(_NODES)])


def _differentiation() -> FloatArray:
    """Differentiation matrix on the Chebyshev points 1 ... -1."""
    k = np.arange(_NODES + 1)
    x, c = np.cos(np.pi * k / _NODES), np.where((k == 0) | (k == _NODES), 2.0, 1.0) * (-1.0) ** k
    D: FloatArray = np.outer(c, 1.0 / c) / (x[:, None] - x[None, :] + np.eye(_NODES + 1))
    return D - np.diag(D.sum(axis=1))


def _feedback(p: Plant, follow_distance: float, weights: Weights, speed: float) -> FloatArray:
    import control  # the import takes seconds

    A, B, e, a_y = with_path(p, follow_distance, speed)
    cost = weights.off_tracking * np.outer(e, e) + weights.acceleration * np.outer(a_y, a_y)
    gain: FloatArray = control.lqr(A, B[:, None], cost, np.eye(1))[0][0]
    return gain


def _gains(combination: Combination, trailer: TrailerGeometry, weights: Weights, speed: float) -> Gains:
    import control

    p = plant(combination, trailer, speed)
    read = np.eye(len(p.A))[1:-1]  # all states but lateral speed and rate of the driver's steer
    process, noise = _disturbances(p.units), _noises(p.units) * PERIOD
    L: FloatArray = control.lqe(p.A, np.eye(len(p.A)), read, np.diag(process), np.diag(noise))[0]
    inputs = np.column_stack([p.B, L])  # demand and readings, constant over a period
    observer = control.c2d(control.ss(p.A - L @ read, inputs, np.eye(len(p.A)), np.zeros(inputs.shape)), PERIOD)
    feedback = _feedback(p, trailer.follow_distance, weights, speed)
    return Gains(feedback, observer.A, observer.B[:, 0], observer.B[:, 1:])


def loop_gain(combination: Combination, trailer: TrailerGeometry, weights: Weights, speed: float) -> Any:
    """Loop gain of the law at ``speed`` [m/s], opened at the demanded angle: a sampled system of python-control.

    The off-tracking estimate is exact, and no delay of the cameras is in it.
    """
    import control

    p, gains = plant(combination, trailer, speed), at_speed(schedule(combination, trailer, weights), speed)
    A, B, _, _ = with_path(p, trailer.follow_distance, speed)
    n = len(p.A)
    seen = np.delete(np.eye(len(A)), [0, n - 1], axis=0)  # readings, then the path
    motion = control.c2d(control.ss(A, B[:, None], seen, np.zeros((len(seen), 1))), PERIOD)
    by_motion, by_path = gains.feedback[None, :n], gains.feedback[None, n:]
    readings, path = np.eye(len(seen))[: n - 2], np.eye(len(seen))[n - 2 :]
    inner = gains.propagation - gains.input[:, None] @ by_motion
    inputs = gains.innovation @ readings - gains.input[:, None] @ by_path @ path
    return control.ss(inner, inputs, by_motion, by_path @ path, PERIOD) * motion


def _disturbances(units: int) -> FloatArray:
    """Intensities of the white noise that drives each state."""
    steer = 4.0 * _STEER_DAMPING * _STEER_FREQUENCY**3 * _STEER_SIZE**2  # gives the process that variance
    idle = 1e-6  # of angles whose rates are states; the filter needs a positive value
    return np.array([_SWAY**2, *[_TWIST**2] * units, *[idle] * (units - 1), _ACTUATOR**2, idle, steer])


def _noises(units: int) -> FloatArray:
    return np.array([*[_GYRO**2] * units, *[_HITCH**2] * (units - 1), _ENCODER**2, _ENCODER**2])


def at_speed(gains: tuple[Gains, ...], speed: float) -> Gains:
    """Gains interpolated between the design speeds, constant beyond them."""
    position = float(np.interp(speed, SPEEDS, np.arange(len(SPEEDS))))
    k = min(int(position), len(SPEEDS) - 2)
    share = position - k
    return Gains(*((1.0 - share) * low + share * high for low, high in zip(gains[k], gains[k + 1], strict=True)))


_MOST_PERIODS = 5  # that the filter catches up in a step; after a longer pause it restarts from the readings


class LqrMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    estimate_tick: int  # of the newest estimate in the path
    path: ReckonedPath
    motion: tuple[float, ...]  # state of the filter
    demand: float  # last angle of the actuators [rad]


class Lqr(SteeringLaw[LqrMemory]):
    """One angle for all steered axles of the trailer, by state feedback."""

    class Parameters(PartParameters):
        """Weights of the cost, and the band of speeds in which the law fades in."""

        # The more acceleration counts, the more the trailer cuts the corner: with 0.03 to 0.04 of the off-tracking it
        # errs more than without steering at 60 to 80 km/h, now by a fifth less, and its acceleration is 2/3.
        off_tracking_weight: float = quantity(0.08, "rad2/m2", 0.0, 10.0, "weight of the off-tracking")
        acceleration_weight: float = quantity(
            0.02, "rad2 s4/m2", 0.0, 10.0, "weight of the trailer's lateral acceleration"
        )
        from_speed_kmh: float = quantity(45.0, "km/h", 20.0, 120.0, "speed below which the axles are straight")
        full_speed_kmh: float = quantity(70.0, "km/h", 20.0, 130.0, "speed from which on the law has full authority")

        @model_validator(mode="after")
        def _rises(self) -> Self:
            low, high = self.from_speed_kmh, self.full_speed_kmh
            if not low < high:
                raise ValueError(f"full_speed_kmh = {high} km/h must exceed from_speed_kmh = {low}")
            return self

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        check_steered("lqr", trailer)
        check_towed("lqr", combination)
        if _steered_beside(combination):
            self.outside = "one steered trailer; with several, each knows nothing of the others, and they swing further"
        given = parameters or self.Parameters()
        self._trailer, self._combination = trailer, combination
        self._band = KMH * given.from_speed_kmh, KMH * given.full_speed_kmh
        self._ratios = np.array(trailer.steer_ratios)
        self._nodes = path_nodes(trailer.follow_distance)
        weights = Weights(given.off_tracking_weight, given.acceleration_weight)
        self._gains = schedule(combination, trailer, weights)

    def init(self) -> LqrMemory:
        """Straight road behind, wheels straight."""
        still = (0.0,) * len(self._gains[0].input)
        return LqrMemory(None, -1, straight_behind(self._trailer.follow_distance), still, 0.0)

    def authority(self, speed: float) -> float:
        """Share of the law at a speed [m/s], 0 to 1; 0 on a trailer that it is not for."""
        if self.outside is not None:
            return 0.0
        low, high = self._band
        return max(0.0, min(1.0, (speed - low) / (high - low)))

    def gave_way(self, fastest: float) -> list[str]:
        """A line if the trailer is not one that it is for, on a drive with this largest speed [m/s]."""
        left_alone = self.outside is not None and fastest > self._band[0]
        return [f"lqr is for {self.outside}: no law steered"] if left_alone else []

    def step(
        self, memory: LqrMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[LqrMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
        motion = self._filtered(memory, elapsed, signals)
        path = extended(memory.path, tick, hitch_motion(self._combination, signals, float(motion[0])), elapsed)
        newest = memory.estimate_tick
        if off_tracking is not None and off_tracking.health is not Health.LOST and off_tracking.tick > newest:
            path, newest = corrected(path, off_tracking), off_tracking.tick
        demand = self._demand(memory.demand, self._wanted(signals.speed, motion, path), elapsed)
        memory = LqrMemory(tick, newest, path, tuple(motion.tolist()), demand)
        return memory, SteerCommand(angles=self._ratios * demand)

    def _filtered(self, memory: LqrMemory, elapsed: float, signals: CombinationSignals) -> FloatArray:
        """Motion now: lateral speed, yaw rates, articulations, trailer steer, driver's steer and its rate."""
        own = float(np.mean(signals.angles / self._ratios))
        read = np.concatenate([signals.yaw_rates, signals.articulation, [own, signals.steer]])
        periods = round(elapsed / PERIOD)
        if memory.tick is None or periods > _MOST_PERIODS:
            return np.concatenate([[0.0], read, [0.0]])
        gains, motion = at_speed(self._gains, signals.speed), np.array(memory.motion)
        for _ in range(periods):
            motion = gains.propagation @ motion + gains.input * memory.demand + gains.innovation @ read
        return motion

    def _wanted(self, speed: float, motion: FloatArray, path: ReckonedPath) -> float:
        """Optimal angle [rad]."""
        share = self.authority(speed)
        if share == 0.0:
            return 0.0
        behind = path.in_trailer()
        offsets = np.interp(-self._nodes, -behind[:, 0], behind[:, 1])
        state = np.concatenate([motion, offsets])
        return -share * float(at_speed(self._gains, speed).feedback @ state)

    def _demand(self, last: float, wanted: float, elapsed: float) -> float:
        """The wanted angle within reach of the actuators [rad]."""
        reach, limit = self._trailer.max_steer_rate * elapsed, self._trailer.max_steer
        return max(-limit, min(limit, max(last - reach, min(last + reach, wanted))))


class AllSpeedsMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    low: Any  # memory of the law that is for low speed
    above: Any  # memory of the other law; None while it is not needed
    demand: tuple[float, ...]  # last command [rad]


class AllSpeeds(SteeringLaw[AllSpeedsMemory]):
    """A law that is for low speed, and another above its range.

    The other is the LQR; axles are straight where nothing is towed or several trailers are steered. Over the range the
    command changes from one to the other.
    """

    def __init__(
        self,
        law: TrailerSteering[Any],
        speeds: SpeedRange,
        trailer: TrailerGeometry,
        combination: Combination,
        above: TrailerSteering[Any] | None = None,
    ) -> None:
        """Extend a ``law`` that is for these ``speeds``; ``above`` is the other, by default with its own parameters."""
        self.law, self._range, self._trailer, self._combination = law, speeds, trailer, combination
        self._above: Any = above
        self.beyond_reach = getattr(law, "beyond_reach", False)

    def prepare(self, speed: float) -> None:
        """Design the law above now if a drive is meant to reach a speed [m/s] that needs it."""
        if self._range.share(speed) < 1.0:
            self._other()

    def _other(self) -> TrailerSteering[Any]:
        """The law above; designed at the first use, which takes a second."""
        if self._above is None:
            self._above = _for_the_road(self._trailer, self._combination)
        other: TrailerSteering[Any] = self._above
        return other

    def gave_way(self, fastest: float) -> list[str]:
        """Lines on a drive with this largest speed [m/s]: which law steered instead, and why."""
        if self._range.share(fastest) == 1.0:
            return []
        other = self._other()
        own = f"{_words(other.law if isinstance(other, AllSpeeds) else other)} steered"
        further = other.gave_way(fastest) if isinstance(other, AllSpeeds) else []
        outside = getattr(self.law, "outside", None)
        if outside is not None:
            return [f"{_words(self.law)} is for {outside}: {own}", *further]
        low, high = (speed / KMH for speed in self._range)
        return [
            f"{_words(self.law)} is for up to {low:.0f} km/h and fades out up to {high:.0f} km/h, the drive reached "
            f"{fastest / KMH:.0f} km/h: {own} there",
            *further,
        ]

    def init(self) -> AllSpeedsMemory:
        """Wheels straight."""
        return AllSpeedsMemory(None, self.law.init(), None, self._trailer.straight)

    def actuated(self, memory: AllSpeedsMemory, actuation: Actuation) -> AllSpeedsMemory:
        """Memory with the state of the actuators, for laws that ask for it."""
        if hasattr(self.law, "actuated"):
            memory = memory._replace(low=self.law.actuated(memory.low, actuation))
        if memory.above is not None and hasattr(self._above, "actuated"):
            memory = memory._replace(above=self._above.actuated(memory.above, actuation))
        return memory

    def step(
        self, memory: AllSpeedsMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[AllSpeedsMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        share = self._range.share(signals.speed)  # of the law for low speed
        if share == 1.0:
            low, command = self.law.step(memory.low, tick, off_tracking, signals)
            return AllSpeedsMemory(tick, low, None, tuple(command.angles.tolist())), command
        other = self._other()
        above = other.init() if memory.above is None else memory.above
        above, command = other.step(above, tick, off_tracking, signals)
        wanted, low = (1.0 - share) * command.angles, self.law.init()  # it must not adapt while another law steers
        if share > 0.0:
            low, command = self.law.step(memory.low, tick, off_tracking, signals)
            wanted = wanted + share * command.angles
        span = math.inf if self.beyond_reach else elapsed_since(memory.tick, tick)
        demand = reachable(self._trailer, np.array(memory.demand), wanted, span)
        return AllSpeedsMemory(tick, low, above, tuple(demand.tolist())), SteerCommand(angles=demand)

    def close(self) -> None:
        """Close the law for low speed."""
        close_part(self.law)


def law_warnings(law: object, fastest: float) -> list[str]:
    """Lines on a drive with this largest speed [m/s]: where its law gave way to another, or is for other vehicles."""
    return law.gave_way(fastest) if isinstance(law, AllSpeeds | Lqr) else []


def _for_the_road(
    trailer: TrailerGeometry, combination: Combination, parameters: Lqr.Parameters | None = None
) -> TrailerSteering[Any]:
    """The LQR where it is for the trailer, or straight axles."""
    alone = combination.unit > 0 and not _steered_beside(combination)
    return Lqr(trailer, combination=combination, parameters=parameters) if alone else Unsteered(trailer)


def _steered_beside(combination: Combination) -> bool:
    """True if other trailers of the combination are steered as well."""
    towed = enumerate(combination.vehicle.units[1:], start=1)
    return any(unit.steered_axles for k, unit in towed if k != combination.unit)


def _words(law: object) -> str:
    """Name of a law for the reader."""
    return "no law" if isinstance(law, Unsteered) else re.sub(r"(?<!^)(?=[A-Z])", "_", type(law).__name__).lower()


LowSpeed = Literal["command_steer", "ct_at", "path_preview", "virtual_driver"]
_LOW_SPEED: Final[dict[LowSpeed, Callable[[TrailerGeometry, Combination], SteeringLaw[Any]]]] = {
    "command_steer": lambda trailer, combination: CommandSteer(trailer, combination=combination),
    "ct_at": lambda trailer, combination: CtAt(trailer, combination=combination),
    "path_preview": lambda trailer, combination: PathPreview(trailer),
    "virtual_driver": lambda trailer, combination: VirtualDriver(trailer),
}


class Combined(AllSpeeds):
    """A low-speed law by its name and the LQR, each with its range of speeds."""

    class Parameters(LowSpeedParameters, Lqr.Parameters):
        """Name of the law at low speed, and the parameters of the LQR."""

        low_speed: LowSpeed = option("name of the law at low speed", "path_preview")

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        given = parameters or self.Parameters()
        low = _LOW_SPEED[given.low_speed](trailer, combination)
        super().__init__(low, given.speeds, trailer, combination, _for_the_road(trailer, combination, given))
