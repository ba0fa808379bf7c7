"""Rover odometry from wheel and steer encoders and compass, and slip angles from external instruments.

Encoders measure the distance along each wheel's heading. The slip angle corrects the direction of travel, after the
idea of Reina et al. (2010, "Odometry correction using visual slip angle estimation for planetary exploration rovers");
only the idea is used here. Longitudinal slip remains as an error of the distance.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from operator import attrgetter
from typing import ClassVar, Final, NamedTuple, Self

import numpy as np

from estimators.context import RoverContext, RoverGeometry
from estimators.estimates import Health, SlipAngle
from sensors.messages import LaserFix, RoverReadings, SlipReading
from vehicle.clock import TICK
from vehicle.frames import FloatArray, wrap

_HEADING_TIME: Final = 2.0  # time constant of the correction of the heading by the compass [s]
# Time constant of the drift angle that the driver compensates. Slopes change over some seconds, and a single slip angle
# is accurate to a degree only [s]
_DRIFT_TIME: Final = 3.0
_FIX_TIME: Final = 1.0  # time constant of the correction of the position by a fix [s]
_HISTORY: Final = 20_000  # directions kept for delayed slip angles and for means over a long distance [ticks]
_NEAR: Final = 100  # largest time between a slip angle and its reading [ticks]
# Without a slip angle the last one is carried on. What makes a rover slip is a slope, whose direction in the world
# stays: seen from a rover that has turned by some angle, its cosine is left of the sideward pull, and nothing is known
# of the other component.
_HELD: Final = 0.1  # distance without a slip angle that is no loss: some images [m]
_STANDING: Final = 0.005  # below it the wheels give no direction [m/s]


class Rolling(NamedTuple):
    """Planar velocity of the body by the wheels."""

    v_x: float  # along the body's axes [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # [rad/s]


def wheel_motion(places: FloatArray, speeds: FloatArray, steer: FloatArray) -> Rolling:
    """Least-squares rigid motion of wheels that roll along their headings.

    Wheels (n, 2) relative to their centroid [m], rim speeds (n,) [m/s], steer angles (n,) relative to the body [rad].
    """
    along, across = speeds * np.cos(steer), speeds * np.sin(steer)
    x, y = places.T
    turning = (x @ across - y @ along) / (x @ x + y @ y)
    return Rolling(float(along.mean()), float(across.mean()), float(turning))


class Turn(NamedTuple):
    """Direction of travel by the wheels at one tick."""

    tick: int
    distance: float  # driven until then [m]
    direction: float  # relative to the body [rad]
    heading: float  # of the body [rad]
    drift: float  # slip angle relative to that direction, as used for the position [rad]


class OdometryMemory(NamedTuple):
    """Pose, drift and history of directions after a reading."""

    x: float
    y: float
    psi: float
    slip_heading: float  # heading when the newest slip angle came [rad]
    tick: int | None = None
    drift: float = 0.0  # angle from the wheels' direction to the direction of travel, smoothed, for compensation [rad]
    newest_drift: float = 0.0  # the same as last measured, for the position, where noise averages out [rad]
    slip_tick: int = -1  # of the newest slip angle used; -1: none yet
    slip_distance: float = 0.0  # driven since then [m]
    lagged_tick: int = -1  # up to which the position has been corrected by delayed slip angles
    turns: tuple[Turn, ...] = ()  # newest last

    @property
    def carried(self) -> bool:
        """True if the drift is carried on from a slip angle of some distance ago."""
        return self.slip_tick >= 0 and self.slip_distance > _HELD

    def with_carried_drift(self) -> OdometryMemory:
        """Memory with the drift turned with the rover since the last slip angle; unchanged while slip angles come."""
        if not self.carried:
            return self
        left = math.cos(wrap(self.psi - self.slip_heading))
        return self._replace(drift=left * self.drift, newest_drift=left * self.newest_drift)


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverPose:
    """Estimated pose of a rover with its drift and velocity."""

    tick: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    drift: float  # angle from the wheels' direction to the direction of travel, + left [rad]
    rolling: Rolling
    carried: bool = False  # True: no slip angle shows that drift at present


class RoverOdometry:
    """Dead reckoning, corrected by slip angles and laser fixes if given."""

    def __init__(self, rover: RoverGeometry) -> None:
        self._rover = rover
        self._places = rover.places()
        self._left = self._places[:, 1] > 0.0
        self._rolled: tuple[RoverReadings | None, Rolling] = (None, Rolling(0.0, 0.0, 0.0))  # the last motion

    def init(self, x: float, y: float, psi: float) -> OdometryMemory:
        """Memory at a known pose in W [m, rad]."""
        return OdometryMemory(x, y, psi, slip_heading=psi)

    def step(
        self,
        memory: OdometryMemory,
        readings: RoverReadings,
        slip: SlipAngle | None = None,
        fix: LaserFix | None = None,
    ) -> tuple[OdometryMemory, RoverPose]:
        """Memory and pose at the readings' tick; ``slip`` is the newest estimate, ``fix`` one of the same tick."""
        elapsed = 0.0 if memory.tick is None else (readings.tick - memory.tick) * TICK
        rolling = self.rolling(readings)
        memory = self._with_drift(memory, slip)
        moved = self._moved(memory, readings, rolling, elapsed)
        used = moved.with_carried_drift()
        if fix is not None:
            moved = _corrected(moved, fix, elapsed)
        kept = moved.turns[bisect_right(moved.turns, readings.tick - _HISTORY, key=attrgetter("tick")) :]
        speed = math.hypot(rolling.v_x, rolling.v_y)
        if speed > _STANDING:
            distance = (kept[-1].distance if kept else 0.0) + speed * elapsed
            direction = math.atan2(rolling.v_y, rolling.v_x)
            kept = (*kept, Turn(readings.tick, distance, direction, moved.psi, used.newest_drift))
            moved = moved._replace(slip_distance=moved.slip_distance + speed * elapsed)
        moved = moved._replace(tick=readings.tick, turns=kept)
        pose = RoverPose(
            tick=readings.tick,
            x=moved.x,
            y=moved.y,
            psi=moved.psi,
            drift=used.drift,
            rolling=rolling,
            carried=moved.carried,
        )
        return moved, pose

    def rolling(self, readings: RoverReadings) -> Rolling:
        """Rigid motion by wheel speeds and steer angles, without slip."""
        if readings is not self._rolled[0]:  # several odometries take the same readings
            self._rolled = readings, self._rolling(readings)
        return self._rolled[1]

    def _rolling(self, readings: RoverReadings) -> Rolling:
        speed = self._rover.wheel_radius * readings.wheel_speeds
        rolling = wheel_motion(self._places, speed, readings.steer)
        if self._rover.steered:
            return rolling
        yaw_rate = float(speed[~self._left].mean() - speed[self._left].mean()) / self._rover.effective_track
        return rolling._replace(yaw_rate=yaw_rate)

    def _moved(
        self, memory: OdometryMemory, readings: RoverReadings, rolling: Rolling, elapsed: float
    ) -> OdometryMemory:
        """Pose integrated by the wheels and the drift; the heading is corrected by the compass."""
        psi = memory.psi + rolling.yaw_rate * elapsed
        psi += (1.0 - math.exp(-elapsed / _HEADING_TIME)) * wrap(readings.heading - psi)
        middle = 0.5 * (memory.psi + psi)
        c, s, t = math.cos(middle), math.sin(middle), math.tan(memory.with_carried_drift().newest_drift)
        # An encoder counts the distance along the wheel's heading, also of a wheel that slips sideways.
        ahead, lateral = rolling.v_x - t * rolling.v_y, rolling.v_y + t * rolling.v_x
        return memory._replace(
            x=memory.x + (c * ahead - s * lateral) * elapsed, y=memory.y + (s * ahead + c * lateral) * elapsed, psi=psi
        )

    def _with_drift(self, memory: OdometryMemory, slip: SlipAngle | None) -> OdometryMemory:
        """Drift updated with a new slip angle; unchanged by a lost one."""
        if slip is None or slip.health is Health.LOST or slip.tick <= memory.slip_tick or not memory.turns:
            return memory
        direction = _mean_direction(memory.turns, slip)
        if direction is None:  # the rover stood
            return memory
        measured = wrap(slip.value - direction)
        since = _DRIFT_TIME if memory.slip_tick < 0 else (slip.tick - memory.slip_tick) * TICK
        share = 1.0 - math.exp(-since / _DRIFT_TIME)
        before = memory.with_carried_drift().drift
        memory = memory._replace(
            drift=before + share * (measured - before),
            newest_drift=measured,
            slip_tick=slip.tick,
            slip_heading=memory.psi,
            slip_distance=0.0,
        )
        return _with_delayed(memory, slip)


