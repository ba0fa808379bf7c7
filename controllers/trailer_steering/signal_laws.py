"""Laws on the combination's own signals, without an estimate, and the fallback when an estimate is lost.

Command steer turns the axles with the articulation, as mechanical and hydraulic systems do by a linkage from the
turntable. To emulate a rigid axle L' behind the hitch,
an axle at the distance x is turned by

    tan delta(x) = -(x - L')/L' tan gamma_h

with the direction of the hitch's travel gamma_h against the trailer's axis: the lateral velocity of a rigid trailer is
linear along its axis and zero at L'. With L' half the follow distance L_f, follow point and hitch run on the same
circle in a steady turn. At the entry gamma_h leads and the rear swings out, because the law does not know the path.

Published systems use the articulation angle for gamma_h. Here the part that the hitch adds, in front of or behind the
tractor's rear axle, comes from tractor speed and gyro; without it L' = L_f/2 would leave some off-tracking.

CT-AT (conventional tractor, active trailer) turns the follow point into the heading that the hitch had at the same
place. Source: Jujnovich & Cebon, "Path-following steering control for articulated vehicles", J. Dyn. Syst. Meas.
Control 135(3), 2013, as de Saxe & Cebon 2018 describe it. A non-linear law compares the headings at front and rear of
the trailer, from speed, articulation angle and gyros; a reference trailer handles saturated steering. Its equations and
gains were not available. Derived here:

- the hitch's heading is stored along its dead-reckoned path, and the one required at the rear is that of the place
  which the follow point passes (exact for any articulation; equal arc lengths of hitch and follow point would drift
  apart);
- with it as the follow point's direction of travel, the axles roll without slip (``kinematics``);
- the reference trailer has no limits and its follow point is always on the path: its axis is the chord from the path to
  the hitch. The heading difference to it, times ``heading_gain``, is added.

Tyre slip is not modelled. On a slippery or cambered road the heading error grows until it balances the slip, and a
steady off-tracking of about follow distance times slip over gain remains: the known weakness of the scheme.

Dead reckoning keeps the rear on the path of the hitch, where command steer lets it swing out at the entry of a turn and
cut in at its exit. It needs sensors that agree with each other: those at fault are corrected before
(``estimators.off_tracking.signal_monitor``). After a gap in the signals command steer takes over until the path is as
long as the trailer again: it errs, but its error does not grow.

Wheel speed, angles and gyros give the motion of the hitch, with slip by the data sheet of the combination. While there
are estimates, they replace the path that is reckoned, and show what the data sheet does not know: slip on a cross-fall,
the bias of articulation and gyro, and the scale of the wheel speed. Without them the path goes on by dead reckoning.
Only the last follow distance of it counts, so that errors do not grow for ever.
"""

import math
from dataclasses import replace
from typing import ClassVar, Final, Literal, NamedTuple

import numpy as np

from controllers.trailer import Combination, LowSpeedParameters, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import (
    AxleGroup,
    ReckonedPath,
    TractorMotion,
    check_steered,
    corrected,
    extended,
    hitch_motion,
    limited_direction,
    motion_between,
    reachable,
    straight_behind,
    target_on,
)
from controllers.trailer_steering.path_laws import PathLawMemory, VirtualDriver
from estimators.estimates import Health, OffTracking
from estimators.hitch_motion import HitchMotion
from estimators.off_tracking.hitch_path import crossing, tangent
from sensors.messages import CombinationSignals
from vehicle.clock import TICK, elapsed_since
from vehicle.frames import FloatArray, arc_length
from vehicle.option import quantity

_CREEP = 0.2  # below this speed the direction of travel is sensor noise, and the axles keep their angles [m/s]
_SHORTEST, _LONGEST = 0.1, 2.0  # of the follow distance; a shorter one needs more steer than any axle has


