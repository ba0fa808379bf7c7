"""Where a rover is by its own instruments: wheel and steer encoders, compass, and, if there is one, its slip angle.

Encoders take every turn of a wheel for way along its heading. With the slip angle the way points where the rover
really went, after the idea of Reina et al. (2010, "Odometry correction using visual slip angle estimation for planetary
exploration rovers"), of which nothing but that idea is used here. Longitudinal slip stays in the distance.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np

from estimators.estimates import Health, SlipAngle
from sensors.messages import LaserFix, RoverReadings
from vehicle.clock import TICK
from vehicle.frames import FloatArray, wrap
from vehicle.rover.command import WheelPlace

_HEADING_TIME: Final = 2.0  # over which the compass corrects the heading that the wheels show [s]
# Over which a new slip angle takes the place of the old one in the drift to steer against: slopes change over some
# seconds of way, and what a trace shows of a moment is known to a degree only [s]
_DRIFT_TIME: Final = 3.0
_FIX_TIME: Final = 1.0  # over which a fix corrects the position [s]
_HISTORY: Final = 20_000  # directions kept for slip angles that come late, or are of a long way [ticks]
_NEAR: Final = 100  # between a slip angle and the reading that it goes with [ticks]
_STANDING: Final = 0.005  # slower than this the wheels show no direction [m/s]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverGeometry:
    """What a rover knows of itself.

    Raises:
        ValueError: if a length is not positive.
    """

    wheels: tuple[WheelPlace, ...]
    wheel_radius: float  # [m]
    effective_track: float  # of turning by different wheel speeds: the tread times what scrubbing makes of it [m]
    max_steer: tuple[float, ...]  # of each wheel; 0: it is not steered [rad]
    max_wheel_speed: float  # [rad/s]

    def __post_init__(self) -> None:
        for name in ("wheel_radius", "effective_track", "max_wheel_speed"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)} must be positive")
        if len(self.max_steer) != len(self.wheels):
            raise ValueError(f"max_steer = {self.max_steer} must have a value for each of {len(self.wheels)} wheels")

    @property
    def steered(self) -> bool:
        """True if any wheel is steered; if not, the rover turns by different speeds of its sides."""
        return max(self.max_steer) > 0.0

    def places(self) -> FloatArray:
        """Wheels (n, 2) in R [m], in their order."""
        return wheel_places(self.wheels)


class Rolling(NamedTuple):
    """How the wheels say that the rover moves."""

    v_x: float  # along the body's axes [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # [rad/s]


def wheel_places(wheels: Sequence[WheelPlace]) -> FloatArray:
    """Places (n, 2) of wheels in R [m]."""
    return np.array([(wheel.x, wheel.y) for wheel in wheels])


def rolled(places: FloatArray, speeds: FloatArray, steer: FloatArray) -> Rolling:
    """The rigid motion that fits wheels best that go where they point.

    Wheels (n, 2) about their own middle [m], speeds (n,) of their rims [m/s] and angles (n,) against the body [rad].
    """
    along, across = speeds * np.cos(steer), speeds * np.sin(steer)
    x, y = places.T
    turning = (x @ across - y @ along) / (x @ x + y @ y)
    return Rolling(float(along.mean()), float(across.mean()), float(turning))


class Turn(NamedTuple):
    """Where the wheels pointed at one tick."""

    tick: int
    way: float  # made by then [m]
    direction: float  # of the way that they show, against the body [rad]
    heading: float  # of the body [rad]
    drift: float  # that the way was reckoned with [rad]


class OdometryMemory(NamedTuple):
    """What is carried from one reading to the next."""

    tick: int | None
    x: float
    y: float
    psi: float
    drift: float  # by which the way turns off where the wheels point, smoothed: what to steer against [rad]
    newest_drift: float  # the same as last measured: what the way is reckoned with, where noise averages out [rad]
    slip_tick: int  # of the newest slip angle that was used
    lagged_tick: int  # up to which the way has been reckoned again with what was known later
    turns: tuple[Turn, ...]  # newest last


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverPose:
    """Where a rover believes to be and to go."""

    tick: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    drift: float  # by which its way turns off where its wheels point, + left [rad]
    rolling: Rolling


class RoverOdometry:
    """Dead reckoning, with the slip angle if one is given to it."""

    def __init__(self, rover: RoverGeometry) -> None:
        self._rover = rover
        self._places = rover.places()
        self._left = self._places[:, 1] > 0.0

    def init(self, x: float, y: float, psi: float) -> OdometryMemory:
        """At a known pose in W [m, rad]."""
        return OdometryMemory(
            tick=None, x=x, y=y, psi=psi, drift=0.0, newest_drift=0.0, slip_tick=-1, lagged_tick=-1, turns=()
        )

    def step(
        self,
        memory: OdometryMemory,
        readings: RoverReadings,
        slip: SlipAngle | None = None,
        fix: LaserFix | None = None,
    ) -> tuple[OdometryMemory, RoverPose]:
        """Memory and pose at the readings' tick; ``slip`` is the newest there is, ``fix`` one taken just now."""
        elapsed = 0.0 if memory.tick is None else (readings.tick - memory.tick) * TICK
        rolling = self.rolling(readings)
        memory = self._with_drift(memory, slip)
        moved = self._moved(memory, readings, rolling, elapsed)
        if fix is not None:
            moved = _corrected(moved, fix, elapsed)
        kept = moved.turns[bisect_right(moved.turns, readings.tick - _HISTORY, key=attrgetter("tick")) :]
        speed = math.hypot(rolling.v_x, rolling.v_y)
        if speed > _STANDING:
            way = (kept[-1].way if kept else 0.0) + speed * elapsed
            direction = math.atan2(rolling.v_y, rolling.v_x)
            kept = (*kept, Turn(readings.tick, way, direction, moved.psi, moved.newest_drift))
        moved = moved._replace(tick=readings.tick, turns=kept)
        pose = RoverPose(tick=readings.tick, x=moved.x, y=moved.y, psi=moved.psi, drift=moved.drift, rolling=rolling)
        return moved, pose

    def rolling(self, readings: RoverReadings) -> Rolling:
        """The rigid motion that the wheels' turns and angles show, without any slip of theirs."""
        speed = self._rover.wheel_radius * readings.wheel_speeds
        rolling = rolled(self._places, speed, readings.steer)
        if self._rover.steered:
            return rolling
        yaw_rate = float(speed[~self._left].mean() - speed[self._left].mean()) / self._rover.effective_track
        return rolling._replace(yaw_rate=yaw_rate)

    def _moved(
        self, memory: OdometryMemory, readings: RoverReadings, rolling: Rolling, elapsed: float
    ) -> OdometryMemory:
        """Carried on by the wheels, turned by the drift; the heading is drawn to the compass."""
        psi = memory.psi + rolling.yaw_rate * elapsed
        psi += (1.0 - math.exp(-elapsed / _HEADING_TIME)) * wrap(readings.heading - psi)
        middle = 0.5 * (memory.psi + psi)
        c, s, t = math.cos(middle), math.sin(middle), math.tan(memory.newest_drift)
        # A wheel that goes aside still rolls its turns: what it goes along its heading is what its encoder counts.
        ahead, aside = rolling.v_x - t * rolling.v_y, rolling.v_y + t * rolling.v_x
        return memory._replace(
            x=memory.x + (c * ahead - s * aside) * elapsed, y=memory.y + (s * ahead + c * aside) * elapsed, psi=psi
        )

    def _with_drift(self, memory: OdometryMemory, slip: SlipAngle | None) -> OdometryMemory:
        """The drift drawn to a slip angle that is new; one that is lost leaves it as it was."""
        if slip is None or slip.health is Health.LOST or slip.tick <= memory.slip_tick or not memory.turns:
            return memory
        pointed = _pointed(memory.turns, slip)
        if pointed is None:  # the rover stood
            return memory
        measured = wrap(slip.value - pointed)
        since = _DRIFT_TIME if memory.slip_tick < 0 else (slip.tick - memory.slip_tick) * TICK
        share = 1.0 - math.exp(-since / _DRIFT_TIME)
        drift = memory.drift + share * (measured - memory.drift)
        return _again(memory._replace(drift=drift, newest_drift=measured, slip_tick=slip.tick), slip)