def _with_delayed(memory: OdometryMemory, slip: SlipAngle) -> OdometryMemory:
    """Position corrected since the last delayed slip angle by the newest one."""
    tick, before = slip.lagged_tick, memory.lagged_tick
    if tick is None or tick <= before:
        return memory
    memory = memory._replace(lagged_tick=tick)
    last, then = (_nearest_turn(memory.turns, end) for end in (before, tick))
    distance = then.distance - last.distance
    # the first one, or the rover stood in between, or it does not tell of the way since the last one
    if (last.tick, then.tick) != (before, tick) or distance > _HELD:
        return memory
    lateral = distance * (math.tan(wrap(slip.lagged_value - then.direction)) - math.tan(then.drift))
    course = then.heading + then.direction
    return memory._replace(x=memory.x - lateral * math.sin(course), y=memory.y + lateral * math.cos(course))


def _mean_direction(turns: tuple[Turn, ...], slip: SlipAngle) -> float | None:
    """Mean direction [rad] by the wheels over the distance of the slip angle; None if unknown."""
    then = _nearest_turn(turns, slip.tick)
    if abs(then.tick - slip.tick) > _NEAR:
        return None
    begin = bisect_left(turns, then.distance - slip.averaged_over, key=attrgetter("distance"))
    end = bisect_right(turns, then.distance, key=attrgetter("distance"))
    return math.fsum(turn.direction for turn in turns[begin:end]) / (end - begin)


