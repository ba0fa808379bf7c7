"""What trailer and hitch do at this moment: from the combination's signals, put right by every estimate.

The off-tracking estimate is a tenth of a second old or more; gyros and wheel speeds are not. The hitch's direction of
travel over ground turns with the unit ahead, and moves on that as the axles let it that do not steer. What those slip
sideways no gyro shows: the estimates do, and by how it went on between two of them it is carried on.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from controllers.trailer import Combination
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray, Pose2

_KEPT: Final = 3000  # of the records: the age of an estimate and the hold, with room for slow cameras [ticks]
_DIRECTION_TIME: Final = 0.1  # over which estimates put the hitch's direction right: about one estimate [s]
_SLIDE_SHARE: Final = 0.3  # of what was put right that goes into the rate of the slide: critically damped, about
_SLIDE_TIME: Final = 0.5  # over which a slide of the unit ahead dies out: of tyres that grip again [s]
_BIAS_TIME: Final = 5.0  # over which estimates show the gyro's bias and the scale of the speed [s]
_GAP: Final = 0.5  # without estimates, some of them may be missing; after a longer one they begin anew [s]
_UNSEEN: Final = 0.02  # by which what no gyro shows may change in every second without one [rad/s]
_LEAST_SPEED: Final = 0.5  # a direction of travel is not defined at rest [m/s]


class Record(NamedTuple):
    """What was so at one tick."""

    tick: int
    speed: float  # of the hitch [m/s]
    yaw_rate: float  # of the trailer [rad/s]
    lead_yaw_rate: float  # of the unit ahead [rad/s]
    hitch_direction: float  # of the hitch's travel in the trailer's frame, + left [rad]


class ObserverMemory(NamedTuple):
    """What is carried from one step to the next."""

    records: tuple[Record, ...] = ()  # oldest first
    pace: float = 1.0  # speed of the hitch over what wheels and yaw of the combination say [-]
    bias: float = 0.0  # of the trailer's gyro [rad/s]
    slide: float = 0.0  # rate at which the hitch's direction changes for the slip of the unit ahead [rad/s]
    doubt: float = 0.0  # what the hitch's direction was wrong by of late, or may be [rad]
    seen_at: int | None = None  # when it was last put right [ticks]

    @property
    def now(self) -> Record:
        """The newest record."""
        return self.records[-1]


class Observer:
    """The motion of one trailer of a combination."""

    def __init__(self, combination: Combination) -> None:
        ahead = combination.vehicle.units[combination.unit - 1]
        fixed = [axle.x for axle in ahead.axles if not axle.steered] or [axle.x for axle in ahead.axles]
        self._lever = ahead.rear_hitch[0] - sum(fixed) / len(
            fixed
        )  # of the hitch, before the axles that do not turn [m]
        self._unit = combination.unit

    def noticed(self, memory: ObserverMemory, signals: CombinationSignals) -> ObserverMemory:
        """Memory with the signals of a new moment."""
        lead = float(signals.yaw_rates[self._unit - 1])
        own = float(signals.yaw_rates[self._unit]) - memory.bias
        speed = memory.pace * math.hypot(signals.speed, self._lever * lead)
        direction, slide, doubt = self._drift(speed, lead), memory.slide, memory.doubt
        if memory.records:
            last = memory.now
            span = (signals.tick - last.tick) * TICK
            turned = 0.5 * (lead + last.lead_yaw_rate - own - last.yaw_rate) + slide
            direction += last.hitch_direction - self._drift(last.speed, last.lead_yaw_rate) + turned * span
            slide *= math.exp(-span / _SLIDE_TIME)
            if memory.seen_at is not None and (signals.tick - memory.seen_at) * TICK > _GAP:
                doubt += _UNSEEN * span
        else:
            direction += float(signals.articulation[self._unit - 1])
        kept = tuple(record for record in memory.records if record.tick >= signals.tick - _KEPT)
        records = (*kept, Record(signals.tick, speed, own, lead, direction))
        return memory._replace(records=records, slide=slide, doubt=doubt)

    def corrected(self, memory: ObserverMemory, seen: OffTracking, interval: float) -> ObserverMemory:
        """Memory put right by an estimate ``interval`` [s] after the one before.

        After a gap nothing tells over what time an estimate's velocities are means: it is but the first of new ones.
        """
        memory = memory._replace(seen_at=memory.now.tick)
        if interval > _GAP:
            return memory
        middle = record_at(memory.records, seen.tick - round(0.5 * interval / TICK))  # its velocities are means
        speed = math.hypot(seen.v_x, seen.v_y)
        if min(seen.v_x, middle.speed) < _LEAST_SPEED:
            return memory
        slow, quick = (1.0 - math.exp(-interval / time) for time in (_BIAS_TIME, _DIRECTION_TIME))
        error = math.atan2(seen.v_y, seen.v_x) - middle.hitch_direction
        turn = quick * error
        return ObserverMemory(
            records=tuple(record._replace(hitch_direction=record.hitch_direction + turn) for record in memory.records),
            pace=memory.pace * (1.0 + slow * (speed / middle.speed - 1.0)),
            bias=memory.bias + slow * (middle.yaw_rate - seen.yaw_rate),
            slide=memory.slide + _SLIDE_SHARE * turn / interval,
            doubt=max(memory.doubt * math.exp(-interval / _SLIDE_TIME), abs(error)),
            seen_at=memory.seen_at,
        )

    def _drift(self, speed: float, lead: float) -> float:
        """Direction [rad] of the hitch's travel in the frame of the unit ahead, whose fixed axles do not slip."""
        return math.atan(self._lever * lead / max(speed, _LEAST_SPEED))


class Reckoned(NamedTuple):
    """The trailer's motion since some tick, in its frame S at that tick."""

    frame: Pose2  # its own frame now
    hitch_way: FloatArray  # (n, 2) positions of the hitch since, newest first [m]


def record_at(records: tuple[Record, ...], tick: int) -> Record:
    """The newest record that is not after a tick, or the oldest there is."""
    return next((record for record in reversed(records) if record.tick <= tick), records[0])


def reckoned(records: tuple[Record, ...], since: int) -> Reckoned:
    """The motion since a tick, by trapezia between the records."""
    x = y = psi = 0.0
    before, tick, way = record_at(records, since), since, []
    for record in records:
        if record.tick <= since:
            continue
        span = (record.tick - tick) * TICK
        turn = 0.5 * span * (before.yaw_rate + record.yaw_rate)
        course = psi + 0.5 * (turn + before.hitch_direction + record.hitch_direction)
        ahead = 0.5 * span * (before.speed + record.speed)
        x, y, psi = x + ahead * math.cos(course), y + ahead * math.sin(course), psi + turn
        way.append((x, y))
        before, tick = record, record.tick
    return Reckoned(Pose2(x, y, psi), np.array(way[::-1]).reshape(-1, 2))
