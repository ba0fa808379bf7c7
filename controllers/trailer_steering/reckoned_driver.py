"""A virtual driver on the dead-reckoned path of the hitch: trailer steering without an estimate of the off-tracking.

Wheel speed, angles and gyros give the motion of the hitch, with slip by the data sheet of the combination. While there
are estimates, they replace the path that is reckoned, and show what the data sheet does not know: slip on a cross-fall,
the bias of articulation and gyro, and the scale of the wheel speed. Without them the path goes on by dead reckoning.
Only the last follow distance of it counts, so that errors do not grow for ever.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from controllers.trailer import Combination, TrailerGeometry
from controllers.trailer_steering.hitch_motion import HitchMotion, hitch_motion
from controllers.trailer_steering.reckoned_path import (
    ReckonedPath,
    corrected,
    motion_between,
    moved,
    straight_behind,
)
from controllers.trailer_steering.target import target_on
from controllers.trailer_steering.tractor_motion import TractorMotion
from controllers.trailer_steering.virtual_driver import VirtualDriver, VirtualDriverMemory
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_SLIP_DISTANCE = 2.0  # over which the remaining slip is learnt: some estimates [m]
_OFFSET_DISTANCE = 50.0  # over which its constant part is learnt: straight and bend [m]
_FORGOTTEN = 12.0  # distance after which a slip that was learnt no longer holds: a bend ends [m]
_SENSOR_TIME = 5.0  # over which the sensors' errors are learnt [s]
_LONGEST = 500  # between two estimates that are compared [ticks]
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
    driver: VirtualDriverMemory


class ReckonedDriver:
    """Dead reckoning at every step, and steering on demand."""

    def __init__(self, trailer: TrailerGeometry, combination: Combination) -> None:
        """For a trailer with steered axles."""
        self._trailer, self._combination = trailer, combination
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
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        motion = self._motion(memory.learnt, signals)
        kept = math.exp(-abs(motion.v_x) * elapsed / _FORGOTTEN)
        learnt = memory.learnt._replace(slip=kept * memory.learnt.slip)
        path = moved(memory.path, tick, motion, elapsed)
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
        slip = learnt.slip + learnt.offset + self._tractor.slip(signals)
        speed = self._tractor.speed(signals, slip)
        v_x, v_y, yaw_rate = hitch_motion(self._combination, replace(signals, speed=speed), speed * slip)
        return HitchMotion(learnt.scale * v_x, learnt.scale * v_y, yaw_rate - learnt.yaw_rate)

    def _learnt(self, memory: ReckonedDriverMemory, estimate: OffTracking) -> Learnt:
        """Errors that a new estimate shows; its velocities are means since the one before."""
        before, learnt = memory.estimate, memory.learnt
        if before is None or estimate.tick - before.tick > _LONGEST:
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
        target = target_on(path, self._trailer.follow_distance)
        ahead = float(signals.yaw_rates[self._combination.unit - 1])
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