def _nearest_turn(turns: tuple[Turn, ...], tick: int) -> Turn:
    """Turn nearest to a tick."""
    at = bisect_left(turns, tick, key=attrgetter("tick"))
    return min(turns[max(at - 1, 0) : at + 1], key=lambda turn: abs(turn.tick - tick))


def _corrected(memory: OdometryMemory, fix: LaserFix, elapsed: float) -> OdometryMemory:
    """Position corrected by a fix."""
    share = 1.0 - math.exp(-max(elapsed, 0.2) / _FIX_TIME)  # fixes arrive at 5 Hz
    x, y = memory.x + share * (fix.p_WR[0] - memory.x), memory.y + share * (fix.p_WR[1] - memory.y)
    return memory._replace(x=float(x), y=float(y))


_SPAN: Final = 4.0  # of fixes and headings for a direction of travel: 0.3 m of travel [s]
_LEAST_DISTANCE: Final = 0.05  # a shorter one shows the tracker's noise, not a direction [m]


class ReferenceSlip:
    """Slip angle that an exact instrument reads."""

    sensor: ClassVar[str] = "slip_reading"

    @classmethod
    def of(cls, context: RoverContext) -> Self:
        """Estimator that needs nothing of the context."""
        return cls()

    def init(self) -> None:
        """Empty memory."""
        return

    def step(self, memory: None, reading: SlipReading) -> tuple[None, SlipAngle]:
        """The reading as an estimate without error."""
        return None, SlipAngle(
            tick=reading.tick,
            value=reading.slip_angle,
            std=0.0,
            health=Health.OK,
            wheel_slip=reading.wheel_slip,
            trace_offset=0.0,
            confidence=1.0,
        )


class LaserSample(NamedTuple):
    """Laser fix with the heading at the same tick."""

    time: float  # [s]
    x: float  # [m]
    y: float  # [m]
    heading: float  # [rad]


class LaserSlip:
    """Reina 2008's ground truth: direction of travel by the tracker minus heading by the compass (eqs 5 and 6).

    Both are means over the last seconds, so the result is delayed by half of them.
    """

    def init(self) -> tuple[LaserSample, ...]:
        """Memory before the first fix."""
        return ()

    def step(
        self, memory: tuple[LaserSample, ...], fix: LaserFix, heading: float
    ) -> tuple[tuple[LaserSample, ...], float | None]:
        """Memory with the fix in it, and the slip angle [rad] at its middle; None while the distance is too short."""
        now = LaserSample(fix.tick * TICK, float(fix.p_WR[0]), float(fix.p_WR[1]), heading)
        memory = (*(sample for sample in memory if sample.time > now.time - _SPAN), now)
        time, x, y, psi = np.array(memory).T
        if len(memory) < 3 or math.hypot(x[-1] - x[0], y[-1] - y[0]) < _LEAST_DISTANCE:
            return memory, None
        x_rate, y_rate = (float(np.polyfit(time - time.mean(), at, 1)[0]) for at in (x, y))
        mean_heading = math.atan2(float(np.sin(psi).mean()), float(np.cos(psi).mean()))
        return memory, wrap(math.atan2(y_rate, x_rate) - mean_heading)

    def delay(self) -> float:
        """Delay of its slip angle [s]."""
        return 0.5 * _SPAN