class SlipFreeParameters(LowSpeedParameters):
    """Speeds of laws that know no tyre slip.

    Measured: in a bend of 60 m at 32 km/h the axles' slip takes an unsteered trailer back onto the path, and these laws
    beyond it (0.29 m RMS for 0.14 m).
    """

    full_up_to_kmh: float = quantity(20.0, "km/h", 1.0, 129.0, "speed up to which the law steers alone")
    none_from_kmh: float = quantity(30.0, "km/h", 2.0, 130.0, "speed from which on lqr steers, or none")


class CommandSteerMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    demand: tuple[float, ...]  # last command [rad]


class CommandSteer(SteeringLaw[CommandSteerMemory]):
    """Steer angles as a function of the articulation; the off-tracking is not used."""

    uses_off_tracking: ClassVar[bool] = False

    class Parameters(SlipFreeParameters):
        """Geometry of the emulated trailer."""

        rigid_length: float | None = quantity(
            None, "m", 0.1, 40.0, "hitch to the emulated rigid axle", default_text="half the follow distance"
        )

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        """A controller for the trailer of a ``combination``.

        Raises:
            ValueError: if the trailer has no steered axle, or the length is outside 0.1 to 2 follow distances.
        """
        check_steered("command_steer", trailer)
        parameters = parameters or self.Parameters()
        given, self.speeds = parameters.rigid_length, parameters.speeds
        length = 0.5 * trailer.follow_distance if given is None else given
        low, high = _SHORTEST * trailer.follow_distance, _LONGEST * trailer.follow_distance
        replace(self.Parameters.option("rigid_length"), low=low, high=high).check(length, "rigid_length")
        self._trailer, self._combination = trailer, combination
        self._axles = AxleGroup.of(trailer)
        self._beyond = trailer.follow_distance / length - 1.0  # distance of the follow point behind L', over L'

    def init(self) -> CommandSteerMemory:
        """Wheels straight."""
        return CommandSteerMemory(None, self._trailer.straight)

    def step(
        self, memory: CommandSteerMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CommandSteerMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
        wanted = last = np.array(memory.demand)
        if abs(signals.speed) >= _CREEP:
            lead = limited_direction(hitch_motion(self._combination, signals).direction)
            wanted = self._axles.steer_angles(lead, -math.atan(self._beyond * math.tan(lead)), 0.0)
        demand = reachable(self._trailer, last, wanted, elapsed)
        return CommandSteerMemory(tick, tuple(demand.tolist())), SteerCommand(angles=demand)


class Unsteered(SteeringLaw[None]):
    """Zero demand on every steered axle."""

    uses_off_tracking: ClassVar[bool] = False

    def __init__(self, trailer: TrailerGeometry) -> None:
        self._axles = len(trailer.steered_distances)

    def init(self) -> None:
        """No memory."""
        return

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        """Straight wheels."""
        return None, SteerCommand(angles=np.zeros(self._axles))


_REACH = 0.5  # half window of the heading's fit to the path [m]


class CtAtMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    path: ReckonedPath
    demand: tuple[float, ...]  # last command [rad]


class CtAt(SteeringLaw[CtAtMemory]):
    """Steer angles that match the trailer's heading to the path of its hitch; the off-tracking is not used."""

    class Parameters(SlipFreeParameters):
        """Gain against the reference trailer, and preview against the actuators' lag."""

        heading_gain: float = quantity(1.5, "-", 0.0, 5.0, "turn of the follow point per heading error")
        preview: float | None = quantity(
            None, "s", 0.0, 1.0, "preview time of the required heading", default_text="the actuators' lag"
        )

    def __init__(
        self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters | None = None
    ) -> None:
        """A controller for the trailer of a ``combination``.

        Raises:
            ValueError: if the trailer has no steered axle, or its actuators are too slow for the preview.
        """
        check_steered("ct_at", trailer)
        given = parameters or self.Parameters()
        self._gain, self.speeds = given.heading_gain, given.speeds
        self._preview = trailer.actuator_lag if given.preview is None else given.preview
        self.Parameters.option("preview").check(self._preview, "preview")
        self._trailer, self._combination = trailer, combination
        self._axles = AxleGroup.of(trailer)

    def init(self) -> CtAtMemory:
        """Straight road behind, wheels straight."""
        return CtAtMemory(None, straight_behind(self._trailer.follow_distance), self._trailer.straight)

    def step(
        self, memory: CtAtMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[CtAtMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = elapsed_since(memory.tick, tick)
        motion = hitch_motion(self._combination, signals)
        path = extended(memory.path, tick, motion, elapsed)
        wanted = last = np.array(memory.demand)
        required = self._required_direction(path.in_trailer(), motion) if motion.v_x >= _CREEP else None
        if required is not None:
            wanted = self._axles.steer_angles(limited_direction(motion.direction), limited_direction(required), 0.0)
        demand = reachable(self._trailer, last, wanted, elapsed)
        return CtAtMemory(tick, path, tuple(demand.tolist())), SteerCommand(angles=demand)

    def _required_direction(self, path: FloatArray, motion: HitchMotion) -> float | None:
        """Required direction of the follow point's travel [rad] when the axles have answered; None if unknown."""
        s = arc_length(path)
        passed = crossing(path, s, -self._trailer.follow_distance)
        if passed is None:
            return None
        speed = math.hypot(motion.v_x, motion.v_y - self._trailer.follow_distance * motion.yaw_rate)  # of the rear
        ahead = max(0.0, passed.s - speed * self._preview)
        heading = tangent(path, s, ahead, _REACH).direction - motion.yaw_rate * self._preview
        difference = math.atan2(passed.y, self._trailer.follow_distance)  # of heading to the reference trailer
        return heading + self._gain * difference


_SLIP_DISTANCE = 2.0  # over which the remaining slip is learnt: some estimates [m]
_OFFSET_DISTANCE = 50.0  # over which its constant part is learnt: straight and bend [m]
_FORGOTTEN = 12.0  # distance after which a slip that was learnt no longer holds: a bend ends [m]
_SENSOR_TIME = 5.0  # over which the sensors' errors are learnt [s]
_LONGEST_GAP = 500  # between two estimates that are compared [ticks]
_SLOWEST = 0.5  # directions below this speed are noise [m/s]
_MOST_SLIP = 0.1  # of what is learnt [rad]
_PAUSE = 300  # of the steering, after which the driver starts anew [ticks]
_STD = 0.15  # assumed: of the off-tracking by dead reckoning [m]


class Learnt(NamedTuple):
    """Errors of the signals that the estimates show."""

    slip: float = 0.0  # of the tractor's rear axle, beyond the data sheet [rad]
    offset: float = 0.0  # its constant part, or the bias of the articulation [rad]
    yaw_rate: float = 0.0  # bias of the trailer's gyro [rad/s]
    scale: float = 1.0  # true speed over that of the wheels [-]


class ReckonedDriverMemory(NamedTuple):
    """State of the driver between two steps."""

    tick: int | None  # of the last step; None before the first
    path: ReckonedPath
    learnt: Learnt
    estimate: OffTracking | None  # newest one
    driver: PathLawMemory


class ReckonedDriver:
    """Dead reckoning at every step, and steering on demand."""

    def __init__(self, trailer: TrailerGeometry, combination: Combination) -> None:
        """For a trailer with steered axles."""
        self._trailer, self._unit = trailer, combination.unit
        self._tractor = TractorMotion(combination)
        self._driver = VirtualDriver(trailer)

    def init(self) -> ReckonedDriverMemory:
        """Straight road behind, wheels straight."""
        path = straight_behind(self._trailer.follow_distance)
        return ReckonedDriverMemory(None, path, Learnt(), None, self._driver.init())

    def reckoned(
        self, memory: ReckonedDriverMemory, tick: int, estimate: OffTracking | None, signals: CombinationSignals
    ) -> ReckonedDriverMemory:
        """Memory at ``tick``, with an estimate if there is a new one that can be relied on."""
        elapsed = elapsed_since(memory.tick, tick)
        motion = self._motion(memory.learnt, signals)
        kept = math.exp(-abs(motion.v_x) * elapsed / _FORGOTTEN)
        learnt = memory.learnt._replace(slip=kept * memory.learnt.slip)
        path = extended(memory.path, tick, motion, elapsed)
        memory = memory._replace(tick=tick, path=path, learnt=learnt)
        if estimate is None or (memory.estimate is not None and estimate.tick <= memory.estimate.tick):
            return memory
        learnt = self._learnt(memory, estimate)
        return memory._replace(path=corrected(memory.path, estimate), learnt=learnt, estimate=estimate)

    def steered(
        self, memory: ReckonedDriverMemory, tick: int, signals: CombinationSignals, last: FloatArray
    ) -> tuple[ReckonedDriverMemory, FloatArray]:
        """Memory and angles (n_steered,) [rad] on the path as it is reckoned at ``tick``; ``last`` are demanded now."""
        before = memory.driver if memory.driver.tick is not None and tick - memory.driver.tick <= _PAUSE else None
        driver = before or self._driver.init()._replace(tick=tick - 1)
        driver = driver._replace(demand=tuple(last.tolist()))
        driver, command = self._driver.step(driver, tick, self._estimate(memory, tick, signals), signals)
        return memory._replace(driver=driver), command.angles

    def _motion(self, learnt: Learnt, signals: CombinationSignals) -> HitchMotion:
        """Motion of the hitch, with the slip of the tractor's rear axle."""
        v_x, v_y, yaw_rate = self._tractor.of_hitch(signals, learnt.slip + learnt.offset)
        return HitchMotion(learnt.scale * v_x, learnt.scale * v_y, yaw_rate - learnt.yaw_rate)

    def _learnt(self, memory: ReckonedDriverMemory, estimate: OffTracking) -> Learnt:
        """Errors that a new estimate shows; its velocities are means since the one before."""
        before, learnt = memory.estimate, memory.learnt
        if before is None or estimate.tick - before.tick > _LONGEST_GAP:
            return learnt
        motion = motion_between(memory.path, before.tick, estimate.tick)
        if motion is None or min(motion.v_x, estimate.v_x) < _SLOWEST:
            return learnt
        interval = (estimate.tick - before.tick) * TICK
        distance = interval * estimate.v_x
        quick, steady = (1.0 - math.exp(-distance / over) for over in (_SLIP_DISTANCE, _OFFSET_DISTANCE))
        slow = 1.0 - math.exp(-interval / _SENSOR_TIME)
        slip = learnt.slip + quick * (math.atan2(estimate.v_y, estimate.v_x) - motion.direction)
        speeds = math.hypot(estimate.v_x, estimate.v_y) / math.hypot(motion.v_x, motion.v_y)
        return Learnt(
            slip=max(-_MOST_SLIP, min(_MOST_SLIP, (1.0 - steady) * slip)),
            offset=max(-_MOST_SLIP, min(_MOST_SLIP, learnt.offset + steady * slip)),
            yaw_rate=learnt.yaw_rate + slow * (motion.yaw_rate - estimate.yaw_rate),
            scale=learnt.scale * (1.0 + slow * (speeds - 1.0)),
        )

    def _estimate(self, memory: ReckonedDriverMemory, tick: int, signals: CombinationSignals) -> OffTracking:
        """The off-tracking by dead reckoning."""
        motion, path = self._motion(memory.learnt, signals), memory.path.in_trailer()
        target = target_on(path, arc_length(path), self._trailer.follow_distance)
        ahead = float(signals.yaw_rates[self._unit - 1])
        return OffTracking(
            tick=tick,
            value=0.0 if target is None else target.offset,
            std=math.inf if target is None else _STD,
            health=Health.LOST if target is None else Health.DEGRADED,
            path=path,
            hitch_direction=motion.direction,
            hitch_direction_rate=ahead - motion.yaw_rate,
            path_tangent=0.0 if target is None else target.direction,
            v_x=motion.v_x,
            v_y=motion.v_y,
            yaw_rate=motion.yaw_rate,
        )


FallbackName = Literal["dead_reckoning", "command_steer", "straight"]

# Command steer shortens the wheelbase, which destabilises a trailer at speed; systems in use lock there.
_SPEEDS: Final = LowSpeedParameters().speeds
_GAP: Final = 0.3  # without signals, after which the path is unknown [s]
_CHANGE_TIME: Final = 2.0  # between dead reckoning and command steer [s]
_UNLIMITED: Final = 1e3  # rate of the laws here; the guard limits it for all of them [rad/s]


class FallbackMemory(NamedTuple):
    """State of the fallback between two steps."""

    reckoning: ReckonedDriverMemory
    unknown: float = 0.0  # distance until the reckoned path is as long as is needed [m]
    steered_at: int | None = None  # last step of steering [ticks]
    share: float = 1.0  # of dead reckoning against command steer


class Fallback:
    """Steering by dead reckoning or command steer, reduced with speed; or straight wheels at any speed."""

    def __init__(self, trailer: TrailerGeometry, *, combination: Combination, name: FallbackName) -> None:
        """Construct it for a trailer with steered axles."""
        free = replace(trailer, max_steer_rate=_UNLIMITED)
        if combination.unit == 0 and name == "dead_reckoning":  # without a hitch the signals do not check each other
            name = "command_steer"
        self._trailer, self._name = trailer, name
        self._reckoning = ReckonedDriver(free, combination)
        self._command_steer = CommandSteer(free, combination=combination)

    def init(self) -> FallbackMemory:
        """Straight road behind."""
        return FallbackMemory(self._reckoning.init())

    def observed(
        self, memory: FallbackMemory, tick: int, estimate: OffTracking | None, signals: CombinationSignals
    ) -> FallbackMemory:
        """Memory with the signals of ``tick``, and with an estimate if there is a new one that can be relied on."""
        if self._name != "dead_reckoning" or not _are_finite(signals):
            return memory
        before, length = memory.reckoning.tick, self._trailer.follow_distance
        elapsed = elapsed_since(before, tick)
        reckoning = self._reckoning.reckoned(memory.reckoning, tick, estimate, signals)
        unknown = length if elapsed > _GAP else max(0.0, memory.unknown - abs(signals.speed) * elapsed)
        if reckoning.estimate is not memory.reckoning.estimate:
            unknown = 0.0
        return memory._replace(reckoning=reckoning, unknown=unknown)

    def steered(
        self, memory: FallbackMemory, tick: int, signals: CombinationSignals, last: FloatArray
    ) -> tuple[FallbackMemory, FloatArray]:
        """New memory and angles (n_steered,) [rad], not limited in rate; straight if a signal is not finite.

        ``last`` are the angles demanded so far.
        """
        if self._name == "straight" or not _are_finite(signals):
            return memory, np.zeros(len(last))
        _, command = self._command_steer.step(CommandSteerMemory(tick - 1, tuple(last.tolist())), tick, None, signals)
        angles = command.angles
        if self._name == "dead_reckoning":
            memory = self._with_share(memory, tick)
            reckoning, by_path = self._reckoning.steered(memory.reckoning, tick, signals, last)
            memory = memory._replace(reckoning=reckoning)
            angles = memory.share * by_path + (1.0 - memory.share) * angles
        return memory, _SPEEDS.share(signals.speed) * angles

    def _with_share(self, memory: FallbackMemory, tick: int) -> FallbackMemory:
        """Memory on the way between dead reckoning and command steer."""
        wanted = 0.0 if memory.unknown > 0.0 else 1.0
        pause = math.inf if memory.steered_at is None else (tick - memory.steered_at) * TICK
        step = 1.0 if pause > _GAP else pause / _CHANGE_TIME
        share = memory.share + max(-step, min(step, wanted - memory.share))
        return memory._replace(share=share, steered_at=tick)


def _are_finite(signals: CombinationSignals) -> bool:
    read = (signals.speed, *signals.articulation.tolist(), *signals.yaw_rates.tolist(), *signals.angles.tolist())
    return all(map(math.isfinite, read))
