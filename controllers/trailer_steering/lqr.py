"""High-speed steering: optimal state feedback against off-tracking and lateral acceleration, scheduled over speed.

A Kalman filter estimates the state from the combination's own sensors. The path between hitch and follow point comes
from the off-tracking estimate, carried on to the present by dead reckoning (``lateral_design`` has model and cost).

In a quick lane change the trailer then cuts the corner: its lateral motion is smoother and does not overshoot. At low
speed, with large articulations, the linear law is not valid. It fades in over a band of speeds; below it a trailer is
well damped by itself, and the law leaves its axles straight.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from controllers.driver import PERIOD
from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.hitch_motion import hitch_motion
from controllers.trailer_steering.lateral_design import KMH, Weights, at_speed, path_nodes, schedule
from controllers.trailer_steering.limits import check_steered
from controllers.trailer_steering.reckoned_path import ReckonedPath, corrected, moved, straight_behind
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option, check_options

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

    options: ClassVar[tuple[Option, ...]] = (
        Option("off_tracking_weight", 0.04, "weight of the off-tracking", "rad2/m2", 0.0, 10.0),
        Option("acceleration_weight", 0.03, "weight of the trailer's lateral acceleration", "rad2 s4/m2", 0.0, 10.0),
        Option("from_speed_kmh", 45.0, "speed below which the axles are straight", "km/h", 20.0, 120.0),
        Option("full_speed_kmh", 70.0, "speed from which on the law has full authority", "km/h", 20.0, 130.0),
    )

    def __init__(
        self,
        trailer: TrailerGeometry,
        *,
        combination: Combination,
        off_tracking_weight: float = 0.04,
        acceleration_weight: float = 0.03,
        from_speed_kmh: float = 45.0,
        full_speed_kmh: float = 70.0,
    ) -> None:
        """A controller for the trailer; ``options`` describes the parameters.

        Raises:
            ValueError: if the trailer has no steered axle, or a parameter is outside its limits.
        """
        check_steered("lqr", trailer)
        given = {
            "off_tracking_weight": off_tracking_weight,
            "acceleration_weight": acceleration_weight,
            "from_speed_kmh": from_speed_kmh,
            "full_speed_kmh": full_speed_kmh,
        }
        check_options(self.options, given)
        if not from_speed_kmh < full_speed_kmh:
            raise ValueError(f"full_speed_kmh = {full_speed_kmh} km/h must exceed from_speed_kmh = {from_speed_kmh}")
        self._trailer, self._combination = trailer, combination
        self._band = KMH * from_speed_kmh, KMH * full_speed_kmh
        self._ratios = np.array(trailer.steer_ratios)
        self._nodes = path_nodes(trailer.follow_distance)
        self._gains = schedule(combination, trailer, Weights(off_tracking_weight, acceleration_weight))

    def init(self) -> LqrMemory:
        """Straight road behind, wheels straight."""
        still = (0.0,) * len(self._gains[0].input)
        return LqrMemory(None, -1, straight_behind(self._trailer.follow_distance), still, 0.0)

    def authority(self, speed: float) -> float:
        """Share of the law at a speed [m/s], 0 to 1."""
        low, high = self._band
        return max(0.0, min(1.0, (speed - low) / (high - low)))

    def step(
        self, memory: LqrMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[LqrMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        motion = self._filtered(memory, elapsed, signals)
        path = moved(memory.path, tick, hitch_motion(self._combination, signals, float(motion[0])), elapsed)
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