def _again(memory: OdometryMemory, slip: SlipAngle) -> OdometryMemory:
    """The way since the last slip angle that was known later, reckoned again with the newest of them."""
    tick, before = slip.lagged_tick, memory.lagged_tick
    if tick is None or tick <= before:
        return memory
    memory = memory._replace(lagged_tick=tick)
    last, then = (_turn_near(memory.turns, end) for end in (before, tick))
    if (last.tick, then.tick) != (before, tick):  # it is the first one, or the rover stood meanwhile
        return memory
    way = then.way - last.way
    aside = way * (math.tan(wrap(slip.lagged_value - then.direction)) - math.tan(then.drift))
    course = then.heading + then.direction
    return memory._replace(x=memory.x - aside * math.sin(course), y=memory.y + aside * math.cos(course))


def _pointed(turns: tuple[Turn, ...], slip: SlipAngle) -> float | None:
    """Where the wheels pointed over the way that the slip angle is of [rad]; None if that is not known."""
    then = _turn_near(turns, slip.tick)
    if abs(then.tick - slip.tick) > _NEAR:
        return None
    begin = bisect_left(turns, then.way - slip.averaged_over, key=attrgetter("way"))
    end = bisect_right(turns, then.way, key=attrgetter("way"))
    return math.fsum(turn.direction for turn in turns[begin:end]) / (end - begin)


def _turn_near(turns: tuple[Turn, ...], tick: int) -> Turn:
    """That which was nearest to a tick."""
    at = bisect_left(turns, tick, key=attrgetter("tick"))
    return min(turns[max(at - 1, 0) : at + 1], key=lambda turn: abs(turn.tick - tick))


def _corrected(memory: OdometryMemory, fix: LaserFix, elapsed: float) -> OdometryMemory:
    """The position drawn to a fix."""
    share = 1.0 - math.exp(-max(elapsed, 0.2) / _FIX_TIME)  # fixes come five times a second
    x, y = memory.x + share * (fix.p_WR[0] - memory.x), memory.y + share * (fix.p_WR[1] - memory.y)
    return memory._replace(x=float(x), y=float(y))
