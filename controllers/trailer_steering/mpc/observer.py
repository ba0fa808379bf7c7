"""Observer of the present motion of trailer and hitch: signals of the combination, corrected by every estimate.

The off-tracking estimate is 0.1 s old or more; gyros and wheel speeds are current. The hitch's direction of travel over
ground turns with the unit ahead and changes with the roll of that unit's fixed axles. Their lateral slip is not
measured by gyros. The estimates show it, and its rate between two estimates is extrapolated.
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

_KEPT: Final = 3000  # age of the records: that of an estimate and the hold, with margin for slow cameras [ticks]
_DIRECTION_TIME: Final = 0.1  # of the direction's correction: about one estimate [s]
_SLIDE_SHARE: Final = 0.3  # of a correction that goes into the slide rate: about critically damped
_SLIDE_TIME: Final = 0.5  # decay of a slide of the unit ahead: tyres grip again [s]
_BIAS_TIME: Final = 5.0  # of the gyro bias and the scale of the speed [s]
_GAP: Final = 0.5  # between estimates, with some missing; after a longer one they start anew [s]
_UNOBSERVED: Final = 0.02  # growth of the direction's uncertainty without estimates [rad/s]
_LEAST_SPEED: Final = 0.5  # a direction of travel is not defined at rest [m/s]


class Record(NamedTuple):
    """Motion at one tick."""

    tick: int
    speed: float  # of the hitch [m/s]
    yaw_rate: float  # of the trailer [rad/s]
    lead_yaw_rate: float  # of the unit ahead [rad/s]
    hitch_direction: float  # of the hitch's travel in the trailer's frame, + left [rad]


class ObserverMemory(NamedTuple):
    """State of the observer between two steps."""

    records: tuple[Record, ...] = ()  # oldest first
    speed_scale: float = 1.0  # speed of the hitch over that from wheels and yaw of the combination [-]
    bias: float = 0.0  # of the trailer's gyro [rad/s]
    slide: float = 0.0  # rate of the hitch's direction due to slip of the unit ahead [rad/s]
    uncertainty: float = 0.0  # of the hitch's direction [rad]
    corrected_at: int | None = None  # last correction [ticks]

    @property
    def now(self) -> Record:
        """The newest record."""
        return self.records[-1]


class Observer:
    """The motion of one trailer of a combination."""

    def __init__(self, combination: Combination) -> None:
        ahead = combination.vehicle.units[combination.unit - 1]
        fixed = [axle.x for axle in ahead.axles if not axle.steered] or [axle.x for axle in ahead.axles]
        self._lever = ahead.rear_hitch[0] - sum(fixed) / len(fixed)  # of the hitch, ahead of the fixed axles [m]
        self._unit = combination.unit

    def with_signals(self, memory: ObserverMemory, signals: CombinationSignals) -> ObserverMemory:
        """Memory with new signals."""
        lead = float(signals.yaw_rates[self._unit - 1])
        own = float(signals.yaw_rates[self._unit]) - memory.bias
        speed = memory.speed_scale * math.hypot(signals.speed, self._lever * lead)
        direction, slide, uncertainty = self._drift(speed, lead), memory.slide, memory.uncertainty
        if memory.records:
            last = memory.now
            span = (signals.tick - last.tick) * TICK
            turned = 0.5 * (lead + last.lead_yaw_rate - own - last.yaw_rate) + slide
            direction += last.hitch_direction - self._drift(last.speed, last.lead_yaw_rate) + turned * span
            slide *= math.exp(-span / _SLIDE_TIME)
            if memory.corrected_at is not None and (signals.tick - memory.corrected_at) * TICK > _GAP:
                uncertainty += _UNOBSERVED * span
        else:
            direction += float(signals.articulation[self._unit - 1])
        kept = tuple(record for record in memory.records if record.tick >= signals.tick - _KEPT)
        records = (*kept, Record(signals.tick, speed, own, lead, direction))
        return memory._replace(records=records, slide=slide, uncertainty=uncertainty)

    def corrected(self, memory: ObserverMemory, estimate: OffTracking, interval: float) -> ObserverMemory:
        """Memory corrected by an estimate ``interval`` [s] after the one before.

        After a gap the averaging time of an estimate's velocities is unknown; it only starts a new series.
        """
        memory = memory._replace(corrected_at=memory.now.tick)
        if interval > _GAP:
            return memory
        middle = record_at(memory.records, estimate.tick - round(0.5 * interval / TICK))  # its velocities are means
        speed = math.hypot(estimate.v_x, estimate.v_y)
        if min(estimate.v_x, middle.speed) < _LEAST_SPEED:
            return memory
        slow, quick = (1.0 - math.exp(-interval / time) for time in (_BIAS_TIME, _DIRECTION_TIME))
        error = math.atan2(estimate.v_y, estimate.v_x) - middle.hitch_direction
        turn = quick * error
        return ObserverMemory(
            records=tuple(record._replace(hitch_direction=record.hitch_direction + turn) for record in memory.records),
            speed_scale=memory.speed_scale * (1.0 + slow * (speed / middle.speed - 1.0)),
            bias=memory.bias + slow * (middle.yaw_rate - estimate.yaw_rate),
            slide=memory.slide + _SLIDE_SHARE * turn / interval,
            uncertainty=max(memory.uncertainty * math.exp(-interval / _SLIDE_TIME), abs(error)),
            corrected_at=memory.corrected_at,
        )

    def _drift(self, speed: float, lead: float) -> float:
        """Direction [rad] of the hitch's travel in the frame of the unit ahead, whose fixed axles do not slip."""
        return math.atan(self._lever * lead / max(speed, _LEAST_SPEED))


class Reckoned(NamedTuple):
    """The trailer's motion since some tick, in its frame S at that tick."""

    frame: Pose2  # S now
    hitch_path: FloatArray  # (n, 2) positions of the hitch since, newest first [m]


def record_at(records: tuple[Record, ...], tick: int) -> Record:
    """The newest record up to a tick, or the oldest one."""
    return next((record for record in reversed(records) if record.tick <= tick), records[0])


def reckoned(records: tuple[Record, ...], since: int) -> Reckoned:
    """The motion since a tick, by the trapezoidal rule."""
    x = y = psi = 0.0
    before, tick, path = record_at(records, since), since, []
    for record in records:
        if record.tick <= since:
            continue
        span = (record.tick - tick) * TICK
        turn = 0.5 * span * (before.yaw_rate + record.yaw_rate)
        course = psi + 0.5 * (turn + before.hitch_direction + record.hitch_direction)
        distance = 0.5 * span * (before.speed + record.speed)
        x, y, psi = x + distance * math.cos(course), y + distance * math.sin(course), psi + turn
        path.append((x, y))
        before, tick = record, record.tick
    return Reckoned(Pose2(x, y, psi), np.array(path[::-1]).reshape(-1, 2))
