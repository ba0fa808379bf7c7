"""Off-tracking by kinematics without slip at the tractor's rear axle: no camera, only signals of the combination.

The conventional estimate of a path-following trailer (Q. Cheng and colleagues, as de Saxe 2018 reports it: tractor
speed and steer angle, articulation and trailer yaw rate). Their equations are not published there; these are derived.
The tractor's rear axle travels along the tractor's axis, and the steer angle gives the yaw rate; together they give the
velocity of its hitch. The measured articulation transforms it into the axes of the next unit, whose gyro measures its
yaw rate. Where tyres slip, on a cross-fall or ice, the path is rotated by the slip angle.
"""

import math
from typing import ClassVar, NamedTuple, Self

import numpy as np

from estimators.context import TrailerContext
from estimators.estimates import Health, OffTracking
from estimators.hitch_motion import HitchMotion, hitch_motions
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from estimators.rigid_motion import PLANAR, nothing_common
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.frames import Pose2

_PUBLISHED = 100  # output period, as of a camera [ticks]
_LONGEST_GAP = 500  # longest gap between signals; after it the path restarts [ticks]
_SLOWEST = 0.5  # least speed in the error model [m/s]

# Standard deviations of constant errors along the whole path; slip is neglected.
_YAW_RATE = math.radians(0.1)  # assumed: a vehicle gyro's bias [rad/s]
_DIRECTION = math.radians(0.15)  # assumed: articulation and steer sensors' bias [rad]
_SPEED_SCALE = 0.005  # assumed: of wheel speeds [-]


class KinematicMemory(NamedTuple):
    """Last signals, motion since the last estimate, and the buffer."""

    last: CombinationSignals | None
    since: int  # tick of the last estimate
    moved: Pose2  # pose of the trailer in its frame at that tick
    buffer: BufferMemory


class KinematicOffTracking:
    """Off-tracking of one trailer, assuming no slip at the tractor's rear axle."""

    sensor: ClassVar[str] = "combination_signals"

    def __init__(self, vehicle: Vehicle, unit: int, follow_distance: float) -> None:
        """For the ``unit`` of a vehicle whose follow point is ``follow_distance`` [m] behind its hitch.

        Raises:
            ValueError: if the unit is not towed, or ``follow_distance`` not positive.
        """
        vehicle.check_towed(unit)
        self._levers = vehicle.hitch_levers(unit)
        self._wheelbase = vehicle.units[0].steered_axles[0].x  # frame T has its origin at the rear axle
        self._buffer = OffTrackingBuffer(follow_distance)

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator for the context's trailer."""
        return cls(context.vehicle, context.unit, context.follow_distance)

    def init(self) -> KinematicMemory:
        """Memory before the first signals."""
        return KinematicMemory(None, 0, Pose2(0.0, 0.0, 0.0), self._buffer.init())

    def step(self, memory: KinematicMemory, signals: CombinationSignals) -> tuple[KinematicMemory, OffTracking | None]:
        """Memory with the signals in it, and the off-tracking at their tick if a new one is due."""
        if memory.last is None or signals.tick - memory.last.tick > _LONGEST_GAP:
            return KinematicMemory(signals, signals.tick, Pose2(0.0, 0.0, 0.0), self._buffer.init()), None
        moved = memory.moved @ self._step(memory.last, signals)
        if signals.tick - memory.since < _PUBLISHED:
            return memory._replace(last=signals, moved=moved), None
        motion = self._motion(memory.since, signals.tick, moved)
        buffer, off_tracking = self._buffer.step(memory.buffer, motion)
        return KinematicMemory(signals, signals.tick, Pose2(0.0, 0.0, 0.0), buffer), off_tracking

    def _step(self, before: CombinationSignals, now: CombinationSignals) -> Pose2:
        """Pose of the unit in its previous frame, from mean velocities along the axes halfway."""
        dt = (now.tick - before.tick) * TICK
        ends = self._hitch_motion(before), self._hitch_motion(now)
        v_x, v_y, yaw_rate = (0.5 * (a + b) for a, b in zip(*ends, strict=True))
        turned = yaw_rate * dt
        c, s = math.cos(0.5 * turned), math.sin(0.5 * turned)
        return Pose2(dt * (c * v_x - s * v_y), dt * (s * v_x + c * v_y), turned)

    def _hitch_motion(self, signals: CombinationSignals) -> HitchMotion:
        """Motion of the unit's hitch without slip at the tractor's rear axle."""
        turning = [signals.speed * math.tan(signals.steer) / self._wheelbase, *signals.yaw_rates[1:].tolist()]
        return hitch_motions(signals.speed, 0.0, self._levers, turning, signals.articulation.tolist())[-1]

    def _motion(self, since: int, tick: int, moved: Pose2) -> BodyMotion:
        """Motion for the buffer; its errors are constant, and so common to all motions."""
        distance, dt = math.hypot(moved.x, moved.y), (tick - since) * TICK
        per_metre = _YAW_RATE / max(distance / dt, _SLOWEST)  # of yaw [rad/m]
        common = nothing_common()
        common[PLANAR, PLANAR] = np.array([per_metre, _SPEED_SCALE, _DIRECTION]) * distance
        return BodyMotion(
            tick=tick,
            previous_tick=since,
            X_PC=moved.spatial(),
            covariance=common @ common.T,
            health=Health.OK,
            common=common,
        )
